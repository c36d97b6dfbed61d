"""Counter-based random numbers: the noise of a frame depends on its identity alone.

Philox 4x64-10 maps a key and a counter to four words. The key identifies frame and camera, the counter the
pixels and the purpose. So tiles, threads, shards and resumed jobs get the same numbers, in any order.
Source: Salmon et al., Parallel random numbers: as easy as 1, 2, 3, SC 2011.

Only raw words are used: NumPy keeps those from release to release, but not its distributions.
"""

import hashlib
import json
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.compiled import njit
from omniscv.geometry.arrays import Floats

PIXEL = 0
ROW = 1
PRNU = 2
DSNU = 3
"""Purposes: a pixel's shot and read noise, half a word for each of the two; row noise; fixed patterns."""

_STEP_BITS = 6
_STEPS = 1 << _STEP_BITS
"""Intervals per octave of the table of normal numbers; linear interpolation in them is exact to 3e-5."""
_MANTISSA = 52
_BIAS = 1023
"""Of float64: bits of the mantissa, and what is added to the exponent."""
_EXPANDED = 10.0
"""Mean from which a Poisson number is an expansion about the normal one: to 3e-4 of probability."""
_MOST = 200
"""Electrons at which a search stops: more than a mean below ten can become."""


def key(seed: int, camera: str, frame: Any = None) -> NDArray[np.uint64]:
    """Return the key (2,) of a dataset's seed, a camera by its name, and plain values that identify a frame;
    None for noise that all frames of the camera share."""
    text = json.dumps(["omniscv.noise 1", seed, camera, frame], separators=(",", ":"), ensure_ascii=True)
    return np.frombuffer(hashlib.blake2b(text.encode(), digest_size=16).digest(), "<u8").astype(np.uint64)


def words(key: NDArray[np.uint64], purpose: int, plane: int, start: int, count: int) -> NDArray[np.uint64]:
    """Return words (count,) of pixels.

    Args:
        key: of :func:`key`.
        purpose: of the numbers, such as :data:`PIXEL`.
        plane: of the pixels, from 0.
        start: the first pixel, counted row by row.
        count: of pixels from there on.
    """
    skipped = start % 4
    philox = np.random.Philox(key=key, counter=[start // 4, plane, purpose, 0])
    return np.asarray(philox.random_raw(skipped + count)[skipped:])


def normals(key: NDArray[np.uint64], purpose: int, plane: int, start: int, count: int) -> NDArray[np.float64]:
    """Return normal numbers (count,) of mean 0 and variance 1.

    Args:
        key: of :func:`key`.
        purpose: of the numbers, such as :data:`ROW`.
        plane: of the pixels or rows, from 0.
        start: the first of them.
        count: of them from there on.
    """
    # Of 52 bits: with 53, a number can round to 1, and its quantile is infinite.
    from scipy.special import ndtri  # slow to load

    uniform = ((words(key, purpose, plane, start, count) >> np.uint64(12)) + 0.5) * 2.0**-52
    return np.asarray(ndtri(uniform))


@cache
def quantiles() -> NDArray[np.float64]:
    """Return the table of normal numbers for :func:`expose`.

    Entry k is the quantile of x / 2^33, where k / 64 is the exponent and mantissa of the number x, from 1 to
    2^32, in the form of a floating-point number.
    """
    from scipy.special import ndtri  # slow to load

    octave, step = np.divmod(np.arange(32 * _STEPS + 1), _STEPS)
    return np.asarray(ndtri(np.ldexp(1 + step / _STEPS, octave) / 2.0**33))


@njit(nogil=True, inline="always")
def _normal(half: Any, table: Any) -> float:
    """Return the normal number of 32 random bits: the highest is its sign."""
    bits = np.float64(np.int64(2 * (half & np.uint64(0x7FFFFFFF)) + np.uint64(1))).view(np.int64)
    i = (bits >> (_MANTISSA - _STEP_BITS)) - (_BIAS << _STEP_BITS)
    rest = bits & ((1 << (_MANTISSA - _STEP_BITS)) - 1)
    z = table[i] + rest * 2.0 ** (_STEP_BITS - _MANTISSA) * (table[i + 1] - table[i])
    return float(z if half >> np.uint64(31) else -z)


@njit(nogil=True, inline="always")
def _poisson(mean: float, half: Any, table: Any) -> float:
    """Return the Poisson number of a mean by 32 random bits."""
    if mean <= 0.0:
        return 0.0
    if mean >= _EXPANDED:
        z, root = _normal(half, table), np.sqrt(mean)
        return float(np.rint(mean + root * z + (z * z - 1.0) / 6.0 - z * (z * z + 2.0) / (72.0 * root)))
    u, n = (np.float64(half) + 0.5) * 2.0**-32, 0
    p = np.exp(-mean)
    total = p
    while total < u and n < _MOST:
        n += 1
        p *= mean / n
        total += p
    return float(n)


@njit(
    "float32[:, ::1], uint64[:, ::1], float32[:, :, ::1], float64[:, ::1], out uint16[:, ::1], "
    "float64[::1], float64[::1]",
    nogil=True,
)
def expose(light: Floats, words: Any, fixed: Any, rows: Any, codes: Any, table: Any, numbers: Any) -> None:
    """Write the codes (h, w) of some rows of a sensor.

    Args:
        light, words, codes: (h, w).
        fixed: (h, w, 2) non-uniformity, as a share and in electrons.
        rows: (h, 3) electrons: of light 1.0 in the 1st, 3rd, ... and in the other columns; noise of the row.
        table: of :func:`quantiles`.
        numbers: electrons of dark signal, full well, standard deviation of read noise; codes per electron, of
            no light, and the highest.
    """
    height, width = light.shape
    dark, well, read, gain, black, top = numbers
    for y in range(height):
        for x in range(width):
            word = words[y, x]
            mean = light[y, x] * rows[y, x & 1] * (1.0 + fixed[y, x, 0]) + dark
            n = min(max(_poisson(mean, word >> np.uint64(32), table), 0.0), well)
            total = n + fixed[y, x, 1] + rows[y, 2]
            if read > 0.0:
                total += read * _normal(word & np.uint64(0xFFFFFFFF), table)
            codes[y, x] = min(max(np.rint(gain * total + black), 0.0), top)
