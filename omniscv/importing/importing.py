"""Import pictures that other tools made: six faces, panoramas, frames with poses."""

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from omniscv.arguments import one_of, shown, within
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose, pinhole
from omniscv.geometry.instant import turn_about_z
from omniscv.importing import sequences
from omniscv.importing.asking import taken
from omniscv.importing.folders import add_captures
from omniscv.importing.layouts import LAYOUTS, Choice, Layout, choose, cut, named
from omniscv.importing.posed_frames import (
    NO_ID,
    Options,
    as_named,
    capture_of,
    files_in,
    layer_lines,
    mode_of,
    objects_of,
    pictures_in,
    read_as,
    skipped_lines,
)
from omniscv.importing.posed_frames import Sequence as PosedSequence
from omniscv.pictures import foreign
from omniscv.sources.base import Capture, ObjectTable, View
from omniscv.sources.pictures import DepthForm, Picture

_ENVIRONMENTS = {"CubeFace Environment": "openexr", "LatLong Environment": "openexr-latlong"}
_OF_LIGHT = (
    ".exr",
    ".hdr",
    ".tif",
    ".tiff",
    ".npy",
    ".hdf5",
    ".h5",
)  # files whose colours may be negative or NaN
_TEXTS = (".txt", ".csv", ".json")
_SEAMLESS = 1e-4  # grey levels across edges: both faces show the same points, on the edge

Faces = list[tuple[str, Picture, Array, float]]
"""Mode, picture, rotation (3, 3), and field of view in degrees."""


@dataclass(frozen=True)
class Imported:
    """What was imported: the number of captures, and what was decided, in lines for people."""

    captures: int
    lines: tuple[str, ...]


def layouts() -> tuple[str, ...]:
    """Return the names of all layouts."""
    return (*LAYOUTS, *sequences.sequences())


def import_pictures(pictures: Path | str, path: Path | str, layout: str = "auto", **said: Any) -> Imported:
    """Add pictures to a recording, lossless; PNGs that a codec of recordings decodes stay as received.

    Args:
        pictures: a folder of six faces, of panoramas, or of frames with poses; or one picture of all faces,
            or a panorama. Names of files and folders say what they show, such as ``depth`` or ``mask``.
        path: of the recording; new, or one to add to.
        layout: one of :func:`layouts`, a file ``.yaml`` that describes one, or ``auto``.
        said: as :class:`.posed_frames.Options`.

    Raises:
        ArgumentError: no pictures, an unknown layout, pictures that are wrong or do not fit together, or an
            option that acts on nothing.
        RecordingError: the recording cannot be written, or is of another scene.
    """
    options = Options(**said)
    objects_of.cache_clear()  # the file may have changed since the last import
    pictures = Path(pictures)
    with within(pictures):
        if not layout.endswith((".yaml", ".yml")):
            one_of("layout", layout, ("auto", *layouts()))
        if layout == "auto" and pictures.suffix == ".exr":
            layout = _ENVIRONMENTS.get(foreign.environment(pictures), "auto")
        captures: Callable[[], Iterable[Capture]]
        if sequence := sequences.find_sequence(pictures, layout, options):
            sequence, asked = taken(sequence, options.trust_words)
            lines = [*sequence.lines(), *asked]
            modes = {*sequence.modes}
            captures = sequence.captures
        else:
            held, lines = _captures_of_faces(pictures, layout, options)
            modes = {capture.mode for capture in held}
            captures = partial(iter, held)
        _check_idle(options, modes, sequence)
        known = objects_of(options.names) if options.names else ObjectTable({})
        masks = _Masks(sequence.objects if sequence and not options.names else known)
        count = add_captures(path, lambda: map(masks.count, captures()), masks.objects)
        lines += [*masks.lines, *_lines_of_reading(options)]
        if replaced := masks.captures // 2 - count:  # they were read twice
            lines.append(f"{replaced} captures of a view that a later one shows, too: the last one stays")
    return Imported(count, tuple(lines))


def _captures_of_faces(pictures: Path, layout: str, options: Options) -> tuple[list[Capture], list[str]]:
    """Return the captures of six faces, in files of a folder or in one picture, and what was decided."""
    faces_in = _faces_in_picture if pictures.is_file() else _faces_in_folder
    faces, lines = faces_in(pictures, layout, options)
    turn_w = turn_about_z(options.yaw_deg or 0.0)
    ray = (options.depth or DepthForm()).ray
    captures = []
    for mode, picture, R, fov_deg in faces:
        pose = Pose(options.front.position, turn_w @ R)
        view = View(pose, fov_deg, *picture.pixels.shape[1::-1])
        provenance = {"server": "imported", "file": pictures.name}
        captures.append(capture_of(picture, mode, view, provenance, ray, options.transfer))
    return captures, lines


