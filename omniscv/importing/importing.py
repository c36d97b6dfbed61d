"""Import pictures that other tools made: six faces, panoramas, frames with poses."""

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
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
from omniscv.importing.projections import check_cube, check_panorama
from omniscv.pictures import foreign
from omniscv.pictures.forms import Pixels
from omniscv.sources.base import Capture, ObjectTable, View
from omniscv.sources.pictures import DepthForm, Picture

_ENVIRONMENTS = {"CubeFace Environment": "openexr", "LatLong Environment": "openexr-latlong"}
_OF_LIGHT = (".exr", ".hdr", ".tif", ".tiff", ".npy", ".hdf5", ".h5")
"""Suffixes of files whose colours may be negative or NaN."""
_TEXTS = (".txt", ".csv", ".json")
_WORDS_OF_POSES = ("pose", "traj", "groundtruth", "camera")
_CHECKED_PANORAMAS = 3  # of a folder
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
        sequence = sequences.find_sequence(pictures, layout, options)
        if sequence:
            if not options.trust_words:
                _check_panoramas(sequence)
            sequence, lines_of_asking = taken(sequence, options.trust_words)
            lines = [*sequence.lines(), *lines_of_asking]
            modes = {*sequence.modes}
            captures = sequence.captures
        else:
            captures_of_faces, lines = _captures_of_faces(pictures, layout, options)
            modes = {capture.mode for capture in captures_of_faces}
            captures = partial(iter, captures_of_faces)
        _check_idle(options, modes, sequence)
        known = objects_of(options.names) if options.names else ObjectTable({})
        masks = _Masks(sequence.objects if sequence and not options.names else known)
        count = add_captures(path, lambda: map(masks.count, captures()), masks.objects)
        lines += [*masks.lines, *_lines_of_reading(options)]
        if replaced := masks.captures // 2 - count:  # they were read twice
            lines.append(f"{replaced} captures of a view that a later one shows, too: the last one stays")
    return Imported(count, tuple(lines))


