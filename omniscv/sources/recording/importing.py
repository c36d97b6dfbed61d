"""Import six faces, one picture of them, or a panorama, as other tools write them, into a recording."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv.arguments import number, numbers, one_of, shown, within
from omniscv.errors import ArgumentError, BadReplyError
from omniscv.geometry import Array, Pose, pinhole
from omniscv.sources import codecs
from omniscv.sources.base import Capture, Request, View
from omniscv.sources.pictures import Pixels, read_picture, to_faces, turn_about_z
from omniscv.sources.recording.folders import add_captures
from omniscv.sources.recording.layouts import LAYOUTS, Choice, Layout, choose, cut, named
from omniscv.sources.recording.sequences import SEQUENCES, find_sequence
from omniscv.storage.bounded import MOST_PICTURE_BYTES, read_bytes

PANORAMAS = {"latlong": 0, "openexr-latlong": 1}
"""Layouts of one picture 2:1. Of 1, the first and the last column show one meridian, of OpenEXR's axes."""

DEPTHS = (*(f"{kind}-{unit}" for kind in ("planar", "ray") for unit in ("m", "cm", "mm")), "carla")
"""What pictures of depth hold: along the optical axis or the ray, and the unit; CARLA's 24 bits."""

_UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
_AS_RECEIVED = {"planar-cm": "png uint16 100", "planar-mm": "png uint16 1000", "carla": "png carla"}
_SUFFIXES = (".png", ".jpg", ".jpeg", ".exr", ".hdr", ".tif", ".tiff", ".npy")
_MODE_WORDS = {
    "depth": {"depth", "depths", "zdepth"},
    "object_mask": {"mask", "masks", "seg", "segmentation", "instance", "instances"},
    "normals": {"normal", "normals"},
}
_ENVIRONMENTS = {"CubeFace Environment": "openexr", "LatLong Environment": "openexr-latlong"}
_SEAMLESS = 1e-4  # grey levels across edges: both faces show the same points, on the edge

FaceView = tuple[Pixels, Array, float, bytes]
"""Pixels, rotation (3, 3), field of view in degrees, and the bytes of its file, empty if it has none."""
Faces = dict[str, list[FaceView]]
"""By mode."""


@dataclass(frozen=True)
class Imported:
    """What was imported: the number of captures, and what was decided, in lines for people."""

    captures: int
    lines: tuple[str, ...]


def layouts() -> tuple[str, ...]:
    """Return the names of all layouts."""
    return (*LAYOUTS, *PANORAMAS, *SEQUENCES)


def import_pictures(
    pictures: Path | str,
    path: Path | str,
    layout: str = "auto",
    *,
    position: ArrayLike = (0.0, 0.0, 0.0),
    yaw_deg: float = 0.0,
    depth: str = "planar-m",
) -> Imported:
    """Add the pictures of one place to a recording, lossless.

    PNGs of colours, masks, depth in 16-bit centimetres or millimetres and CARLA's depth stay as received;
    other depth becomes planar metres in float32.

    Args:
        pictures: a folder of six faces, in several modes where names of files or sub-folders say ``depth`` or
            ``mask``; or one picture: a strip, a cross, a dice, an EXR environment cube, a panorama.
        path: of the recording; new, or one to add to.
        layout: one of :func:`layouts`, or ``auto``: frames with poses (see
            :mod:`omniscv.sources.recording.sequences`) by what lies in a folder; else by names and seams.
        position: (3,) of the optical centre, world frame, metres.
        yaw_deg: of the front face, to the left.
        depth: one of :data:`DEPTHS`. Integers of 0 are no surface.

    Raises:
        ArgumentError: no pictures, an unknown layout, or faces that do not fit together.
        RecordingError: the recording cannot be written, or is of another scene.
    """
    one_of("layout", layout, ("auto", *layouts()))
    one_of("depth", depth, DEPTHS)
    center_w, turn_w = numbers("position", position, (3,)), turn_about_z(number("yaw_deg", yaw_deg))
    pictures = Path(pictures)
    with within(pictures):
        if sequence := find_sequence(pictures, layout):
            count = add_captures(path, sequence.captures, sequence.objects)
            return Imported(count, sequence.lines())
        faces_in = _faces_in_picture if pictures.is_file() else _faces_in_folder
        faces, lines = faces_in(pictures, layout)
        captures = []
        for mode, of_mode in faces.items():
            for pixels, R, fov_deg, payload in of_mode:
                view = View(Pose(center_w, turn_w @ R), fov_deg, pixels.shape[1], pixels.shape[0])
                captures.append(_capture(mode, pixels, view, depth, pictures.name, payload))
    return Imported(add_captures(path, lambda: captures), tuple(lines))


