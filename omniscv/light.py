"""Light of colours, by the transfer of their source: :data:`omniscv.modalities.Transfer`.

Light is linear: light of 0.5 is half of light of 1.0, which is the white of 8 bits. Means, blur and noise are
of light; codes are decoded before and encoded again afterwards.

========== ===========================================================================================
linear     a code is proportional to light
srgb       IEC 61966-2-1
film       sRGB behind the default tone curve of Unreal Engine since 4.15. It is right for greys, and nearly
           for dull colours; saturated colours pass a matrix in the engine that no table can undo.
unknown    nothing is known: codes are averaged as they are
========== ===========================================================================================

Floating-point colours are light already, whatever the transfer.
"""

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.compiled import njit
from omniscv.geometry.arrays import Floats, Pixels, run

_BINS = 1 << 12
"""Bins of light from 0 to 1 that a search for a code starts at: of sRGB each holds two codes at most."""

# A response is solved:
_CHOSEN = 80  # pixels of each picture by which it is solved
_JUDGED = (20, 235)  # the least and the largest code by which it is compared with named ones
_NAMED = 0.03  # by which the logarithm of light may be off
_LEAST = 1e-9  # the least light that has a logarithm

_SLOPE = 0.88
_TOE = 0.55
_SHOULDER = 0.26
_BLACK_CLIP = 0.0
_WHITE_CLIP = 0.04
_GREY = 0.18
"""The film curve's defaults, as the engine's documentation of FilmStockSettings gives them."""


def srgb_to_light(values: Any) -> NDArray[np.float64]:
    """Return light of sRGB values 0..1."""
    v = np.asarray(values, np.float64)
    return np.where(v <= 0.04045, v / 12.92, ((np.maximum(v, 0.04045) + 0.055) / 1.055) ** 2.4)


def light_to_srgb(light: Any) -> NDArray[np.float64]:
    """Return sRGB values of light 0..1, not rounded."""
    x = np.asarray(light, np.float64)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 0.0031308) ** (1 / 2.4) - 0.055)


def film_curve(light: Any) -> NDArray[np.float64]:
    """Return the display's light 0..1 that Unreal Engine's default tone curve makes of grey light.

    A straight line in the logarithm of light between two logistic curves, the toe and the shoulder.
    """
    toe = 1 + _BLACK_CLIP - _TOE
    shoulder = 1 + _WHITE_CLIP - _SHOULDER
    middle = (_GREY + _BLACK_CLIP) / toe - 1
    toe_at = np.log10(_GREY) - 0.5 * np.log((1 + middle) / (1 - middle)) * toe / _SLOPE
    straight = (1 - _TOE) / _SLOPE - toe_at
    shoulder_at = _SHOULDER / _SLOPE - straight
    x = np.log10(np.maximum(np.asarray(light, np.float64), 1e-12))
    line = _SLOPE * (x + straight)
    low = -_BLACK_CLIP + 2 * toe / (1 + np.exp(-2 * _SLOPE * (x - toe_at) / toe))
    high = 1 + _WHITE_CLIP - 2 * shoulder / (1 + np.exp(2 * _SLOPE * (x - shoulder_at) / shoulder))
    low = np.where(x < toe_at, low, line)
    high = np.where(x > shoulder_at, high, line)
    t = np.clip((x - toe_at) / (shoulder_at - toe_at), 0, 1)
    if shoulder_at < toe_at:
        t = 1 - t
    share = t * t * (3 - 2 * t)
    return np.asarray(np.clip(low + (high - low) * share, 0, None))


def light_of_codes(codes: Any, transfer: str | NDArray[np.float64]) -> NDArray[np.float64]:
    """Return light of codes 0..255, which need not be whole; of ``unknown`` as if they were linear.

    Args:
        codes: (...)
        transfer: a name, or the light (256,) of each code.
    """
    if not isinstance(transfer, str):
        return np.asarray(np.interp(codes, np.arange(256), transfer))
    values = np.asarray(codes, np.float64) / 255
    if transfer == "srgb":
        return srgb_to_light(values)
    if transfer == "film":
        light = np.concatenate([[0.0], np.logspace(-9, 3, 1 << 16)])
        return np.asarray(np.interp(srgb_to_light(values), film_curve(light) * (light > 0), light))
    return values


def decode(colors: Pixels, transfer: str) -> NDArray[np.float32]:
    """Return light (...) float32 of ``colors`` (...): of uint8 by their ``transfer``, of floats as they
    are."""
    if colors.dtype != np.uint8:
        return np.asarray(colors, np.float32)
    import cv2  # slow to load

    codes = np.ascontiguousarray(colors).reshape(1, -1)
    return np.asarray(cv2.LUT(codes, _tables(transfer)[0])).reshape(np.shape(colors))


def encode(light: Floats, transfer: str) -> NDArray[np.uint8]:
    """Return the nearest codes (...) uint8, by a ``transfer``, of ``light`` (...); NaN becomes 0, and what is
    brighter than white 255."""
    _, thresholds, starts, scale = _tables(transfer)
    codes = np.empty(light.shape, np.uint8)
    run(_encode, (np.ascontiguousarray(light, np.float32).ravel(), codes.ravel()), thresholds, starts, scale)
    return codes


