"""Frames with poses: their pictures and lenses, and the captures that they become."""

import re
import unicodedata
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache, partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from omniscv import light
from omniscv.arguments import number, numbers, one_of, optional_number, shown, text, within
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose, cube_rotations
from omniscv.geometry.trajectory_columns import FRAMES, length_unit
from omniscv.importing.conventions import Words
from omniscv.importing.lenses import Pinhole, Wide, straight, to_faces
from omniscv.modalities import TRANSFERS, Transfer
from omniscv.pictures import foreign
from omniscv.pictures.forms import Pixels
from omniscv.pictures.photo_sphere import PhotoSphere
from omniscv.records import checked, optional, record
from omniscv.sources import codecs, pictures
from omniscv.sources.base import Capture, ObjectTable, Request, View
from omniscv.sources.pictures import DepthForm, Picture, read_picture
from omniscv.storage.bounded import MOST_JSON_BYTES, parse_json, read_bytes

NO_ID = 0xFFFF
UNKNOWN_ID = 0xFFFE
"""Of what the list of a frame does not name: it is counted."""
MODE_WORDS = {
    "depth": {"depth", "depths", "zdepth"},
    "object_mask": {"mask", "masks", "seg", "segmentation", "semantic", "instance", "instances", "indexob"},
    "normals": {"normal", "normals"},
    "lit": {"rgb", "color", "colour", "lit", "pano", "image", "combined"},
}

_NUMBERED = re.compile(rf"({'|'.join(sorted(set().union(*MODE_WORDS.values())))})(\d+)")
"""A word of what a picture shows with a number of its place, as Blender writes them: ``Depth0001``."""

_THUMBNAILS = ("@eadir", "#recycle", "#snapshot", "__macosx", "thumbnails", "thumbs")
"""Folders beside pictures, in lower case, that are no pictures of the user: of NAS, archives and viewers."""
_VIDEOS = (".mp4", ".mov", ".mkv", ".avi", ".webm", ".insv", ".360", ".m4v")
_RGBA = re.compile(r"\(\d{1,3}(, ?\d{1,3}){2,3}\)")
_MOST_NAMES = 4  # in a line
_FRONT = cube_rotations()[0][1]
_HEX = re.compile("0x[0-9a-fA-F]{1,8}")


def listed_numbers(name: str, value: Any) -> tuple[float, ...]:
    """Return ``value``, a number or a list of some, as a tuple; texts may be hexadecimal.

    ``name`` is what messages call it.
    """
    values: list[float] = []
    for item in value if isinstance(value, list | tuple) else [value]:
        if isinstance(item, str) and _HEX.fullmatch(item):
            values.append(int(item, 16))
        else:
            values.append(number(name, item))
    return tuple(values)


def missing_numbers(name: str, value: Any) -> tuple[float, ...]:
    """Return the finite ones of a ``value`` as of :func:`listed_numbers`: no others are a surface anyway.

    ``name`` is what messages call it.
    """
    finite = []
    for item in value if isinstance(value, list | tuple) else [value]:
        if str(item).lower().strip("+-.") not in ("nan", "inf"):
            finite.append(item)
    return listed_numbers(name, finite)


def _form(name: str, value: Any) -> DepthForm | None:
    if isinstance(value, DepthForm):
        return value
    return DepthForm.parse(text(name, value)) if value else None


