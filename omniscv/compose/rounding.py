"""Depth and its bound with no more digits than are known: what is in memory is what files hold.

The last digits of a composed depth lie far below its bound, and are most of the bytes of its file. Depth is
rounded to multiples of a power of two, at most 1/32 of its bound away; the bound grows by as much.
"""

import numpy as np
from numpy.typing import NDArray

from omniscv.compiled import njit
from omniscv.geometry.arrays import Floats, Ints, run

_PARTS = 32.0
"""Depth moves by at most its bound divided by this."""
_LEAST_DIGITS = 11
"""Binary digits that a depth keeps however wide its bound is, as half floats: beside a step it stays on its
surface."""
_DIGITS = 6
"""Binary digits of bounds. Half floats, in which files have them, have 11: the last ones say nothing, and by
measurement all 11 take twice the bytes."""
_HALF_LARGEST, _HALF_LEAST = 65504.0, 2.0**-14
"""The largest half float; and the least one with all its digits, below which they are evenly spaced."""
_HALF_STEP = _HALF_LEAST * 2.0 ** (1 - _DIGITS)
_EXPONENT = 0x7FF << 52  # the bits of a float64 that hold its exponent


def round_depth(depth: Floats, error: Floats) -> tuple[Floats, Floats]:
    """Return depth and its bound (H, W), metres, rounded; neither argument is changed.

    Infinite depth, 0, and depth whose bound is 0 or infinite stay. A bound becomes the next number of six
    binary digits that is not less, as half floats have them; +inf beyond the last.
    """
    rounded, bound = np.empty(depth.size, np.float32), np.empty(depth.size, np.float32)
    run(_round_depth, (depth.reshape(-1), error.reshape(-1), rounded, bound))
    return rounded.reshape(depth.shape), bound.reshape(depth.shape)


def as_halves(bounds: Floats) -> NDArray[np.float16]:
    """Return bounds (H, W) >= 0 as half floats: exact where they are rounded, else rounded up."""
    halves = np.empty(bounds.size, np.uint16)
    flat = np.ascontiguousarray(bounds).reshape(-1)
    run(_as_halves, (flat, flat.view(np.int32), halves))
    return halves.view(np.float16).reshape(bounds.shape)


@njit(cache=True, nogil=True, error_model="numpy")
def _round_depth(depth: Floats, error: Floats, rounded: Floats, bound: Floats) -> None:
    """Without branches, so that the loop is vectorized. A power of two is a number without its mantissa."""
    for i in range(depth.shape[0]):
        d, e = np.float64(depth[i]), np.float64(error[i])
        wanted, leading = np.float64(e * (2.0 / _PARTS)), np.float64(d * 2.0**-_LEAST_DIGITS)
        step_bits = np.int64(min(wanted.view(np.int64), leading.view(np.int64)) & _EXPONENT)
        step = step_bits.view(np.float64)
        # Without finer digits in float32, or for 0 and infinity, the depth stays.
        moves = (step > leading * 2.0 ** (_LEAST_DIGITS - 23)) & (d < np.inf) & (e < np.inf)
        wider = np.float64(e + 0.5 * step if moves else e)
        step_bits = np.int64(wider.view(np.int64) & _EXPONENT)
        above_step = max(step_bits.view(np.float64) * 2.0 ** (1 - _DIGITS), _HALF_STEP)
        above = np.ceil(wider / above_step) * above_step
        rounded[i] = np.rint(d / step) * step if moves else d
        bound[i] = above if above <= _HALF_LARGEST else np.inf


@njit(cache=True, nogil=True, error_model="numpy")
def _as_halves(bounds: Floats, bits: Ints, halves: Ints) -> None:
    """The bits of floats have the order of their values: exponent, then 23 digits of float32 or 10 of half
    floats."""
    for i in range(bounds.shape[0]):
        kept = bits[i] + ((1 << (24 - _DIGITS)) - 1) >> (24 - _DIGITS)  # rounded up
        kept = min(kept - ((127 - 15) << (_DIGITS - 1)), 0x1F << (_DIGITS - 1))  # at most +inf
        tiny = np.int32(np.ceil(min(bounds[i], np.float32(_HALF_LEAST)) / np.float32(_HALF_STEP)))
        halves[i] = (kept if bounds[i] >= np.float32(_HALF_LEAST) else tiny) << (11 - _DIGITS)