def _check_idle(options: Options, modes: Collection[str], sequence: PosedSequence | None) -> None:
    """Raise ArgumentError for an option that acts on none of the pictures."""
    colors = [file for mode, file in options.clipped if mode == "lit"]
    colors += [str(frame.files.get("lit", "")) for frame in sequence.frames] if sequence else []
    idle_if = {
        "depth": (options.depth or options.missing) and "depth" not in modes,
        "names": options.names and "object_mask" not in modes,
        "poses": options.poses and not sequence,
        "intrinsics": options.intrinsics and not sequence,
        "clip": options.clip and not any(Path(file).suffix.lower() in _OF_LIGHT for file in colors),
        "trust_words": options.trust_words and not (sequence and "depth" in modes),
        "transfer": options.transfer and "lit" not in modes,
        "frame or unit": (options.frame or options.unit) and not options.poses,
    }
    if idle := next((name for name, is_idle in idle_if.items() if is_idle), ""):
        got = f"pictures of {' and '.join(sorted(modes))}"
        raise ArgumentError(f"{idle}: expected pictures that it acts on, got {got}")


def _lines_of_reading(options: Options) -> list[str]:
    """Return what was skipped, converted and clipped when pictures were read, for people."""
    lines = skipped_lines(options)
    converted = Counter(line for of_file in options.said.values() for line in of_file)
    lines += [f"{line} ({files} files)" for line, files in converted.items()]
    clipped = Counter[str]()
    for (mode, _), values in options.clipped.items():
        clipped[mode] += values
    if clipped["lit"]:
        lines.append(f"{clipped['lit']} negative or NaN values taken as 0")
    if clipped["depth"]:
        advice = "taken as no surface; --missing 0 keeps them"
        lines.append(f"depth: {clipped['depth']} pixels have the largest number there is, {advice}")
    return lines


class _Masks:
    """Counts what masks show, and names it; with an empty table each id and colour becomes an object."""

    def __init__(self, table: ObjectTable) -> None:
        self._table = table
        self._pixels = Counter[int]()
        self._ids = False
        self.lines = list[str]()
        self.captures = 0

    def count(self, capture: Capture) -> Capture:
        """Count the ids or colours of a mask, and return the capture."""
        self.captures += 1
        if capture.mode == "object_mask":
            self._ids = capture.pixels.ndim == 2
            pixels = capture.pixels
            codes = pixels if self._ids else pixels @ np.array([65536, 256, 1], np.uint32)
            values, counts = np.unique(codes, return_counts=True)
            self._pixels.update(dict(zip(values.tolist(), counts.tolist(), strict=True)))
        return capture

    def _codes(self, table: ObjectTable) -> set[int]:
        if self._ids:
            return {*table.ids.values()}
        return {int.from_bytes(bytes(rgb)) for rgb in table.colors.values()}

    def objects(self, before: ObjectTable) -> ObjectTable:
        """Return the objects of a recording, given those that it has, and note what masks lack."""
        if not self._pixels:
            return before
        table = self._table
        what = "ids" if self._ids else "colours"
        codes = self._pixels.keys() - {0, *([NO_ID] if self._ids else [])}
        if not table.colors:
            new = codes - self._codes(before)
            ids = before.ids | ({f"id-{code}": code for code in new} if self._ids else {})
            colors = {f"color-{code:06x}": (code >> 16, code >> 8 & 255, code & 255) for code in new}
            tolerance = before.tolerance if before.colors else 0
            table = ObjectTable({} if self._ids else before.colors | colors, tolerance, ids)
            self.lines.append(f"masks: {len(new)} objects named after their {what}, no list names them")
        total = self._pixels.total()
        held = self._codes(table)
        if strange := sum(self._pixels[code] for code in codes - held):
            several = f"{len(codes - held)} {what}"
            self.lines.append(f"masks: {strange} of {total} pixels show {several} that no object has")
        if self._table.colors and (unseen := len(held - codes)):
            self.lines.append(f"masks: {unseen} of {len(held)} objects are in none")
        if not held & codes:
            self.lines.append(f"masks: all {total} labels are 0")
        return table


def _faces_in_folder(folder: Path, name: str, options: Options) -> tuple[Faces, list[str]]:
    """Return the faces in the files of a folder, and what was decided."""
    files: dict[str, list[Path]] = defaultdict(list)
    for file in pictures_in(folder, options):
        files[mode_of(file, folder)[0]].append(file)
    lit = files.get("lit", [])
    layers = [foreign.parts_of(file) for file in lit]
    for kind in set[str]().union(*(parts.kinds for parts in layers)):
        if not files[kind]:
            files[kind] = [file for file, parts in zip(lit, layers, strict=True) if kind in parts.kinds]
    faces = list[Any]()
    lines = list[str]()
    choice = None
    for mode in sorted(files, key=lambda mode: mode != "lit"):  # colours show best which faces fit
        stems = [file.stem for file in files[mode]]
        orders = named(stems, _tried(name) if choice is None else [choice.layout])
        if len(stems) != 6 or not orders:
            got = f"{len(stems)} of {mode}: {', '.join(sorted(stems)[:8])}"
            expected = f"six pictures of one place, named as in {_names(name, cells=False)}"
            if name == "auto" and len(stems) != 6:
                expected = "six faces, panoramas or a layout that is known"
                got = _found(folder, files)
            raise ArgumentError(f"expected {expected}; got {got}")
        read = [_read_face(file, mode, options) for file in files[mode]]
        edges = {picture.pixels.shape[:2] for picture in read}
        if len(edges) > 1 or len(set(*edges)) > 1:
            raise ArgumentError(f"expected six square pictures of one size, got {shown(sorted(edges))}")
        if choice is None:
            readings = [(layout, [read[i].pixels for i in order]) for layout, order in orders]
            choice = choose(readings, name != "auto")
        order = next(order for layout, order in orders if layout is choice.layout)
        lines = lines or choice.lines([stems[i] for i in order])
        faces += _views(mode, choice, [read[i] for i in order])
    return faces, [*lines, *layer_lines(layers)]