@record(eq=False)
class Options:
    """What the user says of pictures; None, False or nothing where it is not said.

    Attributes:
        position: (3,) of the optical centre, world frame, metres; the origin if not given.
        yaw_deg: of the front face or the panorama's middle, to the left.
        depth: ``KIND-UNIT`` as :meth:`omniscv.sources.pictures.DepthForm.parse`; due for whole numbers.
        missing: numbers of depth that stand for no surface.
        names: JSON of the objects that masks show: see :func:`.objects_of`.
        poses: file of the poses of panoramas, by their names.
        intrinsics: lens file of any form, of pictures that are no faces or panoramas.
        frame, unit: the axes and the unit of ``poses``, as of a job's.
        mirrored: whether all pictures show left and right exchanged.
        clip: take negative and NaN light as 0.
        trust_words: take poses and depth as said, whatever pictures show.
        transfer: of 8-bit colours, whatever files say; of those that say nothing sRGB.
        clipped: by mode and file, the number of values taken as another.
        said: by mode and file, what was done when it was read.
        skipped: by file that is hidden or a thumbnail, the folder or the name that says so.
    """

    position: Any = checked(optional(partial(numbers, shape=(3,))), default=None)
    yaw_deg: float | None = checked(optional_number, default=None)
    depth: DepthForm | None = checked(_form, default=None)
    missing: tuple[float, ...] = checked(missing_numbers, default=())
    names: Path | None = None
    poses: Path | None = None
    intrinsics: Path | None = None
    frame: str | None = checked(optional(partial(one_of, words=FRAMES)), default=None)
    unit: str | float | None = checked(length_unit, default=None)
    mirrored: bool = False
    clip: bool = False
    trust_words: bool = False
    transfer: Transfer | None = checked(optional(partial(one_of, words=TRANSFERS)), default=None)
    clipped: dict[tuple[str, str], int] = field(default_factory=dict)
    said: dict[tuple[str, str], tuple[str, ...]] = field(default_factory=dict)
    skipped: dict[Path, str] = field(default_factory=dict)

    @property
    def front(self) -> Pose:
        """The pose of the front face, or of the panorama's middle."""
        return Pose.from_angles((0, 0, 0) if self.position is None else self.position, self.yaw_deg or 0.0)

    @property
    def pose(self) -> Pose | None:
        """The same where it is said."""
        return None if self.position is self.yaw_deg is None else self.front


@record
class Files:
    """The pictures of a mode: a pattern of their names, and what their numbers are."""

    file: str = checked(text, default="")
    kind: str = checked(one_of, words=("planar", "ray"), default="planar")
    unit: str = checked(text, default="")
    missing: tuple[float, ...] = checked(missing_numbers, default=())
    ids: str = checked(one_of, words=("grey", "rgb24", "colors"), default="")
    names: str = checked(text, default="")

    @property
    def form(self) -> DepthForm:
        """What the numbers of depth are."""
        if not self.unit:
            return DepthForm(self.kind == "ray", missing=self.missing)
        packed = self.unit in pictures.PACKED
        return DepthForm.parse(self.unit if packed else f"{self.kind}-{self.unit}", self.missing)


@dataclass
class Frame:
    """Pictures from one pose: files, and what they hold, by mode; of panoramas without ``lens``; black where
    ``mask`` is 0, without label and surface. ``names`` is the list of its own objects, where each frame has
    one. ``spheres`` has by mode which part of a sphere a panorama shows, if its file says that.
    """

    files: dict[str, Path]
    pose: Pose
    lens: Pinhole | Wide | None
    holds: Mapping[str, Files]
    mask: Path | None = None
    names: Path | None = None
    spheres: Mapping[str, PhotoSphere] = field(default_factory=dict)


