"""Depth as it is stored: how exactly, what rounding makes of it, and its inverse."""

import math
from typing import Any, NamedTuple

import numpy as np

from omniscv.compiled import fields, njit

FLOAT32 = 2.0**-24  # relative rounding error
COMPUTED = 1.6  # depth along the ray is rounded again, and so is the pixel that gives its length
_EXPONENT = 0x7FF << 52  # the bits of a float64 that hold its exponent
LEAST_M = 1e-9  # a server may send a depth of 0
STEP = 0.0025
"""How far neighbours on one surface may lie off the line through the other two, relative to their depth: more
than half floats jump (0.05 %). All lengths are relative, so that the same holds at every scale."""
_ONE = np.float32(1)
_LEAST = np.float32(LEAST_M)


@fields("float64, int64, bool, float64, float64, float64, float64")
class Precision(NamedTuple):
    """How exactly a picture of depth was stored.

    Attributes:
        unit_m: of the stored values, metres.
        digits: significant binary digits: 11 of half floats, 24 of floats.
        along_ray: whether distances to the optical centre were stored, not planar depth.
        largest_m: farther surfaces are stored as no surface.
        middle_px: how far from the middle of its pixel a depth may have been taken, across and down.
        off_m, share: how far planar depth may be off beside its digits: metres, such as half the step of
            whole numbers, and a share of the depth.
    """

    unit_m: float = 1.0
    digits: int = 24
    along_ray: bool = False
    largest_m: float = math.inf
    middle_px: float = 0.0
    off_m: float = 0.0
    share: float = 0.0


@njit(nogil=True)
def stored_length(r: int, c: int, shape: tuple[int, int], focal: float, precision: Precision) -> float:
    """Return the stored value of a planar depth of 1 m at pixel (r, c), metres."""
    if not precision.along_ray:
        return 1.0
    u, v = (c + 0.5 - shape[1] / 2) / focal, (r + 0.5 - shape[0] / 2) / focal
    return float(np.sqrt(1.0 + u * u + v * v))


@njit(nogil=True, error_model="numpy", forceinline=True)
def rounding(z: float, length: float, precision: Precision) -> float:
    """Return the largest error of a stored planar depth z, metres; ``length`` is its
    :func:`stored_length`."""
    # Slightly more: 128 cm is stored with the step above it, and comes as 1.28 m rounded down.
    stored = z * length / precision.unit_m * (1.0 + 8 * FLOAT32)
    # 2^floor(log2(stored)). math.frexp is a call, which keeps loops from being vectorized: 3 times slower.
    power = np.int64(np.float64(stored).view(np.int64) & _EXPONENT).view(np.float64)
    step = precision.unit_m / np.float64(np.int64(1) << precision.digits) * power
    return float(step / length + (COMPUTED * FLOAT32 + precision.share) * z + precision.off_m)


@njit(nogil=True, error_model="numpy", forceinline=True)
def inverse_depth(z: float) -> float:
    """Return 1 / z, 0 where there is no surface."""
    return float(1.0 / max(z, LEAST_M))


@njit(nogil=True, error_model="numpy", forceinline=True)
def inverse_depth32(z: Any) -> Any:
    """Return 1 / z, 0 where there is no surface, of a float32."""
    return _ONE / max(z, _LEAST)
