"""Decode and encode captures, the same for live, recorded and imported ones.

The end of this file registers encodings, as other packages may; docs/capture-folders.md describes them.
"""

import re
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from omniscv import modalities
from omniscv.arguments import number, numbers, shown
from omniscv.errors import ArgumentError, BadReplyError
from omniscv.geometry.precision import Precision
from omniscv.geometry.unreal_frame import direction_from_unreal
from omniscv.pictures import MAX_PIXELS, npy, png
from omniscv.sources.base import Capture, View

Decoder = Callable[[bytes, str, View], NDArray[Any]]
"""``decoder(payload, mode, view)`` gives pixels as :class:`omniscv.sources.base.Capture` describes them."""

NEAR_MIDDLE = "npy 0.005 px"
BOUNDED = "npy bounded"
RESAMPLED = "npy resampled"
"""Resampled depth shows the pixels of another picture, whose steps are no relief."""

_PFM = re.compile(rb"Pf\s+(\d{1,5})\s+(\d{1,5})\s+(-?[0-9.eE+-]{1,20})\s")
_TARTANAIR_FAR_M = 10_000.0
_CARLA_STEP_M = 1000 / (2**24 - 1)

UNREAL_SKY = 65504.0  # the largest half float: what servers send for no surface, in their unit
_HALF_DIGITS = 11  # significant binary digits of the half floats through which the engine passes depth
_UNIT_TOLERANCE = 0.1  # how far the length of an 8-bit normal may be from 1; the sky's grey is near 0


class _Codec(NamedTuple):
    decoder: Decoder
    modes: Sequence[str] | None
    precision: Precision

    def encodes(self, mode: str) -> bool:
        """Return whether it is an encoding of a mode."""
        return self.modes is None or mode in self.modes


def register(
    encoding: str, decoder: Decoder, modes: Sequence[str] | None = None, precision: Precision | None = None
) -> None:
    """Add an encoding, or replace the one of its name; recordings are decoded by it, too.

    Args:
        encoding: its name, as recordings have it.
        decoder: a function of payload, mode and view that returns the pixels.
        modes: those that it encodes; None for all.
        precision: of its depth; None for that of floats in metres.
    """
    _codecs[encoding] = _Codec(decoder, modes, precision or Precision())


def encodings() -> tuple[str, ...]:
    """Return the names of all encodings."""
    return tuple(_codecs)


def precision(capture: Capture) -> Precision:
    """Return the precision of a capture of depth.

    It is that of its encoding, or of floats if the encoding is not known. Two keys of the provenance change
    it: ``half_floats`` has the metres of a one, and whether depth is along the ray; ``depth_error`` has
    metres and a share by which depth may be off in addition.
    """
    known = _codecs[capture.encoding].precision if capture.encoding in _codecs else Precision()
    if "half_floats" in capture.provenance:
        unit_m, along_ray = numbers("half_floats", capture.provenance["half_floats"], (2,)).tolist()
        known = _of_halves(number("half_floats", unit_m, above=0), bool(along_ray))
    elif capture.encoding in ("npy", NEAR_MIDDLE) and _holds_halves(capture.payload):
        known = _of_halves(1.0, False)._replace(middle_px=known.middle_px)
    if "depth_error" not in capture.provenance:
        return known
    off_m, share = numbers("depth_error", capture.provenance["depth_error"], (2,)).tolist()
    if min(off_m, share) < 0:
        actual = f"{off_m:g}, {share:g}"
        raise ArgumentError(f"depth_error: expected metres and a share of 0 or more, got {actual}")
    return known._replace(off_m=known.off_m + off_m, share=known.share + share)


def _of_halves(unit_m: float, along_ray: bool) -> Precision:
    return Precision(unit_m, _HALF_DIGITS, along_ray, largest_m=UNREAL_SKY * unit_m)


def _holds_halves(payload: bytes | memoryview | None) -> bool:
    return payload is not None and npy.layout(bytes(payload[: npy.HEADER_BYTES]))[1] == np.float16


def error_of(capture: Capture) -> NDArray[np.float32] | None:
    """Return (H, W) how far the distance along the rays of a capture of depth may be off beside its
    precision, metres; None where nothing more is known, +inf where nothing bounds it."""
    if capture.encoding in (BOUNDED, RESAMPLED) and capture.payload is not None:
        return decode_npy(capture.payload, capture.view)[..., 1].copy()
    return None