@dataclass(frozen=True)
class Sequence:
    """Pictures with poses, in the order of ``frames``."""

    frames: list[Frame]
    objects: ObjectTable = field(default_factory=lambda: ObjectTable({}))  # of masks; empty: as they show
    says: tuple[str, ...] = ()  # lines for people
    of_openexr: int = 0  # as `to_faces`
    layout: str = ""  # its name
    words: Words = field(default_factory=Words)  # what it says of its poses; depth is as `form`
    options: Options = field(default_factory=Options)  # of the user
    refused: str = ""  # why it cannot be taken, unless pictures say more

    @property
    def modes(self) -> Counter[str]:
        """Number of pictures by mode."""
        return Counter(chain(*(frame.files for frame in self.frames)))

    def lines(self) -> tuple[str, ...]:
        """Return what was found, for people."""
        modes = self.modes
        places = len({tuple(frame.pose.position) for frame in self.frames})
        counts = ", ".join(f"{modes[mode]} of {mode}" for mode in modes)
        lines = [f"layout {self.layout}: {places} place{'' if places == 1 else 's'}, {counts}", *self.says]
        bent = sum(frame.lens is not None and frame.lens.is_bent for frame in self.frames)
        if bent:
            lines.append(f"{bent} frames resampled to flat pictures without distortion")
        return tuple(lines)

    def captures(self) -> Iterator[Capture]:
        """Yield the captures; ArgumentError names the picture that cannot be read."""
        for frame in self.frames:
            for mode, file in frame.files.items():
                picture = self.picture(frame, mode)
                with within(file.name):
                    provenance = {"server": "imported", "file": file.name, "layout": self.layout}
                    for view, part in self._views(picture, mode, frame.pose, frame.lens):
                        ray = self.form(frame).ray
                        yield capture_of(part, mode, view, provenance, ray, self.options.transfer)

    def form(self, frame: Frame) -> DepthForm:
        """Return what the numbers of a frame's depth are."""
        return self.options.depth or frame.holds.get("depth", Files()).form

    def picture(self, frame: Frame, mode: str) -> Picture:
        """Return the picture of a ``frame`` in a ``mode`` as it is said to be.

        Raises:
            ArgumentError: it cannot be read.
        """
        file = frame.files[mode]
        holds = frame.holds.get(mode, Files())
        if not file.exists():
            raise ArgumentError(f"{file.name}: expected a picture, got no file")
        picture = read_as(file, mode, self.options, self.form(frame))
        with within(file.name):
            if mode == "object_mask":
                picture = self._named(_of_ids(picture, holds), frame, file)
            if mode in frame.spheres:
                picture = _on_sphere(picture, mode, frame.spheres[mode])
            return _masked(picture, mode, frame.mask) if frame.mask else picture

    def _named(self, picture: Picture, frame: Frame, file: Path) -> Picture:
        """Return a mask with the ids or colours of this sequence's objects."""
        if frame.names is None or self.options.names:
            table = objects_of(self.options.names) if self.options.names else self.objects
            return as_named(picture, file, table, self.options)
        own = objects_of(frame.names)
        pixels = as_named(picture, file, own, self.options).pixels
        ids = np.full(pixels.shape[:2], UNKNOWN_ID, np.uint16)
        ids[(pixels == 0) if pixels.ndim == 2 else ~pixels.any(axis=-1)] = 0
        for name in own.names():
            shows = pixels == own.ids[name] if own.ids else (pixels == own.colors[name]).all(axis=-1)
            ids[shows] = self.objects.ids[name]
        return picture.converted(ids)

    def _views(
        self, picture: Picture, mode: str, pose: Pose, lens: Pinhole | Wide | None
    ) -> Iterator[tuple[View, Picture]]:
        """Yield the pinhole views of a picture, with their pixels: six of a panorama, otherwise one.

        Args:
            picture: as it was read.
            mode: the modality of its pixels.
            pose: of its camera, world frame.
            lens: of its camera; None for an equirectangular panorama.
        """
        height, width = picture.pixels.shape[:2]
        if lens is None:
            if width != 2 * height:
                raise ArgumentError(f"expected a panorama twice as wide as high, got {width} x {height}")
            colors = self._for_mean(picture.pixels, mode)
            for pixels, R, fov_deg in to_faces(colors, mode, self.of_openexr, picture.steps_m):
                face = Pose(pose.position, pose.R_w_c @ _FRONT.T @ R)
                part = picture.converted(self._as_stored(pixels, picture.pixels))
                yield View(face, fov_deg, *pixels.shape[1::-1]), part
            return
        lens = lens.scaled(width, height)
        if isinstance(lens, Pinhole) and not lens.is_bent:
            yield lens.view(pose), picture
            return
        colors = self._for_mean(picture.pixels, mode)
        pixels, flat = straight(colors, lens, mode, picture.steps_m)
        if mode == "depth":
            picture = picture._replace(error=pixels[..., 1])
            pixels = pixels[..., 0]
        yield flat.view(pose), picture.converted(self._as_stored(pixels, picture.pixels))

    def _for_mean(self, pixels: Pixels, mode: str) -> Pixels:
        """Return colours as light where their transfer is known: means between pixels are of light."""
        transfer = self.options.transfer or "srgb"
        if mode != "lit" or pixels.dtype.kind == "f" or transfer not in ("srgb", "film"):
            return pixels
        return light.decode(pictures.as_8_bits(pixels), transfer)

    def _as_stored(self, pixels: Pixels, before: Pixels) -> Pixels:
        """Return what :meth:`_for_mean` has made light as codes again."""
        if before.dtype.kind == pixels.dtype.kind:
            return pixels
        return light.encode(pixels, self.options.transfer or "srgb")