def _faces_in_folder(folder: Path, name: str) -> tuple[Faces, list[str]]:
    """Return the faces in the files of a folder, and what was decided."""
    files: dict[str, list[Path]] = defaultdict(list)
    for file in sorted(folder.rglob("*")):
        if file.suffix.lower() in _SUFFIXES:
            words = set(re.split(r"[^a-z]+", str(file.relative_to(folder).with_suffix("")).lower()))
            files[next((mode for mode, known in _MODE_WORDS.items() if words & known), "lit")].append(file)
    if not files or "normals" in files:
        got = "normals, whose frame is not known" if files else "none"
        raise ArgumentError(f"expected six pictures of faces, in colour, depth or masks, got {got}")
    faces, lines, choice = Faces(), list[str](), None
    for mode in sorted(files, key=lambda mode: mode != "lit"):  # colours show best which faces fit
        stems = [file.stem for file in files[mode]]
        orders = named(stems, _tried(name) if choice is None else [choice.layout])
        if len(stems) != 6 or not orders:
            got = f"{len(stems)} of {mode}: {', '.join(sorted(stems)[:8])}"
            expected = f"six pictures of one place, named as in {_names(name, cells=False)}"
            raise ArgumentError(f"expected {expected}; got {got}")
        pixels = [read_picture(file) for file in files[mode]]
        edges = {picture.shape[:2] for picture in pixels}
        if len(edges) > 1 or len(set(*edges)) > 1:
            raise ArgumentError(f"expected six square pictures of one size, got {shown(sorted(edges))}")
        if choice is None:
            choice = choose(
                [(layout, [pixels[i] for i in order]) for layout, order in orders], name != "auto"
            )
        order = next(order for layout, order in orders if layout is choice.layout)
        lines = lines or choice.lines([stems[i] for i in order])
        faces[mode] = _views(
            choice,
            [pixels[i] for i in order],
            [read_bytes(files[mode][i], MOST_PICTURE_BYTES) for i in order],
        )
    return faces, lines


def _faces_in_picture(file: Path, name: str) -> tuple[Faces, list[str]]:
    """Return the faces in one picture of colours, and what was decided."""
    picture = read_picture(file)
    if name == "auto" and file.suffix != ".npy":
        import OpenImageIO

        if opened := OpenImageIO.ImageInput.open(str(file)):
            name = _ENVIRONMENTS.get(opened.spec().get_string_attribute("textureformat"), name)
    if name == "auto" and picture.shape[1] == 2 * picture.shape[0]:
        name = "latlong"
    if name in PANORAMAS:
        faces = [(*face, b"") for face in to_faces(picture, "lit", PANORAMAS[name])]
        return {"lit": faces}, [f"layout {name}: resampled to six faces"]
    cuts = ((layout, cut(picture, layout)) for layout in _tried(name) if layout.cells)
    readings = [(layout, pictures) for layout, pictures in cuts if pictures]
    if not readings:
        got = f"{picture.shape[1]} x {picture.shape[0]} px"
        raise ArgumentError(f"expected a picture of six faces as in {_names(name, cells=True)}, got {got}")
    choice = choose(readings, is_given=name != "auto")
    lines = choice.lines([f"face {i}" for i in range(1, 7)])
    return {"lit": _views(choice, choice.pictures, [b""] * 6)}, lines


def _tried(name: str) -> list[Layout]:
    if name == "auto":
        return [layout for layout in LAYOUTS.values() if layout.guessed]
    return [LAYOUTS[name]] if name in LAYOUTS else []


def _names(name: str, cells: bool) -> str:
    return ", ".join(layout.name for layout in _tried(name) if bool(layout.cells) == cells) or name


def _views(choice: Choice, faces: Sequence[Pixels], payloads: Sequence[bytes]) -> list[FaceView]:
    edge = faces[0].shape[0]
    is_centered = choice.layout.centered or choice.step < _SEAMLESS
    fov_deg = pinhole.fov_deg(edge, (edge - 1) / 2) if is_centered else 90.0
    rotations = [face.R_w_c for face in choice.arrangement]
    views = zip(faces, rotations, payloads, strict=True)
    return [(pixels, R_w_c, fov_deg, payload) for pixels, R_w_c, payload in views]


def _capture(mode: str, pixels: Pixels, view: View, depth: str, origin: str, payload: bytes) -> Capture:
    provenance = {"server": "imported", "file": origin}
    is_ids = mode == "object_mask" and pixels.ndim == 3 and bool((pixels == pixels[..., :1]).all())
    of_masks = "png ids" if is_ids else "png"
    encodings = {"lit": "png", "object_mask": of_masks, "depth": _AS_RECEIVED.get(depth)}
    encoding = encodings[mode] if pixels.dtype == np.uint8 or mode == "depth" or is_ids else None
    if encoding:
        with suppress(BadReplyError):  # other files than these PNGs are converted
            decoded = codecs.decode(payload, encoding, mode, view)
            return Capture(Request(view, mode), view, decoded, provenance, payload, encoding)
    if mode == "depth":
        pixels = _planar_m(pixels, view, depth)
    elif is_ids:
        pixels = pixels[..., 0].astype(np.uint16)
    elif pixels.ndim == 3 and pixels.dtype == np.uint16:
        pixels = np.round(pixels / 257).astype(np.uint8)
    payload, encoding = codecs.encode(np.ascontiguousarray(pixels))
    return Capture(Request(view, mode), view, pixels, provenance, payload, encoding)


def _planar_m(pixels: Pixels, view: View, depth: str) -> NDArray[np.float32]:
    """(H, W) planar metres; +inf for no surface."""
    kind, _, unit = depth.partition("-")
    if depth == "carla":
        raise ArgumentError(f"depth: expected CARLA's 8-bit pictures, got {pixels.dtype}")
    if pixels.dtype == np.uint8:
        raise ArgumentError("depth: expected floats or 16-bit pictures, got 8 bits, which hold no metres")
    plane = pixels[..., 0] if pixels.ndim == 3 else pixels
    metres = plane * _UNITS[unit] / (view.ray_lengths() if kind == "ray" else 1)
    none = ~np.isfinite(metres) | (metres <= 0 if plane.dtype.kind == "u" else metres < 0)
    return np.where(none, np.inf, metres).astype(np.float32)