def merge(
    pictures: Sequence[NDArray[np.uint8]], stops: Sequence[float], transfer: str | NDArray[np.float64]
) -> NDArray[np.float32]:
    """Return light (H, W, 3) at exposure 0 of pictures of one scene at several exposures.

    The mean is weighted by the inverse variance of rounding, the noise of a renderer. A pixel whose channels
    are 0 or 255 in a picture is left out of it; if that is all pictures, the one nearest to it counts: the
    darkest for bright pixels. Source: Granados et al., Optimal HDR reconstruction with linear digital
    cameras, 2010.

    Args:
        pictures: (H, W, 3) codes.
        stops: exposure of each, powers of two.
        transfer: of the codes, as :func:`light_of_codes` takes it.
    """
    light = light_of_codes(np.arange(256), transfer)
    step = np.diff(light_of_codes(np.arange(257) - 0.5, transfer))
    step[[0, 255]] = np.inf  # of no weight; a response ends there
    total = np.zeros(pictures[0].shape)
    weights = np.zeros(pictures[0].shape)
    fallback = (light / 2.0 ** max(stops))[pictures[int(np.argmax(stops))]]
    for i in np.argsort(stops)[::-1]:
        codes = pictures[i]
        time = 2.0 ** stops[i]
        shown = (light / time)[codes]
        bright = (codes == 255).any(axis=-1, keepdims=True)
        weight = ((time / step) ** 2)[codes] * ~(bright | (codes == 0).any(axis=-1, keepdims=True))
        total = total + weight * shown
        weights = weights + weight
        fallback = np.where(bright, shown, fallback)
    return np.asarray(np.where(weights > 0, total / np.maximum(weights, 1e-300), fallback), np.float32)


def solve(pictures: Sequence[NDArray[np.uint8]], stops: Sequence[float]) -> str | NDArray[np.float64]:
    """Return the transfer of one still scene's pictures at known exposures.

    Its name, if a known one is within 3 %; else light (256,) of each code, in a unit of its own: its mean
    logarithm is that of sRGB. Source: Debevec, Malik, Recovering high dynamic range radiance maps from
    photographs, 1997.

    Args:
        pictures: (...) codes, all of one shape.
        stops: exposure of each, powers of two.
    """
    import cv2  # slow to load

    flat = np.stack([np.ravel(codes) for codes in pictures])
    pixels = np.unique(np.concatenate([_chosen(codes) for codes in flat]))
    debevec = cv2.createCalibrateDebevec(len(pixels), 10.0, False)
    solved = debevec.process([*flat[:, None, pixels]], np.exp2(np.array(stops, np.float32)))
    logs = np.log(np.clip(np.ravel(solved).astype(np.float64), _LEAST, 1 / _LEAST))
    seen = np.unique(flat[:, pixels].clip(*_JUDGED))
    apart = {}
    for name in ("srgb", "film", "linear"):
        named = np.log(np.maximum(light_of_codes(np.arange(256), name), _LEAST))
        apart[name] = (logs - named)[seen]
    nearest = min(apart, key=lambda name: float(apart[name].std()))
    if apart[nearest].std() <= _NAMED:
        return nearest
    return np.asarray(np.maximum.accumulate(np.exp(logs - apart["srgb"].mean())))


def _chosen(codes: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Return pixels of a picture, by index: one of each of up to ``_CHOSEN`` codes."""
    _, first = np.unique(codes, return_index=True)
    return np.asarray(first[np.arange(_CHOSEN) * len(first) // _CHOSEN])


def known(transfer: str, colors: Pixels) -> bool:
    """Return whether the mean of ``colors``, codes by a ``transfer``, is not the mean of their light, and how
    to correct it is known."""
    return colors.dtype == np.uint8 and transfer in ("srgb", "film")


@cache
def _tables(transfer: str) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], np.float32]:
    """Return light by code; the least light of codes 1 to 255; a code to search from for each
    bin of light; bins per light."""
    light = light_of_codes(np.arange(256), transfer).astype(np.float32)
    least = light_of_codes(np.arange(255) + 0.5, transfer)
    thresholds = least.astype(np.float32)
    low = thresholds < least  # rounded down: float32 light that equals it is below the true one
    thresholds[low] = np.nextafter(thresholds[low], np.float32(np.inf))
    scale = np.float32(_BINS / light[-1])
    starts = np.searchsorted(thresholds, np.arange(_BINS + 1) / float(scale), side="right")
    # Rounding may put light into the next bin, so the search starts one code lower.
    return light, thresholds, np.maximum(starts - 1, 0).astype(np.uint8), scale


@njit("float32[::1], out uint8[::1], float32[::1], uint8[::1], float32", nogil=True)
def _encode(light: Any, codes: Any, thresholds: Any, starts: Any, scale: Any) -> None:
    last = starts.shape[0] - 1
    for i in range(light.shape[0]):
        x = light[i]
        if not x > 0:
            codes[i] = 0
            continue
        at = x * scale
        code = int(starts[int(at)]) if at < last else 254
        while code < 255 and x >= thresholds[code]:
            code += 1
        codes[i] = code