def read_as(file: Path, mode: str, options: Options, form: DepthForm) -> Picture:
    """Return a picture as the user says that it is; what is clipped is counted.

    Args:
        file: of the picture.
        mode: what it shows.
        options: of the user, which note what was done.
        form: what the numbers of depth are.
    """
    missing = form.missing + options.missing
    as_codes = options.transfer is not None
    picture = read_picture(file, mode, form._replace(missing=missing), options.clip, as_codes)
    options.clipped[mode, str(file)] = picture.clipped
    options.said[mode, str(file)] = picture.lines
    return picture.converted(picture.pixels[:, ::-1]) if options.mirrored else picture


def _on_sphere(picture: Picture, mode: str, sphere: PhotoSphere) -> Picture:
    """Return the whole panorama of a crop: black elsewhere, without label or surface."""
    if not sphere.is_cropped:
        return picture
    pixels, is_shown = sphere.whole(picture.pixels)
    if mode == "depth":
        pixels[~is_shown] = np.inf
    return picture.converted(pixels)


def _masked(picture: Picture, mode: str, file: Path) -> Picture:
    """Return a picture without what a mask hides: black, no label, no surface."""
    mask = read_picture(file, "object_mask").pixels
    hidden = mask.reshape(*mask.shape[:2], -1).max(axis=-1) == 0
    if hidden.shape != picture.pixels.shape[:2]:
        raise ArgumentError(f"mask_path: expected a mask of the picture's size, got {mask.shape[1::-1]}")
    pixels = picture.pixels.copy()
    pixels[hidden] = np.inf if mode == "depth" else 0
    return picture.converted(pixels)


def _of_ids(picture: Picture, holds: Files) -> Picture:
    """Return a mask whose ids are as a layout says."""
    pixels = picture.pixels
    if holds.ids == "grey" and pixels.ndim == 3:
        if (pixels != pixels[..., :1]).any():
            raise ArgumentError("expected grey ids, got colours")
        pixels = pixels[..., 0].astype(np.uint16)
        picture = picture._replace(pixels=pixels, encoding="png ids" if picture.encoding else "")
    if holds.ids == "rgb24":  # of a grey pixel, three equal digits
        digits = np.repeat(pixels[..., None], 3, axis=-1) if pixels.ndim == 2 else pixels
        pixels = digits @ np.array([65536, 256, 1], np.uint32)
    if pixels.ndim == 3 or (pixels is picture.pixels and not holds.missing):
        return picture
    pixels = np.where(np.isin(pixels, holds.missing), NO_ID, pixels)
    if pixels.max() > NO_ID:
        raise ArgumentError(f"expected ids of at most {NO_ID}, got {pixels.max()}")
    same = np.array_equal(pixels, picture.pixels)
    return picture if same else picture.converted(pixels.astype(np.uint16))


def as_named(picture: Picture, file: Path, table: ObjectTable, options: Options) -> Picture:
    """Return a mask as a list of its objects has them: of a list by id the indices of a palette, or grey.

    Args:
        picture: the mask.
        file: of it.
        table: the objects.
        options: of the user, which note what was done.

    Raises:
        ArgumentError: colours beside a list of ids, or ids beside one of colours.
    """
    pixels = picture.pixels
    if table.ids and pixels.ndim == 3:
        indices = foreign.palette_indices(file)
        if indices is not None:
            options.said["object_mask", str(file)] = ("masks are taken by the indices of their palette",)
            indices = indices[:, ::-1] if options.mirrored else indices
            return picture.converted(indices.astype(np.uint16))
        if (pixels == pixels[..., :1]).all():
            return picture.converted(pixels[..., 0].astype(np.uint16))
        expected = "expected ids in grey or a palette, because the objects are listed by id, got colours"
        raise ArgumentError(f"{expected}; list the colour of each: {{NAME: [RED, GREEN, BLUE]}}")
    if table.colors and not table.ids and pixels.ndim == 2:
        expected = "expected colours, because the objects are listed by colour, got grey ids"
        raise ArgumentError(f"{expected}; list the id of each: {{NAME: ID}}")
    return picture


