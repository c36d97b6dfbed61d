"""The formats that datasets are exported to, by name, and exports: what other programs read."""

import json
import os
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

from omniscv import plugins, storage
from omniscv.arguments import one_of, optional_number, shown, text, texts, within
from omniscv.cameras import Camera
from omniscv.dataset.manifest import DATASET, Manifest, open, read
from omniscv.errors import ArgumentError, DamagedFileError, MissingFileError, OmniscvError
from omniscv.frame import Frame, FrameFiles
from omniscv.records import NoOptions, WithOptions, checked, record
from omniscv.storage import Folder, in_the_way
from omniscv.storage.bounded import MOST_JSON_BYTES, parse_json
from omniscv.storage.local import folder_beside, locked

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
        """Return what frames of cameras must have: ``needs``."""
        return self.needs

    def check_options(self, options: Any, cameras: Mapping[str, Camera]) -> None:
        """Raise ArgumentError for options that do not fit the cameras, before anything is captured."""

    @abstractmethod
    def write(self, frames: Sequence[Frame], out: Path, options: Any) -> list[Path]:
        """Write frames below a folder, and return the files.

        Raises:
            ArgumentError: frames that the format cannot carry.
        """

    def export(self, frames: Sequence[Frame], out: Path, options: Mapping[str, Any]) -> list[Path]:
        """Write frames as :meth:`write` does, with options as a job has them."""
        return self.write(frames, out, self.read_options(options))

    def check(self, frames: Sequence[Frame], out: Path) -> list[str] | None:
        """Return a line for each fault of an export; None: compare it with a new export."""
        return None


