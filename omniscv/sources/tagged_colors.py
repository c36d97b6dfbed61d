"""Colours as the tags of their file say: converted to sRGB, or to light of Rec. 709."""

import io
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv import light
from omniscv.arguments import shown
from omniscv.errors import ArgumentError
from omniscv.pictures.color_tags import REC_709, Colors

_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
"""From XYZ to the cones that are scaled by white."""
_SAME_CODES = 2  # levels by which a profile of sRGB may differ from it
_BELOW_BLACK = 1e-3  # of the brightest channel: light below 0 by rounding alone
_REMEDY = "convert the picture, or --transfer srgb takes its codes as they are"


def converted(pixels: NDArray[Any], colors: Colors) -> tuple[NDArray[Any], str]:
    """Return colours as sRGB codes of 8 bits, or as light of Rec. 709 in floats, and a line on what was done.

    Args:
        pixels: (H, W, 1 or 3) as the file has them.
        colors: what the file's tags say of them. Without a tag they are returned as they are.

    Raises:
        ArgumentError: colours whose meaning is not exactly known.
    """
    if colors.is_plain:
        return pixels, ""
    is_float = pixels.dtype.kind == "f"
    if is_float and (colors.refused or colors.profile):
        actual = colors.refused or f"{colors.tag} beside floats"
        raise ArgumentError(f"expected light of Rec. 709, got {actual}; convert it")
    if colors.refused:
        raise ArgumentError(f"expected colours in sRGB, got {colors.refused}; {_REMEDY}")
    if colors.profile:
        return _by_profile(pixels, colors.profile)
    said = f"colours are converted by {colors.tag}"
    to_rec709 = _to_rec709(colors.primaries)
    if is_float:
        shown_light = np.repeat(pixels, 3, axis=-1) if pixels.shape[2] == 1 else pixels
        values = (shown_light * np.array(colors.gain)) @ to_rec709.T
        slight = np.maximum(values.max(axis=-1, keepdims=True), 0) * _BELOW_BLACK
        return np.where((values < 0) & (values >= -slight), 0, values).astype(np.float32), said
    return _by_curve(pixels, colors.power, to_rec709), said


def _by_curve(pixels: NDArray[Any], power: float, to_rec709: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return sRGB codes (H, W, 3) of codes of 8 or 16 bits."""
    white = int(np.iinfo(pixels.dtype).max)
    values = np.arange(white + 1) / white
    table = values**power if power else light.srgb_to_light(values)
    shown_light = np.repeat(table[pixels], 3 if pixels.shape[2] == 1 else 1, axis=-1) @ to_rec709.T
    codes = 255 * light.light_to_srgb(np.clip(shown_light, 0, 1))
    return np.asarray(np.round(codes), np.uint8)


def _to_rec709(primaries: Sequence[float]) -> NDArray[np.float64]:
    """Return the matrix (3, 3) from light of some primaries to that of Rec. 709; white stays white."""
    own = _xyz_of_rgb(REC_709)
    theirs = _xyz_of_rgb(primaries)
    if not np.isfinite(theirs).all():
        raise ArgumentError(f"expected chromaticities of three colours, got {shown([*primaries])}")
    cones = (_BRADFORD @ own.sum(axis=1)) / (_BRADFORD @ theirs.sum(axis=1))
    adapted = np.linalg.inv(_BRADFORD) @ np.diag(cones) @ _BRADFORD
    return np.asarray(np.linalg.inv(own) @ adapted @ theirs)


def _xyz_of_rgb(primaries: Sequence[float]) -> NDArray[np.float64]:
    """Return the matrix (3, 3) from light of primaries to XYZ, white of luminance 1; NaN without one."""
    xy = np.reshape(primaries, (4, 2)).astype(np.float64)
    if not (np.isfinite(xy).all() and (xy[:, 1] > 0).all()):
        return np.full((3, 3), np.nan)
    xyz = np.column_stack([xy[:, 0], xy[:, 1], 1 - xy.sum(axis=1)]) / xy[:, 1:]
    columns = xyz[:3].T
    if abs(np.linalg.det(columns)) < 1e-9:
        return np.full((3, 3), np.nan)
    return np.asarray(columns * np.linalg.solve(columns, xyz[3]))


def _by_profile(pixels: NDArray[Any], profile: bytes) -> tuple[NDArray[Any], str]:
    """Return colours of an ICC profile as sRGB codes; as they are where the profile is sRGB's."""
    from PIL import Image, ImageCms

    codes = pixels if pixels.dtype == np.uint8 else np.round(pixels / 257).astype(np.uint8)
    mode = "L" if pixels.shape[2] == 1 else "RGB"
    try:
        source = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        name = ImageCms.getProfileDescription(source).strip()
        target = ImageCms.createProfile("sRGB")
        transform = ImageCms.buildTransform(
            source, target, mode, "RGB", ImageCms.Intent.RELATIVE_COLORIMETRIC
        )
    except (ImageCms.PyCMSError, OSError, ValueError, TypeError) as cause:
        expected = "expected an ICC profile that converts to sRGB"
        raise ArgumentError(f"{expected}, got: {shown(str(cause))}; {_REMEDY}") from cause

    def apply(colors: NDArray[np.uint8]) -> NDArray[np.uint8]:
        image = Image.fromarray(colors[..., 0] if mode == "L" else colors)
        return np.array(ImageCms.applyTransform(image, transform))

    if _is_srgb(apply, 1 if mode == "L" else 3):
        return pixels, ""
    return apply(np.ascontiguousarray(codes)), f"colours are converted by the ICC profile {shown(name)}"


def _is_srgb(apply: Callable[[NDArray[np.uint8]], NDArray[np.uint8]], channels: int) -> bool:
    """Return whether codes stay by a conversion to sRGB."""
    levels = np.arange(0, 256, 15, dtype=np.uint8)
    grid = np.stack(np.meshgrid(*[levels] * channels), axis=-1).reshape(1, -1, channels)
    same = np.repeat(grid, 3 // channels, axis=-1).astype(np.int64)
    return int(np.abs(apply(grid).astype(np.int64) - same).max()) <= _SAME_CODES