def decode(payload: bytes, encoding: str, mode: str, view: View) -> NDArray[Any]:
    """Return the pixels of a capture, read-only, as :class:`omniscv.sources.base.Capture` describes them.

    Args:
        payload: the bytes as received.
        encoding: the name of their codec.
        mode: what the capture is of.
        view: what was captured.

    Raises:
        BadReplyError: the payload is not what the encoding, the mode and the view say.
    """
    codec = _codecs.get(encoding)
    if codec is None or not codec.encodes(mode):
        known = []
        for name, other in _codecs.items():
            if other.encodes(mode):
                known.append(name)
        raise BadReplyError(f"encoding of {mode}: expected one of {', '.join(known)}; got {shown(encoding)}")
    pixels = codec.decoder(payload, mode, view)
    pixels.flags.writeable = False
    return pixels


def encode(pixels: NDArray[Any]) -> tuple[bytes, str]:
    """Return bytes and encoding of pixels, lossless: PNG for three channels of uint8, else NPY."""
    if pixels.dtype == np.uint8 and pixels.shape[2:] == (3,):
        return png.encode(pixels), "png"
    return npy.encode(pixels), "npy"


def payload_of(capture: Capture) -> tuple[bytes, str]:
    """Return the bytes and encoding of a capture, encoded if it has none; BadReplyError for wrong pixels."""
    pixels = capture.pixels
    row = modalities.get(capture.mode)
    size = capture.view.height, capture.view.width
    ids = bool(row.derives) and pixels.dtype == np.uint16 and pixels.ndim == 2
    if not (ids or row.fits(pixels)) or pixels.shape[:2] != size:
        shape = (*size, row.channels) if row.channels else size
        dtypes = " or ".join(row.dtypes)
        actual = f"{pixels.dtype}, shape {pixels.shape}"
        raise BadReplyError(f"expected {row.name} of {dtypes}, shape {shape}; got {actual}")
    if capture.payload is not None and capture.encoding in encodings():
        return bytes(capture.payload), capture.encoding
    if row.interpolation == "surface":
        check_depth(pixels)
    payload, encoding = encode(pixels)
    return payload, NEAR_MIDDLE if capture.encoding == NEAR_MIDDLE else encoding


def picture_size(payload: bytes) -> tuple[int, int]:
    """Return width and height in the header of a PNG or NPY; BadReplyError for other bytes or sizes."""
    if payload.startswith(npy.SIGNATURE):
        (height, width, *_), *_ = npy.layout(payload)
    else:
        width, height, *_ = png.header(payload)
    if not 0 < width * height <= MAX_PIXELS:
        raise BadReplyError(f"expected a picture of 1 to {MAX_PIXELS} pixels, got {width} x {height}")
    return width, height


def check_png(payload: bytes, view: View) -> None:
    """Raise BadReplyError unless the header of ``payload`` is that of a PNG of the view's size."""
    bits = png.header(payload).bits
    width, height = picture_size(payload)
    if (width, height) != (view.width, view.height):
        expected = f"{view.width} x {view.height}"
        actual = f"{bits}-bit {width} x {height}"
        raise BadReplyError(f"expected a PNG of {expected}, got {actual}")


def decode_png(payload: bytes, view: View) -> NDArray[np.uint8]:
    """Return (H, W, 3) RGB of ``payload``, a PNG of the size of ``view``.

    The header is checked first, so that no larger picture is decoded.
    """
    import cv2

    check_png(payload, view)
    pixels = png.decode(payload)
    channels = pixels.shape[2]
    if channels == 3:
        return np.ascontiguousarray(pixels)
    if channels == 4:
        return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_RGBA2RGB))
    return np.asarray(cv2.cvtColor(pixels[..., :1], cv2.COLOR_GRAY2RGB))


def decode_npy(payload: bytes, view: View) -> NDArray[Any]:
    """Return the payload as a read-only array of the view's size, any channels; it is never unpickled."""
    array = npy.decode(payload)
    if array.shape[:2] != (view.height, view.width):
        actual = f"{array.dtype} {array.shape}"
        raise BadReplyError(f"expected NPY of {view.height} rows, {view.width} columns, got {actual}")
    return array


