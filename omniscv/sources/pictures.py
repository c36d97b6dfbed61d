"""Pictures in files, and six faces in memory as a source."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv import modalities
from omniscv.arguments import number, numbers, shown, within
from omniscv.errors import ArgumentError, BadReplyError, MissingCaptureError
from omniscv.geometry import Pose, cube_rotations
from omniscv.geometry.instant import turn_about_z
from omniscv.geometry.trajectory_columns import PER_M
from omniscv.modalities import Transfer
from omniscv.sources.base import Capabilities, Capture, ObjectTable, Request, Source, View
from omniscv.storage.bounded import MOST_PICTURE_BYTES, read_bytes

Pixels = NDArray[Any]
NAMES = tuple(name for name, _ in cube_rotations())
PACKED = {"carla": "png carla", "tartanair": "png float32", "sunrgbd": "png uint16 sunrgbd"}
"""Depth in bits of a PNG that are no plain numbers, planar metres, and the codec that decodes it."""

_NO_ID = 0xFFFF  # of masks, for the -1 of signed numbers
_MOST_M = 1e7  # Blender writes 1e10 for no surface
_MOST_LIGHT = 1e12


class PictureSource(Source):
    """Pictures of one scene that are there, replayed as a recording's are."""

    def __init__(
        self, captures: Sequence[Capture], objects: ObjectTable | None = None, transfer: Transfer = "unknown"
    ) -> None:
        self._captures = {capture.request: capture for capture in captures}
        self._views = tuple(dict.fromkeys(capture.view for capture in captures))
        self._objects = objects or ObjectTable({})
        modes = frozenset(capture.mode for capture in captures)
        self._capabilities = Capabilities(modes=modes, dialect="pictures", transfer=transfer)

    @property
    def capabilities(self) -> Capabilities:
        return self._capabilities

    def recorded_views(self) -> tuple[View, ...]:
        return self._views

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        for request in requests:
            if request not in self._captures:
                raise MissingCaptureError(f"expected one of {len(self._captures)} pictures, got {request}")
            yield self._captures[request]

    def objects(self) -> ObjectTable:
        return self._objects


def from_faces(
    faces: Mapping[str, ArrayLike],
    *,
    position: ArrayLike = (0.0, 0.0, 0.0),
    yaw_deg: float = 0.0,
    fov_deg: float = 90.0,
    objects: ObjectTable | None = None,
    transfer: Transfer = "unknown",
    **modes: Mapping[str, ArrayLike],
) -> PictureSource:
    """Return a source of six faces around one optical centre.

    Args:
        faces: colours by name (front, right, back, left, up, down): (s, s, 3) uint8 or float32. The lower
            edge of up and the upper edge of down touch front.
        position: (3,) of the centre, world frame, metres.
        yaw_deg: of the front face, to the left.
        fov_deg: of every face, at least 90.
        objects, transfer: of masks, and of colours.
        modes: the same faces in other modes, such as ``depth`` ((s, s), planar metres) and ``object_mask``.

    Raises ArgumentError for other names, or faces that are not square and of one size and type.
    """
    number("fov_deg", fov_deg, least=90, below=180)
    center_w = numbers("position", position, (3,))
    turn_w = turn_about_z(yaw_deg)
    captures = []
    for mode, named in {"lit": faces, **modes}.items():
        row = modalities.get(mode)
        if set(named) != set(NAMES):
            raise ArgumentError(f"{mode}: expected faces {', '.join(NAMES)}; got {shown(', '.join(named))}")
        arrays: dict[str, NDArray[Any]] = {name: np.asarray(named[name]) for name in NAMES}
        kinds = {(array.shape, array.dtype.name) for array in arrays.values()}
        shape = arrays[NAMES[0]].shape
        if len(kinds) > 1 or shape[:1] != shape[1:2] or not all(map(row.fits, arrays.values())):
            expected = f"six square faces of one size, {' or '.join(row.dtypes)}"
            raise ArgumentError(f"{mode}: expected {expected}, got {shown(sorted(kinds))}")
        for name, R_w_c in cube_rotations():
            view = View(Pose(center_w, turn_w @ R_w_c), fov_deg, shape[0], shape[0])
            captures.append(Capture(Request(view, row.name), view, arrays[name]))
    return PictureSource(captures, objects, transfer)


class DepthForm(NamedTuple):
    """What the numbers in a picture of depth are."""

    ray: bool = False  # lengths along the ray, not along the optical axis
    per_m: float = 0.0  # how many of them are a metre; 0: not said
    encoding: str = ""  # the codec of depth that is packed in colours
    missing: tuple[float, ...] = ()  # stand for no surface, beside what `codecs.no_surface` has

    @classmethod
    def parse(cls, text: str, missing: tuple[float, ...] = ()) -> DepthForm:
        """Return the form that ``text`` names: ``KIND-UNIT``, as ``planar-mm`` or ``ray-1/512``, or packed.

        ``missing`` are further numbers that stand for no surface.
        """
        if text in PACKED:
            return cls(False, 1.0, PACKED[text], missing)
        kind, _, unit = text.partition("-")
        above, _, below = unit.partition("/")
        per_m = PER_M.get(unit, 0.0)
        if below:
            per_m = number("depth", below, above=0) / number("depth", above, above=0)
        if kind not in ("planar", "ray") or not per_m:
            known = f"planar or ray with a unit, as planar-mm, ray-m or ray-1/512; {', '.join(PACKED)}"
            raise ArgumentError(f"depth: expected one of {known}; got {shown(text)}")
        return cls(kind == "ray", per_m, "", missing)