def _check_panoramas(sequence: PosedSequence) -> None:
    """Raise ArgumentError if colours that are read as panoramas are certainly none.

    Panoramas are the whole pictures of frames without a lens, twice as wide as high. At most
    ``_CHECKED_PANORAMAS`` of them are read, spread over the sequence.
    """
    frames = []
    for frame in sequence.frames:
        is_whole = "lit" not in frame.spheres or not frame.spheres["lit"].is_cropped
        if frame.lens is None and "lit" in frame.files and is_whole:
            frames.append(frame)
    step = max(1, len(frames) // _CHECKED_PANORAMAS)
    for frame in frames[::step][:_CHECKED_PANORAMAS]:
        pixels = sequence.picture(frame, "lit").pixels
        height, width = pixels.shape[:2]
        if width == 2 * height:
            with within(frame.files["lit"].name):
                check_panorama(pixels)


def _captures_of_faces(pictures: Path, layout: str, options: Options) -> tuple[list[Capture], list[str]]:
    """Return the captures of six faces, in files of a folder or in one picture, and what was decided."""
    if pictures.is_file():
        faces, lines = _faces_in_picture(pictures, layout, options)
    else:
        faces, lines = _faces_in_folder(pictures, layout, options)
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
    has_depth = "depth" in modes
    acts_on = {  # by option: whether it is given, and whether it acts
        "depth": (options.depth or options.missing, has_depth),
        "names": (options.names, "object_mask" in modes),
        "poses": (options.poses, sequence),
        "intrinsics": (options.intrinsics, sequence),
        "clip": (options.clip, _has_light(options, sequence)),
        "trust_words": (options.trust_words, has_depth or "lit" in modes),
        "transfer": (options.transfer, "lit" in modes),
        "frame or unit": (options.frame or options.unit, options.poses),
    }
    for name, (given, acts) in acts_on.items():
        if given and not acts:
            actual = f"pictures of {' and '.join(sorted(modes))}"
            raise ArgumentError(f"{name}: expected pictures that it acts on, got {actual}")


def _has_light(options: Options, sequence: PosedSequence | None) -> bool:
    """Return whether a file of colours may have negative or NaN values."""
    files = []
    for mode, file in options.clipped:
        if mode == "lit":
            files.append(file)
    if sequence:
        for frame in sequence.frames:
            files.append(str(frame.files.get("lit", "")))
    return any(Path(file).suffix.lower() in _OF_LIGHT for file in files)


def _lines_of_reading(options: Options) -> list[str]:
    """Return what was skipped, converted and clipped when pictures were read, for people."""
    lines = skipped_lines(options)
    for line, files in Counter(chain(*options.said.values())).items():
        lines.append(f"{line} ({files} files)")
    clipped: Counter[str] = Counter()
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
        self._pixels: Counter[int] = Counter()  # by id or colour
        self._ids = False
        self.lines: list[str] = []
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
        codes = self._pixels.keys() - {0}
        if self._ids:
            codes -= {NO_ID}
        table = self._table if self._table.colors else self._named_after_codes(codes, before)
        total = self._pixels.total()
        known = self._codes(table)
        unknown = codes - known
        if unknown:
            pixels = sum(self._pixels[code] for code in unknown)
            what = f"{len(unknown)} {'ids' if self._ids else 'colours'}"
            self.lines.append(f"masks: {pixels} of {total} pixels show {what} that no object has")
        unseen = len(known - codes)
        if self._table.colors and unseen:
            self.lines.append(f"masks: {unseen} of {len(known)} objects are in none")
        if not known & codes:
            self.lines.append(f"masks: all {total} labels are 0")
        return table

    def _named_after_codes(self, codes: set[int], before: ObjectTable) -> ObjectTable:
        """Return the objects of a recording with those that masks add, named after their ids or colours."""
        new = codes - self._codes(before)
        what = "ids" if self._ids else "colours"
        self.lines.append(f"masks: {len(new)} objects named after their {what}, no list names them")
        tolerance = before.tolerance if before.colors else 0
        if self._ids:
            return ObjectTable({}, tolerance, before.ids | {f"id-{code}": code for code in new})
        colors = dict(before.colors)
        for code in new:
            colors[f"color-{code:06x}"] = (code >> 16, code >> 8 & 255, code & 255)
        return ObjectTable(colors, tolerance, before.ids)


def _faces_in_folder(folder: Path, name: str, options: Options) -> tuple[Faces, list[str]]:
    """Return the faces in the files of a folder, and what was decided.

    Colours decide the layout, as they show best which faces fit; depth and masks must follow it.
    """
    files, layers = _files_by_mode(folder, options)
    faces: Faces = []
    lines: list[str] = []
    choice: Choice | None = None
    for mode in sorted(files, key=lambda mode: mode != "lit"):
        stems = _stems(files[mode])
        fitting = named(stems, _tried(name) if choice is None else [choice.layout])
        if len(stems) != 6 or not fitting:
            raise ArgumentError(_expected_faces(folder, name, mode, files))
        pictures = [_read_face(file, mode, options) for file in files[mode]]
        _check_square(pictures)
        if choice is None:
            choice = _choice(fitting, pictures, name, mode, options)
        order = next(order for layout, order in fitting if layout is choice.layout)
        if not lines:
            lines = choice.lines([stems[i] for i in order])
        faces += _views(mode, choice, [pictures[i] for i in order])
    return faces, [*lines, *layer_lines(layers)]


def _choice(
    fitting: Sequence[tuple[Layout, list[int]]],
    pictures: Sequence[Picture],
    name: str,
    mode: str,
    options: Options,
) -> Choice:
    """Return the reading of pictures whose edges fit.

    Args:
        fitting: layouts that the names of files allow, each with the indices of pictures in its order.
        pictures: the six faces, in the order of files.
        name: of a layout, or ``auto``.
        mode: what the pictures show.
        options: of the user.
    """
    readings = []
    for layout, order in fitting:
        pixels = []
        for i in order:
            pixels.append(pictures[i].pixels)
        readings.append((layout, pixels))
    return _checked_choice(readings, name, mode, options)


def _checked_choice(
    readings: Sequence[tuple[Layout, Sequence[Pixels]]], name: str, mode: str, options: Options
) -> Choice:
    """Return the reading whose edges fit; ArgumentError for none, or for no plain cube.

    Args:
        readings: layouts that names or shape allow, each with the pictures in its order.
        name: of a layout, or ``auto``.
        mode: what the pictures show.
        options: of the user.
    """
    is_asked = mode == "lit" and not options.trust_words
    try:
        choice = choose(readings, is_given=name != "auto")
    except ArgumentError:
        for layout, pixels in readings if is_asked else ():
            check_cube(pixels, layout.arrangement)  # it has a better reason
        raise
    if is_asked and not choice.layout.centered:
        check_cube(choice.pictures, choice.arrangement)
    return choice


def _files_by_mode(folder: Path, options: Options) -> tuple[dict[str, list[Path]], list[foreign.Parts]]:
    """Return the files of a folder by mode, and what those of colours have in layers.

    They are the files of modes that have none of their own, and are among their layers.
    """
    files: dict[str, list[Path]] = defaultdict(list)
    for file in pictures_in(folder, options):
        files[mode_of(file, folder)[0]].append(file)
    layers = []
    in_layers: dict[str, list[Path]] = defaultdict(list)
    for file in files.get("lit", []):
        parts = foreign.parts_of(file)
        layers.append(parts)
        for kind in parts.kinds:
            in_layers[kind].append(file)
    for kind, files_of_colors in in_layers.items():
        if not files[kind]:
            files[kind] = files_of_colors
    return files, layers


def _expected_faces(folder: Path, name: str, mode: str, files: Mapping[str, Sequence[Path]]) -> str:
    """Return why the pictures of a mode are not six faces by a layout, or by any if it is ``auto``."""
    stems = sorted(_stems(files[mode]))
    if name == "auto" and len(stems) != 6:
        return f"expected six faces, panoramas or a layout that is known; got {_found(folder, files)}"
    expected = f"expected six pictures of one place, named as in {_names(name, cells=False)}"
    return f"{expected}; got {len(stems)} of {mode}: {', '.join(stems[:8])}"


def _stems(files: Iterable[Path]) -> list[str]:
    """Return the names of files without their suffixes."""
    return [file.stem for file in files]


def _check_square(pictures: Sequence[Picture]) -> None:
    """Raise ArgumentError for pictures that are not square, or of several sizes."""
    sizes = {picture.pixels.shape[:2] for picture in pictures}
    height, width = pictures[0].pixels.shape[:2]
    if len(sizes) > 1 or height != width:
        raise ArgumentError(f"expected six square pictures of one size, got {shown(sorted(sizes))}")


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

    counts = []
    for mode, files_of_mode in files.items():
        stems = ", ".join(_stems(files_of_mode[:8]))
        counts.append(f"{len(files_of_mode)} of {mode}: {stems}")
    found = "; ".join(counts)
    poses = _files_of_poses(folder)
    if not poses:
        return f"{found}; no poses; if they are posed, --poses FILE and --intrinsics FILE take them"
    patterns = {mode: pattern(files[mode][0]) for mode in files}
    place = re.escape(patterns.get("lit", min(patterns.values()))).replace(r"\{i\}", r"(?P<i>\d+)")
    keys = ["pictures: pinhole", f"place: '{place}'"]
    for mode, name in patterns.items():
        unit = ", unit: mm" if mode == "depth" else ""
        keys.append(f"{mode}: {{file: '{name}'{unit}}}")
    row = "" if len(poses) > 1 else ", row: i"
    keys.append(f"poses: {{file: '{pattern(poses[0])}'{row}}}")
    keys.append("intrinsics: {fx: FX, fy: FY, cx: CX, cy: CY}")
    layout = ", ".join(keys)
    return f"{found}; poses in {poses[0].name}; --layout my.yaml takes them, with {{{layout}}} in it"


def _files_of_poses(folder: Path) -> list[Path]:
    """Return the texts in a folder whose names say that they have poses."""
    files = []
    for file in files_in(folder):
        name = str(file.relative_to(folder)).lower()
        if file.suffix.lower() in _TEXTS and any(word in name for word in _WORDS_OF_POSES):
            files.append(file)
    return files


def _faces_in_picture(file: Path, name: str, options: Options) -> tuple[Faces, list[str]]:
    """Return the faces in one picture, and what was decided."""
    mode, _ = mode_of(file, file)
    picture = _read_face(file, mode, options)
    readings = []
    for layout in _tried(name):
        pictures = cut(picture.pixels, layout) if layout.cells else None
        if pictures:
            readings.append((layout, pictures))
    if not readings:
        actual = f"{picture.pixels.shape[1]} x {picture.pixels.shape[0]} px"
        raise ArgumentError(f"expected a picture of six faces as in {_names(name, cells=True)}, got {actual}")
    choice = _checked_choice(readings, name, mode, options)
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
    names = [layout.name for layout in _tried(name) if bool(layout.cells) == cells]
    return ", ".join(names) or name


def _views(mode: str, choice: Choice, faces: Sequence[Picture]) -> Faces:
    edge = faces[0].pixels.shape[0]
    is_centered = choice.layout.centered or choice.step < _SEAMLESS
    fov_deg = pinhole.fov_deg(edge, (edge - 1) / 2) if is_centered else 90.0
    views = []
    for picture, face in zip(faces, choice.arrangement, strict=True):
        views.append((mode, picture, face.R_w_c, fov_deg))
    return views