def capture_of(
    picture: Picture,
    mode: str,
    view: View,
    provenance: Mapping[str, Any],
    ray: bool = False,
    transfer: Transfer | None = None,
) -> Capture:
    """Return the capture that a recording stores for a picture.

    A picture with an ``encoding`` keeps the bytes of its file. Any other is encoded without loss, except that
    16-bit colours become 8-bit ones.

    Args:
        picture: depth is (h, w), or (h, w, 2) with its error, metres.
        mode: the modality of its pixels, such as ``lit``.
        view: the pinhole view of its pixels.
        provenance: of the capture.
        ray: whether depth (h, w) is along the ray, not planar; depth (h, w, 2) is always planar.
        transfer: of integer colours to light; None for sRGB.
    """
    if mode == "lit" and picture.pixels.dtype.kind == "u":
        provenance = {**provenance, "transfer": transfer or "srgb"}
    request = Request(view, mode)
    if picture.encoding:
        return Capture(request, view, picture.pixels, provenance, picture.payload, picture.encoding)
    if mode == "depth":
        return _capture_of_depth(picture, request, provenance, ray)
    pixels = picture.pixels
    if mode == "lit" and pixels.dtype == np.uint16:
        pixels = pictures.as_8_bits(pixels)
    payload, encoding = codecs.encode(np.ascontiguousarray(pixels))
    return Capture(request, view, pixels, provenance, payload, encoding)


def _capture_of_depth(
    picture: Picture, request: Request, provenance: Mapping[str, Any], ray: bool
) -> Capture:
    """Return the capture of depth, with its error where that is known; see :func:`capture_of`."""
    view = request.view
    pixels = picture.pixels
    encoding_with_error = codecs.RESAMPLED
    if pixels.ndim == 2:
        encoding_with_error = codecs.BOUNDED
        lengths = view.ray_lengths()
        error = picture.error
        if error is None and picture.half_m and view.lens is None:
            provenance = {**provenance, "half_floats": [picture.half_m, int(ray)]}
        elif error is None and (picture.step_m or picture.half_m):
            error = np.where(pixels < np.inf, picture.steps_m / 2, np.inf)
        pixels = np.asarray(pixels / lengths if ray else pixels, np.float32)
        if error is not None:
            error_along_ray = np.asarray(error if ray else error * lengths, np.float32)
            pixels = np.stack([pixels, error_along_ray], axis=-1)
    payload, encoding = codecs.encode(np.ascontiguousarray(pixels))
    if pixels.ndim == 3:
        return Capture(request, view, pixels[..., 0], provenance, payload, encoding_with_error)
    return Capture(request, view, pixels, provenance, payload, encoding)


def files_in(folder: Path, options: Options | None = None) -> list[Path]:
    """Return the files in a folder and those in it, sorted.

    Those of hidden names, and in hidden folders or those of thumbnails, are left out; pictures among them are
    noted in ``options`` as skipped.
    """
    kept: list[Path] = []
    for file in sorted(folder.rglob("*")):
        parts = file.relative_to(folder).parts
        above = [part for part in parts[:-1] if part.startswith(".") or part.lower() in _THUMBNAILS]
        if parts[-1].startswith("._") or not file.is_file():
            continue  # macOS writes ._NAME beside NAME
        if not above and not parts[-1].startswith("."):
            kept.append(file)
        elif options is not None and file.suffix.lower() in foreign.SUFFIXES:
            options.skipped[file] = above[0] if above else parts[-1]
    return kept


def skipped_lines(options: Options) -> list[str]:
    """Return what was skipped as hidden or as a thumbnail, for people."""
    if not options.skipped:
        return []
    where = ", ".join(sorted({*options.skipped.values()})[:_MOST_NAMES])
    return [f"{len(options.skipped)} pictures that are hidden, or thumbnails, are skipped: {shown(where)}"]


def only_pictures(files: Iterable[Path]) -> list[Path]:
    """Return those of the files whose suffixes are of pictures that are read here."""
    return [file for file in files if file.suffix.lower() in foreign.SUFFIXES]


def pictures_in(path: Path, options: Options | None = None) -> list[Path]:
    """Return the pictures in the folder ``path``, sorted, or the one that it is.

    Pictures that are skipped are noted in ``options``; ArgumentError if there are none.
    """
    files = files_in(path, options) if path.is_dir() else [path]
    pictures = only_pictures(files)
    videos = [file.name for file in files if file.suffix.lower() in _VIDEOS]
    if videos and not pictures:
        advice = f"ffmpeg -i {videos[0]} -vf fps=2 frames/%05d.png takes pictures out of it"
        raise ArgumentError(f"expected pictures, got a video, {shown(videos[0])}; {advice}")
    if not pictures:
        others = ", ".join(shown(file.name) for file in files[:8])
        actual = f"none; cannot read {others}" if others else "none"
        raise ArgumentError(f"expected six pictures of faces, in colour, depth or masks, got {actual}")
    return pictures