_MODULES = {
    **{"horizonnet": "layouts", "depth_png": "numbers", "kitti_lidar": "lidar", "pcd": "lidar"},
    **dict.fromkeys(("euroc", "kalibr", "poses", "tum_mono"), "slam"),
    **dict.fromkeys(("coco", "colmap", "flow", "nerfstudio", "ply", "rosbag2", "webdataset", "yolo")),
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
        format, start = get(self.format), f"export: {self.format}"
        for name in self.cameras:
            one_of(f"{start}: {_NAMED_BY}", name, cameras)
        cameras = {name: camera for name, camera in cameras.items() if self.shows(name)}
        for name, camera in cameras.items():
            if reason := format.refuses(camera):
                advice = f"name others by {_NAMED_BY}"
                raise ArgumentError(f"{start}: cannot carry camera {name!r}: {reason}; {advice}")
        with within(start):
            options = format.read_options(self.options)
            format.check_options(options, cameras)
        if missing := [kind for kind in format.needs_of(cameras, options) if kind not in kinds]:
            wanted = f"expected frames with {', '.join(missing)}"
            advice = "make the dataset with these 'modes', truths or 'imu' (labels: object_mask)"
            raise ArgumentError(f"{start}: {wanted}; they have {', '.join(sorted(kinds))}; {advice}")

    def write_into(self, frames: Sequence[Frame], folder: Path) -> list[Path]:
        """Write frames as the format does, file by file."""
        format = get(self.format)
        shown = [frame for frame in frames if self.shows(frame.camera_name)]
        with within(self.format):
            return format.export(shown, folder, self.options)


def export(
    folder: str | Path, /, to: str, out: str | Path | None = None, cameras: Sequence[str] = (), **options: Any
) -> list[str | Path]:
    """Export a dataset to a format.

    Args:
        folder: the dataset, by path or URL.
        to: a name of :func:`omniscv.dataset.names`.
        out: the folder to write into, by path or URL, beside other files; if not given, ``exports/NAME`` in
            the dataset, which is replaced.
        cameras: names of those whose frames are exported; all if not given.
        options: of the format.

    Returns:
        The files: paths, or URLs.

    Raises:
        ArgumentError: no dataset, no such format, a camera that it cannot carry, an unknown option, or a
            dataset in ``out``.
        DatasetError: the dataset is not complete, or damaged.
    """
    wanted = Export(to, options=options, cameras=cameras)
    source = storage.folder(folder)
    frames = open(source)
    kinds = [frame.kinds for frame in frames if wanted.shows(frame.camera_name)]
    common = set.intersection(*kinds) if kinds else set(get(to).needs)
    wanted.check({frame.camera_name: frame.camera for frame in frames}, common)
    if out is None:
        check_free(source, read(source), [wanted])
        return replace_export(wanted, frames, source)
    target = storage.folder(out)
    if target.exists(DATASET):  # whose files would be taken for frames, or replaced
        raise ArgumentError(f"{target}: expected a folder that holds no dataset; write beside it")
    return _place(wanted, frames, target, within_dataset=False)


def replace_export(wanted: Export, frames: Sequence[Frame], out: Folder) -> list[str | Path]:
    """Write an export into its folder of a dataset, in place of an existing one.

    In a store, files are put one by one, those that list others last; then those of an earlier one are gone.

    Raises:
        ArgumentError: files that no export has written have names of the new ones; or as a format.
    """
    return _place(wanted, frames, out.below(f"{EXPORTS}/{wanted.out}"), within_dataset=True)


def _place(wanted: Export, frames: Sequence[Frame], target: Folder, within_dataset: bool) -> list[str | Path]:
    """Write an export beside a local folder, or for a store into a temporary one, and move it when it is
    complete; return its files, as paths or URLs.

    The files that an earlier export listed are replaced or removed; those of others stay, and are refused
    where they have names of the new ones. Within a dataset, files of frames in a store are named as seen from
    there.
    """
    with ExitStack() as stack:
        if target.local is not None:  # relative paths out of it stay true
            part = stack.enter_context(folder_beside(Path(os.path.abspath(target.local))))
            paths = wanted.write_into(frames, part)
        else:
            root = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="omniscv-")))
            part = root / EXPORTS / wanted.out
            part.mkdir(parents=True)
            paths = wanted.write_into(with_stand_in(frames, root) if within_dataset else frames, part)
        last = [path.relative_to(part).as_posix() for path in paths]  # these list others
        names = {path.relative_to(part).as_posix() for path in part.rglob("*") if path.is_file()}
        if target.local is not None:
            stack.enter_context(_locked(target.local))
        _move(wanted, part, sorted(names.difference(last)), last, target, within_dataset)
    return [f"{target}/{name}" if target.local is None else target.local / name for name in last]


@contextmanager
def _locked(target: Path) -> Iterator[None]:
    target.mkdir(parents=True, exist_ok=True)
    with locked(target):
        yield


def _move(
    wanted: Export,
    part: Path,
    others: Sequence[str],
    last: Sequence[str],
    target: Folder,
    within_dataset: bool,
) -> None:
    """Move the files of a new export to their place, and remove the others of the one that it replaces.

    Args:
        wanted: the export.
        part: the local folder that holds the new files.
        others: the names of its files, but for those that list others.
        last: the names of these.
        target: their place.
        within_dataset: whether the place is a folder of a dataset, which is that of one export.
    """
    names = {*others, *last}
    there = set(target.names())
    lists = _read_lists(target)
    if lists is None:  # in a dataset of version 0.2, which kept no list, names of the new one are its own
        lists = {wanted.format: [*there.intersection(names)]} if within_dataset else {}
    replaced = set(lists) if within_dataset else {wanted.format}
    mine = {name for format in replaced & lists.keys() for name in lists[format]}
    if strange := sorted(there & names - mine):
        raise in_the_way(target, strange, f"the export to {wanted.format}")
    kept = {format: files for format, files in lists.items() if format not in replaced}
    # Listed before they are there: whatever kills the process, the next export knows them.
    _write_lists(target, {**kept, wanted.format: sorted(mine | names)})

    def put(name: str) -> None:
        if target.local is None:
            target.put(name, part / name)
        else:
            (target.local / name).parent.mkdir(parents=True, exist_ok=True)
            (part / name).replace(target.local / name)

    target.each(put, others)
    for name in last:
        put(name)
    target.remove_files(sorted(mine & there - names))
    _write_lists(target, {**kept, wanted.format: sorted(names)})