def no_surface(stored: NDArray[Any], missing: Sequence[float] = (), per_m: float = 1.0) -> NDArray[np.bool_]:
    """Return where numbers of depth, as programs write them, stand for no surface.

    ======================  ==================================================================================
    any                     0, and those of ``missing``
    floats                  NaN, infinity, and 65504 and more, which half floats cannot hold: kilometres
    whole numbers           the largest of their type, if ``missing`` names none
    ======================  ==================================================================================

    In mm, more than 65504 are taken as they are.

    Args:
        stored: the numbers, of any shape.
        missing: further numbers that stand for no surface.
        per_m: how many of them are a metre.
    """
    is_float = stored.dtype.kind == "f"
    none = (stored == 0) | np.isin(stored, np.array(missing, stored.dtype if is_float else np.float64))
    if is_float:
        far = stored >= UNREAL_SKY if per_m <= 100 else stored == UNREAL_SKY
        none |= far | ~np.isfinite(stored)
    elif not missing:
        none |= stored == np.iinfo(stored.dtype).max
    return np.asarray(none)


def without_zeros(payload: bytes) -> bytes:
    """Return an NPY of float depth as recordings hold it: all that stands for no surface is infinite."""
    array = npy.decode(payload)
    none = no_surface(array) if array.dtype.kind == "f" else np.zeros(array.shape, np.bool_)
    return npy.encode(np.where(none, array.dtype.type(np.inf), array)) if none.any() else payload


def check_depth(array: NDArray[Any]) -> None:
    """Raise BadReplyError for another shape than (H, W), no floats, or values that are negative or NaN."""
    if array.ndim != 2 or array.dtype.kind != "f":
        raise BadReplyError(f"expected float depth of shape (H, W), got {array.dtype} of shape {array.shape}")
    if not array.min() >= 0:  # NaN is not >= 0
        wrong = f"{np.count_nonzero(~(array >= 0))} of {array.size} values negative or NaN"
        raise BadReplyError(f"expected depth of 0 or more, got {wrong}")


def _png_colors(payload: bytes, mode: str, view: View) -> NDArray[Any]:
    row = modalities.get(mode)
    if row.channels != 3 or "uint8" not in row.dtypes:
        raise BadReplyError(f"encoding of {mode}: expected npy, got 'png'")
    return decode_png(payload, view)


def _npy_pixels(payload: bytes, mode: str, view: View) -> NDArray[Any]:
    array = decode_npy(payload, view)
    row = modalities.get(mode)
    if row.interpolation == "surface":
        check_depth(array)
        return array.astype(row.dtypes[0])
    if row.derives and array.ndim == 2 and array.dtype.kind == "u":  # instance ids in place of colours
        if array.max() > 0xFFFF:
            raise BadReplyError(f"expected instance ids of at most {0xFFFF}, got {array.max()}")
        return array.astype(np.uint16)
    if array.shape[2:] != ((row.channels,) if row.channels else ()):
        raise BadReplyError(f"expected {row.channels or 1} channels of {mode}, got shape {array.shape}")
    return array.copy()


def _bounded(payload: bytes, mode: str, view: View) -> NDArray[Any]:
    array = decode_npy(payload, view)
    if array.shape[2:] != (2,) or array.dtype != np.float32 or not array[..., 1].min() >= 0:
        raise BadReplyError(f"expected float32 depth and its error, got {array.dtype} of shape {array.shape}")
    check_depth(array[..., 0])
    return np.ascontiguousarray(array[..., 0])


def _png(payload: bytes, view: View, bits: int, channels: tuple[int, ...]) -> NDArray[Any]:
    """Return (H, W, C) of a PNG of the view's size with so many bits and channels."""
    check_png(payload, view)
    pixels = png.decode(payload, bits)
    if pixels.shape[2] not in channels:
        raise BadReplyError(f"expected a PNG with {channels} channels, got {pixels.shape[2]}")
    return pixels


def _float32(payload: bytes, mode: str, view: View) -> NDArray[Any]:
    blue_first = _png(payload, view, 8, (4,))[..., [2, 1, 0, 3]]
    depth = np.ascontiguousarray(blue_first).view("<f4")[..., 0]
    check_depth(depth)
    return np.where(depth >= _TARTANAIR_FAR_M, np.inf, depth).astype(np.float32)


def _carla(payload: bytes, mode: str, view: View) -> NDArray[Any]:
    colors = _png(payload, view, 8, (3, 4))[..., :3]
    depth = colors @ np.array([1.0, 256.0, 65536.0]) * _CARLA_STEP_M
    return np.where((colors == 0xFF).all(axis=-1), np.inf, depth).astype(np.float32)


