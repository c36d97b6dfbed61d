"""The truths that a dataset may hold, by name, and how they are derived from an image."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from omniscv import plugins
from omniscv.arguments import one_of
from omniscv.frame import Frame
from omniscv.geometry.scene_geometry import SceneGeometry
from omniscv.records import NoOptions, WithOptions
from omniscv.sources.base import Source

SHARED_FILE = "truth.json"
"""Suffix of the file that holds the records of several truths, each under its name."""


@dataclass(frozen=True)
class Truth(WithOptions):
    """A truth that a job's ``truth:`` may name.

    Attributes:
        name: the key under ``truth:``, and of the record in its file.
        derive: function of a frame with its image in memory, and the options; returns plain JSON values.
            None of a truth between frames.
        needs: the modalities that the image must have.
        file: suffix of the file that holds the record. Where it is not ``truth.json``, the record is the
            whole file.
        keys: keys of the job that are added to the options: ``tolerance``.
        captures: whether ``derive`` uses the renderer, so that it must not run beside the next image; or a
            function of the scene's geometry and the options that returns this.
        options: record of the options (:mod:`omniscv.records`) that ``derive`` gets; None: it gets the
            mapping as it is.
        format: of a truth between frames, the export that writes it.
        check: raises ArgumentError for a source, its geometry, and modes with which no image can have the
            truth, given its options; called before the first capture.
    """

    name: str
    derive: Callable[[Frame, Any], Any] | None
    needs: tuple[str, ...] = ()
    file: str = SHARED_FILE
    keys: tuple[str, ...] = ()
    captures: bool | Callable[[SceneGeometry, Any], bool] = False
    options: type[Any] | None = None
    format: str = ""
    check: Callable[[Source, SceneGeometry, Collection[str], Any], None] | None = None

    @property
    def kind(self) -> str:
        """The kind of the file that holds the record, as :class:`omniscv.dataset.Frame` names it."""
        return self.file.partition(".")[0]

    def apply(self, frame: Frame, options: Mapping[str, Any]) -> Any:
        """Return the record of a frame's image.

        Raises:
            OmniscvError: wrong options, or as ``derive`` raises.
        """
        assert self.derive is not None, f"{self.name} lies between frames"
        return self.derive(frame, self.read_options(options))

    def may_capture(self, geometry: SceneGeometry, options: Mapping[str, Any]) -> bool:
        """Return whether ``derive`` may use the renderer, by the ``geometry`` of a scene and ``options``."""
        captures = self.captures
        return captures(geometry, self.read_options(options)) if callable(captures) else captures


def file_contents(records: Mapping[str, Any]) -> dict[str, Any]:
    """Return by kind the content of ``STEM.KIND.json``, from the records of an image by name."""
    contents: dict[str, Any] = {}
    for name, of_truth in records.items():
        truth = get(name)
        if truth.file == SHARED_FILE:
            contents.setdefault(truth.kind, {})[name] = of_truth
        else:
            contents[truth.kind] = of_truth
    return contents


_MODULES = {
    "poses": "registry",
    "layout": "layout_record",
    "boxes": "object_boxes",
    "bfov": "spherical_fit",
    "boxes3d": "object_boxes",
    "amodal": "visibility",
    "flow": "optical_flow",
}
"""The truths of this package, in the order in which files hold them, and the modules that register them."""

_TRUTHS: dict[str, Truth] = {}


def register(truth: Truth) -> None:
    """Add a truth, or replace the one of its name."""
    _TRUTHS[truth.name] = truth


def names() -> tuple[str, ...]:
    """Return the names of all truths."""
    plugins.load()
    return tuple(dict.fromkeys((*_MODULES, *_TRUTHS)))


def kinds() -> tuple[str, ...]:
    """Return the kinds of the files that hold records."""
    plugins.load()
    return tuple(dict.fromkeys(("truth", "layout", *(truth.kind for truth in _TRUTHS.values()))))


def get(name: str) -> Truth:
    """Return a truth by its name; ArgumentError for an unknown one."""
    one_of("truth", name, names())
    if name not in _TRUTHS:
        import_module(f"omniscv.truth.{_MODULES[name]}")
    return _TRUTHS[name]


def _object_poses(frame: Frame, options: NoOptions) -> dict[str, Any]:
    """Return by name the position (metres) and rotation of objects, world frame."""
    poses = {}
    for name, pose in sorted(frame.object_poses.items()):
        poses[name] = pose.to_dict()
    return poses


register(Truth("poses", _object_poses, options=NoOptions))