class Picture(NamedTuple):
    """A picture that :func:`read_picture` has checked.

    Attributes:
        pixels: ``lit``: (H, W, 3) uint8, uint16, or finite float32 of 0 or more. ``depth``: (H, W) float32
            metres, +inf for no surface. ``object_mask``: (H, W) uint16 ids, or (H, W, 3) uint8 colours.
        payload, encoding: the file's bytes and their codec, where one decodes them to this; else empty.
        step_m: between two numbers that the file can hold, of depth in whole numbers; else 0.
        clipped: number of values that are taken as another: negative or NaN light as 0, the largest whole
            number of depth as no surface.
        error: (H, W) metres that depth may be off; None: half of :meth:`steps_m`.
        half_m: metres of a one, of depth that was stored in half floats; else 0.
        lines: what was done, for people.
    """

    pixels: Pixels
    payload: bytes = b""
    encoding: str = ""
    step_m: float = 0.0
    clipped: int = 0
    error: Pixels | None = None
    half_m: float = 0.0
    lines: tuple[str, ...] = ()

    @property
    def steps_m(self) -> float | NDArray[np.float32]:
        """Metres between two numbers that the file can hold: of all, or of each pixel (H, W) in half floats;
        where those show no surface 0, or more if they cannot hold that of a far one."""
        if not self.half_m:
            return self.step_m
        none = ~np.isfinite(self.pixels)
        stored = np.where(none, np.float32(0), self.pixels / np.float32(self.half_m)).astype(np.float16)
        steps = np.spacing(stored).astype(np.float32) * np.float32(self.half_m)
        return np.where(none, np.float32(0 if self.half_m >= 1 else self.half_m), steps)

    def converted(self, pixels: Pixels) -> Picture:
        """Return a picture of other pixels, which the bytes do not hold."""
        return self._replace(pixels=pixels, payload=b"", encoding="")


def read_picture(
    file: Path,
    kind: str = "lit",
    form: DepthForm | None = None,
    clip: bool = False,
    as_codes: bool = False,
) -> Picture:
    """Return a picture that anybody may have made, checked: no other function opens one. Alpha is ignored.

    Args:
        file: of a form of :data:`omniscv.pictures.foreign.SUFFIXES`.
        kind, form: ``lit``, ``depth`` or ``object_mask``, and the form of depth.
        clip: take negative and NaN light as 0.
        as_codes: take 8-bit colours as they are, whatever tags of the file say of them.

    Raises ArgumentError for no regular file, a damaged or too large one, or one that cannot be of the kind.
    """
    from omniscv.pictures import foreign  # imports numba
    from omniscv.sources import tagged_colors

    with within(file.name):
        if kind == "normals":
            raise ArgumentError("expected colours, depth or masks, got normals, whose frame is not known")
        if form is None:
            form = DepthForm()
        if kind == "depth" and form.encoding:
            return _packed_depth(file, form.encoding)
        pixels, payload, tags, lines = foreign.read(file, kind)
        if kind == "depth":
            return _depth(pixels, payload, form)
        if kind == "lit":
            if pixels.dtype.kind == "f" or not as_codes:
                pixels, line = tagged_colors.converted(pixels, tags)
                if line:
                    payload = b""
                    lines += (line,)
            return _colors(pixels, payload, clip)._replace(lines=lines)
        if pixels.dtype.kind == "f" and file.suffix.lower() == ".exr":
            pixels = _whole(pixels)  # which has no whole numbers of 8 or 16 bits
        return _mask(pixels, payload)


def as_8_bits(pixels: Pixels) -> Pixels:
    """Return codes of 16 bits as those of 8; others as they are."""
    return np.round(pixels / 257).astype(np.uint8) if pixels.dtype == np.uint16 else pixels


def _colors(pixels: Pixels, payload: bytes, clip: bool) -> Picture:
    clipped = 0
    if pixels.dtype.kind == "f":
        pixels = pixels.astype(np.float32, copy=False)
        low = ~(pixels >= 0)
        wrong = int(np.count_nonzero(~((pixels >= 0) & (pixels <= _MOST_LIGHT))))
        if wrong and not (clip and (pixels[~low] <= _MOST_LIGHT).all()):
            actual = f"{wrong} of {pixels.size} other values; --clip takes negative and NaN as 0"
            raise ArgumentError(f"expected light of 0 to {_MOST_LIGHT:g}, got {actual}")
        if wrong:
            pixels = np.where(low, np.float32(0), pixels)
            clipped = wrong
    elif pixels.dtype != np.uint16:
        pixels = _fitting(pixels, np.uint8, "uint8, uint16 or floats")
    encoding = "png" if payload and pixels.dtype == np.uint8 else ""
    colors = np.repeat(pixels, 3, axis=-1) if pixels.shape[2] == 1 else pixels
    return Picture(colors, payload, encoding, clipped=clipped)