def _uint16(scale: float, payload: bytes, mode: str, view: View) -> NDArray[Any]:
    stored = _png(payload, view, 16, (1,))[..., 0]
    none = (stored == 0) | (stored == 0xFFFF)
    return np.where(none, np.inf, stored / scale).astype(np.float32)


def _sunrgbd(payload: bytes, mode: str, view: View) -> NDArray[Any]:
    stored = _png(payload, view, 16, (1,))[..., 0]
    mm = (stored >> 3 | stored << 13).astype(np.uint16)
    return np.where((mm == 0) | (mm == 0xFFFF), np.inf, mm / 1000).astype(np.float32)


def _ids(payload: bytes, mode: str, view: View) -> NDArray[Any]:
    pixels = _png(payload, view, 16 if payload[24:25] == b"\x10" else 8, (1, 3))
    if (pixels != pixels[..., :1]).any():
        raise BadReplyError("expected a grey PNG of ids, got colours")
    return np.asarray(pixels[..., 0], np.uint16)


def _pfm(ray: bool, payload: bytes, mode: str, view: View) -> NDArray[Any]:
    header = _PFM.match(payload)
    if header is None or (int(header[1]), int(header[2])) != (view.width, view.height):
        raise BadReplyError(f"expected a PFM of {view.width} x {view.height}, got {payload[:30]!r}")
    if len(payload) - header.end() != 4 * view.width * view.height:
        raise BadReplyError(f"expected {4 * view.width * view.height} bytes of pixels in a PFM")
    order = "<f4" if header[3].startswith(b"-") else ">f4"
    depth = np.frombuffer(payload, order, offset=header.end()).reshape(view.height, view.width)
    depth = np.where(no_surface(depth), np.float32(np.inf), depth)
    check_depth(depth)
    return np.asarray(depth / (view.ray_lengths() if ray else 1), np.float32)


def show_light(codes: NDArray[np.uint8]) -> bool:
    """Return whether colours (H, W, 3) of normals are the lit image's, as of branch 5.2 before 2026-03-11.

    Most of them are no directions, and not the grey of the sky either.
    """
    n = codes * (2 / 255) - 1
    length = np.sqrt(np.einsum("...k,...k->...", n, n))
    return bool(((np.abs(length - 1) >= _UNIT_TOLERANCE) & (length >= _UNIT_TOLERANCE)).mean() > 0.5)


def _unreal_normals(payload: bytes, mode: str, view: View) -> NDArray[Any]:
    n = decode_png(payload, view).astype(np.float32)
    n *= np.float32(2 / 255)
    n -= 1
    direction_from_unreal(n)
    length = np.sqrt(np.einsum("...k,...k->...", n, n))
    known = np.abs(length - 1) < _UNIT_TOLERANCE
    n *= np.divide(1, length, out=np.zeros_like(length), where=known)[..., None]
    return np.asarray(n)


def _unreal_depth(ray: bool, payload: bytes, mode: str, view: View) -> NDArray[Any]:
    array = decode_npy(payload, view)
    check_depth(array)
    depth = np.asarray(array / (view.ray_lengths() if ray else 100), dtype=np.float32)
    np.copyto(depth, np.inf, where=array >= UNREAL_SKY)
    return depth


_codecs: dict[str, _Codec] = {}
register("png", _png_colors)
register("npy", _npy_pixels)
register(NEAR_MIDDLE, _npy_pixels, ("depth",), Precision(middle_px=0.005))
register(BOUNDED, _bounded, ("depth",))
register(RESAMPLED, _bounded, ("depth",))
register("png float32", _float32, ("depth",))
register("png carla", _carla, ("depth",), Precision(off_m=_CARLA_STEP_M / 2))
register("png uint16 sunrgbd", _sunrgbd, ("depth",), Precision(largest_m=65.535, off_m=0.5e-3))
register("png ids", _ids, ("object_mask",))
register("pfm planar", partial(_pfm, False), ("depth",))
register("pfm ray", partial(_pfm, True), ("depth",), Precision(along_ray=True))
for _scale in (100, 256, 1000, 4000, 5000, 6553.5):
    _whole = Precision(largest_m=0xFFFF / _scale, off_m=0.5 / _scale)
    register(f"png uint16 {_scale}", partial(_uint16, float(_scale)), ("depth",), _whole)
register("png normal", _unreal_normals, ("normals",))
register("npy planar cm", partial(_unreal_depth, False), ("depth",), _of_halves(0.01, False))
register("npy ray m", partial(_unreal_depth, True), ("depth",), _of_halves(1.0, True))