def _read_face(file: Path, mode: str, options: Options) -> Picture:
    """Return a picture of faces as the user says that it is."""
    picture = read_as(file, mode, options, options.depth or DepthForm())
    if mode != "object_mask" or not options.names:
        return picture
    with within(file.name):
        return as_named(picture, file, objects_of(options.names), options)


def _found(folder: Path, files: Mapping[str, Sequence[Path]]) -> str:
    """Return what a folder has, and the options, or the one line of a ``my.yaml``, that take it."""

    def pattern(file: Path) -> str:
        return re.sub(r"\d+(?=\D*$)", "{i}", file.relative_to(folder).as_posix())

    words = ("pose", "traj", "groundtruth", "camera")
    texts = (file for file in files_in(folder) if file.suffix.lower() in _TEXTS)
    poses = [file for file in texts if any(word in str(file.relative_to(folder)).lower() for word in words)]
    counts = (f"{len(of)} of {mode}: {', '.join(file.stem for file in of[:8])}" for mode, of in files.items())
    found = "; ".join(counts)
    if not poses:
        return f"{found}; no poses; if they are posed, --poses FILE and --intrinsics FILE take them"
    names = {mode: pattern(of[0]) for mode, of in files.items()}
    place = re.escape(names.get("lit", min(names.values()))).replace(r"\{i\}", r"(?P<i>\d+)")
    where = f"file: '{pattern(poses[0])}'" if len(poses) > 1 else f"file: '{pattern(poses[0])}', row: i"
    keys = {mode: f"{{file: '{name}'{', unit: mm' * (mode == 'depth')}}}" for mode, name in names.items()}
    keys |= {"poses": f"{{{where}}}", "intrinsics": "{fx: FX, fy: FY, cx: CX, cy: CY}"}
    layout = ", ".join(["pictures: pinhole", f"place: '{place}'", *(f"{key}: {keys[key]}" for key in keys)])
    return f"{found}; poses in {poses[0].name}; --layout my.yaml takes them, with {{{layout}}} in it"


def _faces_in_picture(file: Path, name: str, options: Options) -> tuple[Faces, list[str]]:
    """Return the faces in one picture, and what was decided."""
    mode, _ = mode_of(file, file)
    picture = _read_face(file, mode, options)
    cuts = ((layout, cut(picture.pixels, layout)) for layout in _tried(name) if layout.cells)
    readings = [(layout, pictures) for layout, pictures in cuts if pictures]
    if not readings:
        got = f"{picture.pixels.shape[1]} x {picture.pixels.shape[0]} px"
        raise ArgumentError(f"expected a picture of six faces as in {_names(name, cells=True)}, got {got}")
    choice = choose(readings, is_given=name != "auto")
    lines = choice.lines([f"face {i}" for i in range(1, 7)])
    faces = _views(mode, choice, [picture.converted(pixels) for pixels in choice.pictures])
    parts = foreign.parts_of(file) if mode == "lit" else foreign.Parts()
    for kind in parts.kinds:
        picture = _read_face(file, kind, options)
        cells = cut(picture.pixels, choice.layout) or []
        faces += _views(kind, choice, [picture.converted(pixels) for pixels in cells])
    return faces, [*lines, *layer_lines([parts])]


def _tried(name: str) -> list[Layout]:
    if name == "auto":
        return [layout for layout in LAYOUTS.values() if layout.guessed]
    return [LAYOUTS[name]] if name in LAYOUTS else []


def _names(name: str, cells: bool) -> str:
    return ", ".join(layout.name for layout in _tried(name) if bool(layout.cells) == cells) or name


def _views(mode: str, choice: Choice, faces: Sequence[Picture]) -> Faces:
    edge = faces[0].pixels.shape[0]
    is_centered = choice.layout.centered or choice.step < _SEAMLESS
    fov_deg = pinhole.fov_deg(edge, (edge - 1) / 2) if is_centered else 90.0
    pairs = zip(faces, choice.arrangement, strict=True)
    return [(mode, picture, face.R_w_c, fov_deg) for picture, face in pairs]
