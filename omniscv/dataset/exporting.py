"""The formats that datasets are exported to, by name, and exports: what other programs read."""

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

from omniscv import plugins
from omniscv.arguments import one_of, optional_number, shown, text, within
from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.records import NoOptions, WithOptions, checked, record

T = TypeVar("T")

EXPORTS = "exports"
"""The folder of a dataset in which exports are, each in a folder of its own."""
_NAMED_BY = "--camera, or 'cameras' in a job"


@record
class PointOptions:
    """Options of formats that hold points or depth."""

    max_relative_error: float | None = checked(
        optional_number,
        above=0,
        default=0.01,
        help="part of the depth; leave out pixels whose depth_error is larger; null: none",
    )


class Format(WithOptions, ABC):
    """Base of the formats. A subclass has at least a name and :meth:`write`.

    Attributes:
        name: of the format in jobs and commands.
        needs: kinds of files that its frames must have; ``imu``: a dataset with an IMU.
        keys: keys of the job that are added to the options, such as ``sensor``.
        options: record of the options (:mod:`omniscv.records`) that the methods get; None: they get the
            mapping as it is.
    """

    name: str
    needs: Sequence[str] = ()
    keys: Sequence[str] = ()
    options: type[Any] | None = NoOptions

    def refuses(self, camera: Camera) -> str | None:
        """Return why the format cannot carry a camera, in one line; None if it can."""
        return None

    def needs_of(self, cameras: Mapping[str, Camera], options: Any) -> Sequence[str]:
        """Return what frames of ``cameras`` must have for an export with ``options``: here ``needs``."""
        return self.needs

    def check_options(self, options: Any, cameras: Mapping[str, Camera]) -> None:
        """Raise ArgumentError for ``options`` that do not fit ``cameras``, before anything is captured."""

    @abstractmethod
    def write(self, frames: Sequence[Frame], out: Path, options: Any) -> list[Path]:
        """Write ``frames`` with ``options`` below the folder ``out``.

        Returns:
            The files that list others, or all of them. They are moved to their place last.

        Raises:
            ArgumentError: frames that the format cannot carry.
        """

    def export(self, frames: Sequence[Frame], out: Path, options: Mapping[str, Any]) -> list[Path]:
        """Write ``frames`` into ``out`` as :meth:`write` does, with ``options`` as a job has them."""
        return self.write(frames, out, self.read_options(options))

    def check(self, frames: Sequence[Frame], out: Path) -> list[str] | None:
        """Return a line for each fault of an export of ``frames`` in the folder ``out``.

        None: the format has no check of its own, and the export is compared with a new one.
        """
        return None


_MODULES = {
    **{"horizonnet": "layouts", "depth_png": "numbers", "kitti_lidar": "lidar", "pcd": "lidar"},
    **dict.fromkeys(("euroc", "kalibr", "poses", "tum_mono"), "slam"),
    **dict.fromkeys(
        ("coco", "colmap", "flow", "lerobot", "nerfstudio", "ply", "rosbag2", "webdataset", "yolo")
    ),
}
"""The formats of this package, and the modules that register them; None: that of the format's name."""

_GONE = {
    "structured3d": "horizonnet for layouts, depth_png and coco for the rest",
    "cfl": "horizonnet",
    "hf": "coco or webdataset",
    "omni3d": "the truth boxes3d, which KEY.truth.json has",
    "normals_png": "KEY.normals.exr",
}
"""Formats of earlier versions, and what to use instead."""

_FORMATS: dict[str, Format] = {}


def register(format: T) -> T:
    """Add a :class:`Format`, or its class, or replace the one of its name; return it, as decorators do."""
    made = format() if isinstance(format, type) else format
    if not isinstance(made, Format):
        raise ArgumentError(f"format: expected a dataset.Format, got {shown(format)}")
    _FORMATS[made.name] = made
    return format


def names() -> tuple[str, ...]:
    """Return the names of all formats."""
    plugins.load()
    return tuple(dict.fromkeys((*sorted(_MODULES), *_FORMATS)))


def get(name: str) -> Format:
    """Return a format by its name; ``-`` and ``_`` are alike. ArgumentError: no format has that name."""
    known = {format.replace("-", "_"): format for format in names()}
    if (instead := _GONE.get(name)) and name not in known:
        raise ArgumentError(f"format: expected a format that is written, got {name}; use {instead}")
    one_of("format", name.replace("-", "_"), known)
    name = known[name.replace("-", "_")]
    if name not in _FORMATS:
        import_module(f"omniscv.dataset.formats.{_MODULES[name] or name}")
    return _FORMATS[name]


# -- exports ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Export:
    """What is exported, and where.

    Attributes:
        format: its name.
        out: a folder below ``exports/``; the format's name if empty.
        options: of the format.
        cameras: whose frames are exported; all if empty.

    Raises:
        ArgumentError: no such format, or a folder that is no name.
    """

    format: str
    out: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)
    cameras: Sequence[str] = ()

    def __post_init__(self) -> None:
        name = get(self.format).name
        folder = text("out", self.out or name)
        if folder != Path(folder).name or folder.startswith("."):
            raise ArgumentError(f"out: expected the name of a folder, got {folder!r}")
        vars(self).update(format=name, out=folder)

    def shows(self, camera_name: str) -> bool:
        """Return whether a camera's frames are exported."""
        return not self.cameras or camera_name in self.cameras

    def check(self, cameras: Mapping[str, Camera], kinds: Collection[str]) -> None:
        """Refuse cameras that the format cannot carry, wrong options, and frames without files that it needs.

        Args:
            cameras: of the frames, by name.
            kinds: of the files that every exported frame has.
        """
        format = get(self.format)
        start = f"export: {self.format}"
        for name in self.cameras:
            one_of(f"{start}: {_NAMED_BY}", name, cameras)
        exported = {}
        for name, camera in cameras.items():
            if not self.shows(name):
                continue
            if reason := format.refuses(camera):
                advice = f"name others by {_NAMED_BY}"
                raise ArgumentError(f"{start}: cannot carry camera {name!r}: {reason}; {advice}")
            exported[name] = camera
        with within(start):
            options = format.read_options(self.options)
            format.check_options(options, exported)
        if missing := [kind for kind in format.needs_of(exported, options) if kind not in kinds]:
            wanted = f"expected frames with {', '.join(missing)}"
            advice = "make the dataset with these 'modes', truths or 'imu' (labels: object_mask)"
            raise ArgumentError(f"{start}: {wanted}; they have {', '.join(sorted(kinds))}; {advice}")

    def write_into(self, frames: Sequence[Frame], folder: Path) -> list[Path]:
        """Write those of ``frames`` that the export shows into a local ``folder``; return as Format.write."""
        format = get(self.format)
        shown = [frame for frame in frames if self.shows(frame.camera_name)]
        with within(self.format):
            return format.export(shown, folder, self.options)