def with_layers(files: dict[str, Path]) -> tuple[dict[str, Path], foreign.Parts]:
    """Return the files of a place by mode, and what the file of colours has in layers.

    That file is also that of the modes whose layers it has, if they have no file of their own.
    """
    if "lit" not in files:
        return files, foreign.Parts()
    parts = foreign.parts_of(files["lit"])
    return {**dict.fromkeys(parts.kinds, files["lit"]), **files}, parts


def layer_lines(parts: Iterable[foreign.Parts]) -> list[str]:
    """Return what was taken of files with several layers, and what was not, for people."""
    counts: Counter[str] = Counter()  # by mode
    others: dict[str, None] = {}
    for parts_of_file in parts:
        counts.update(parts_of_file.kinds)
        others |= dict.fromkeys(parts_of_file.others)
    lines = [f"{counts[mode]} of {mode} are layers of the files of colours" for mode in counts]
    if others:
        names = ", ".join(others)
        line = f"layers that are not taken: {names}"
        if "crypto" in names.lower():
            line += "; masks are taken of IndexOB, Blender's pass Object Index"
        lines.append(line)
    return lines


def mode_of(file: Path, folder: Path) -> tuple[str, tuple[str, ...]]:
    """Return what a picture shows, by the words of its name and folders, and the other words.

    ``file`` is the picture; its words are those below ``folder``, or those of its name if both are one.
    """
    name = file.relative_to(folder) if file != folder else Path(file.name)
    stem = unicodedata.normalize("NFC", str(name.with_suffix(""))).lower()
    words: list[str] = []
    for part in re.split(r"(?:[^\w+-]|_)+", stem):
        match = _NUMBERED.fullmatch(part)
        if match:
            words += (match[1], match[2])
        elif part:
            words.append(part)
    shown_mode = "lit"
    for mode, known in MODE_WORDS.items():
        if not known.isdisjoint(words):
            shown_mode = mode
            break
    of_modes = set().union(*MODE_WORDS.values())
    return shown_mode, tuple(word for word in words if word not in of_modes)


def _of_isaac(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the colours or ids of objects by name, of Isaac's lists of names by ``(r, g, b, a)`` or id."""
    values: dict[str, Any] = {}
    for key, value in data.items():
        name = value["class"] if isinstance(value, dict) else value
        if name in ("BACKGROUND", "UNLABELLED"):
            continue
        is_color = _RGBA.fullmatch(key)
        shows = [int(number) for number in re.findall(r"\d+", key)[:3]] if is_color else int(key)
        if values.setdefault(text("name", name), shows) != shows:
            raise ArgumentError(f"expected each object once, got {shown(name)} as {values[name]} and {shows}")
    return values


@cache
def objects_of(file: Path) -> ObjectTable:
    """Return the objects of JSON: names by id, ids or colours by name, or a list of names."""
    with within(file.name):
        data = parse_json(read_bytes(file, MOST_JSON_BYTES))
        try:
            return _table_of(data)
        except (TypeError, ValueError, AttributeError, OverflowError) as cause:
            raise ArgumentError(f"expected names of ids, got: {shown(str(cause))}") from cause


def numbered(names: Iterable[str]) -> ObjectTable:
    """Return objects with these ``names``, whose ids count from 1 in the order of names."""
    return ObjectTable({}, 0, {name: i for i, name in enumerate(sorted(names), start=1)})


def _table_of(data: Any) -> ObjectTable:
    """Return the objects that the data of a file name; errors of Python for data of another form."""
    if isinstance(data, list):
        data = {name: i for i, name in enumerate(data)}
    data = data.get("name_map", data)
    if any(_RGBA.fullmatch(key) or isinstance(data[key], dict) for key in data):
        data = _of_isaac(data)
    if all(isinstance(name, str) for name in data.values()):
        ids_of_names = {}
        for i, name in data.items():
            ids_of_names[name] = int(i)
        data = ids_of_names
    if all(isinstance(value, list) for value in data.values()):
        colors = {}
        for key in data:
            name = text("name", key)
            red, green, blue = bytes(data[key])
            colors[name] = (red, green, blue)
        return ObjectTable(colors)
    ids = {}
    for key in data:
        name = text("name", key)
        ids[name] = int(data[key])
    return ObjectTable({}, 0, ids)