# -- lists of files --------------------------------------------------------------------------------------

LISTS = ".exported.json"
"""The file in the folder of exports that lists the files of each, by its format."""


def _read_lists(target: Folder) -> dict[str, list[str]] | None:
    """Return the files of the exports in a folder, by format; None if no list is there."""
    try:
        content = parse_json(target.read(LISTS, MOST_JSON_BYTES))
        return {text("format", name): list(texts("files", files)) for name, files in content.items()}
    except MissingFileError:
        return None
    except (ArgumentError, DamagedFileError, AttributeError) as cause:
        wanted = f"expected the list of an export in {LISTS}"
        raise ArgumentError(
            f"{target}: {wanted}, got: {cause}; remove the file, or write elsewhere"
        ) from cause


def _write_lists(target: Folder, lists: Mapping[str, Sequence[str]]) -> None:
    target.put(LISTS, f"{json.dumps(lists, indent=1)}\n".encode())


def check_free(folder: Folder, whole: Manifest | None, exports: Iterable[Export]) -> None:
    """Raise ArgumentError for files in the folder of an export that no export has written.

    Args:
        folder: of the dataset.
        whole: its manifest, as the exports that are there were made with it; None for a new dataset.
        exports: that are to be written into it.
    """
    earlier = set() if whole is None else {export["out"] for export in whole.settings.get("exports", ())}
    for export in exports:
        target = folder.below(f"{EXPORTS}/{export.out}")
        if export.out not in earlier and _read_lists(target) is None and (names := target.names()):
            raise in_the_way(target, names, f"the export to {export.format}")


def remove_exports(folder: Folder, files: Sequence[str]) -> None:
    """Remove files of exports; a folder that holds others, too, gets the list of no files: they are known
    then, and stay."""
    folder.remove_files(files)
    for out in {name.split("/")[1] for name in files}:
        target = folder.below(f"{EXPORTS}/{out}")
        if target.names():
            _write_lists(target, {})


def _names_of(export: Export, frames: Sequence[Frame]) -> set[str]:
    """Return the names of the files that an export of frames has; none if they do not give it."""
    try:
        with tempfile.TemporaryDirectory(prefix="omniscv-") as root:
            part = Path(root) / EXPORTS / export.out
            export.write_into(with_stand_in(frames, Path(root)), part)
            return {path.relative_to(part).as_posix() for path in part.rglob("*") if path.is_file()}
    except OmniscvError:
        return set()


def files_of_exports(folder: Folder, whole: Manifest, frames: Sequence[Frame]) -> list[str]:
    """Return the files of all exports in a dataset's folder, with their lists, as seen from there."""
    earlier = {export["out"]: Export(**export) for export in whole.settings.get("exports", ())}
    outs = {path.split("/")[1] for path in folder.names(f"{EXPORTS}/") if path.count("/") > 1}
    files = []
    for out in sorted(outs):
        target = folder.below(f"{EXPORTS}/{out}")
        lists = _read_lists(target)
        if lists is not None:
            names = {LISTS, *(name for listed in lists.values() for name in listed)}
        elif out in earlier:  # version 0.2 kept no list
            names = _names_of(earlier[out], frames).intersection(target.names())
        else:
            continue
        files += [f"{EXPORTS}/{out}/{name}" for name in sorted(names)]
    return files


def with_stand_in(frames: Sequence[Frame], root: Path) -> list[Frame]:
    """Return frames whose files have a local folder as stand-in for that of a store."""
    stored = (frame.files for frame in frames)
    files = [replace(of, stand_in=root) if isinstance(of, FrameFiles) else of for of in stored]
    return [replace(frame, files=of) for frame, of in zip(frames, files, strict=True)]