def _mask(pixels: Pixels, payload: bytes) -> Picture:
    """Return a mask of (H, W, C) whole numbers: ids of one channel, or colours of three."""
    if pixels.dtype.kind == "i":
        pixels = np.where(pixels == -1, _NO_ID, pixels.astype(np.int64))
    if pixels.shape[2] == 1:
        ids = _fitting(pixels[..., 0], np.uint16, "whole numbers")
        return Picture(ids, payload, "png ids" if payload else "")
    colors = _fitting(pixels, np.uint8, "grey ids, or 8-bit colours")
    return Picture(colors, payload, "png" if payload else "")


def _packed_depth(file: Path, encoding: str) -> Picture:
    from omniscv.sources import codecs

    payload = read_bytes(file, MOST_PICTURE_BYTES)
    try:
        view = View(Pose.from_angles((0, 0, 0)), 90, *codecs.picture_size(payload))
        return Picture(codecs.decode(payload, encoding, "depth", view), payload, encoding)
    except BadReplyError as cause:
        raise ArgumentError(str(cause)) from cause


def _depth(pixels: Pixels, payload: bytes, form: DepthForm) -> Picture:
    """Return depth of (H, W, C) numbers that a file holds; all channels must be equal."""
    from omniscv.sources.codecs import no_surface

    grey = np.repeat(pixels[..., :1], pixels.shape[2], axis=2)
    is_float = pixels.dtype.kind == "f"
    if not np.array_equal(pixels, grey, equal_nan=is_float) or pixels.dtype == np.uint8:
        actual = f"{pixels.dtype} colours, which are no metres"
        raise ArgumentError(f"expected floats or 16 bits a pixel, got {actual}")
    if not is_float and not form.per_m:
        raise ArgumentError("expected the unit of whole numbers, such as --depth planar-mm, got none")
    per_m = form.per_m or 1.0
    if is_float:
        stored = pixels[..., 0].astype(np.float32)
        metres = np.asarray(stored * (1 / per_m), np.float32)
    else:
        stored = _fitting(pixels[..., 0], np.uint32, "floats or whole numbers")
        metres = np.asarray(stored / per_m, np.float32)
    none = no_surface(pixels[..., 0], form.missing, per_m)
    wrong = ((metres < 0) | (metres > _MOST_M)) & ~none
    if count := np.count_nonzero(wrong):
        advice = f"if that is no surface, --missing {stored[wrong][0]:.9g}"
        actual = f"{count} of {wrong.size} values such as {metres[wrong][0]:.6g} m"
        raise ArgumentError(f"expected 0 to {_MOST_M:g} m, got {actual}; {advice}")
    known = np.where(none, np.float32(np.inf), metres)
    if is_float:
        half_m = 1 / per_m if pixels.dtype == np.float16 else 0.0
        return Picture(known, payload, half_m=half_m)
    clipped = 0 if form.missing else int(np.count_nonzero(none & (stored != 0)))
    encoding = ""
    if payload and not form.ray and pixels.shape[2] == 1:
        encoding = _whole_encoding(stored, none, per_m)
    return Picture(known, payload, encoding, 1 / per_m, clipped)


def _whole_encoding(stored: Pixels, none: NDArray[np.bool_], per_m: float) -> str:
    """Return the codec that decodes a PNG of whole numbers to the same depth; empty if there is none."""
    from omniscv.sources.codecs import encodings

    encoding = f"png uint16 {per_m:g}"
    none_of_codec = (stored == 0) | (stored == 0xFFFF)
    if encoding in encodings() and np.array_equal(none, none_of_codec):
        return encoding
    return ""


def _whole(pixels: Pixels) -> Pixels:
    """Return floats that are whole numbers as such; ArgumentError for others."""
    wrong = ~(pixels == np.round(pixels))
    if wrong.any():
        actual = f"{np.count_nonzero(wrong)} of {pixels.size} others such as {pixels[wrong][0]:g}"
        raise ArgumentError(f"expected ids that are whole numbers, without anti-aliasing, got {actual}")
    return np.clip(pixels.astype(np.float64), -1, 2.0**31 - 1).astype(np.int64)


def _fitting(pixels: Pixels, dtype: type[np.integer[Any]], expected: str) -> Pixels:
    """Return whole numbers as another type, if all fit."""
    limit = int(np.iinfo(dtype).max)
    if pixels.dtype.kind not in "iu" or pixels.min() < 0 or pixels.max() > limit:
        actual = f"{pixels.dtype} of {pixels.min()} to {pixels.max()}"
        raise ArgumentError(f"expected {expected} of 0 to {limit}, got {actual}")
    return pixels.astype(dtype, copy=False)
