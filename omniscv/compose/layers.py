"""The layers of an image while they are filled, those that are derived from them, and depth without more
digits than are known: what is in memory is what files hold.

The last digits of a composed depth lie far below its bound, and are most of the bytes of its file. Depth is
rounded to multiples of a power of two, at most 1/32 of its bound away; the bound grows by as much.
"""

from collections.abc import Callable, Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv import modalities
from omniscv.compiled import njit
from omniscv.depth.hits import DOUBTFUL
from omniscv.geometry import Array
from omniscv.geometry.arrays import Floats, Ints, Mask, run
from omniscv.sources.base import Color, ObjectTable
from omniscv.sources.labels import labels_of, labels_of_ids

_ROWS = 64
"""Rows whose directions are turned at a time: they are float64 meanwhile."""


MARKS = "label_edge", "unsure"
"""Layers whose pixels are in doubt."""


def doubt_of(layers: Mapping[str, NDArray[Any]], shape: tuple[int, int]) -> Mask:
    """Return (H, W) where the label or depth may be wrong, as far as layers of that shape say it: ``MARKS``,
    and depth that may be off by more than 1 %."""
    doubt = np.zeros(shape, np.bool_)
    for name in MARKS:
        doubt |= layers.get(name, np.False_)
    if "depth" in layers and "depth_error" in layers:
        doubt |= inexact(layers["depth"], layers["depth_error"])
    return doubt


def inexact(depth: NDArray[Any], error: NDArray[Any]) -> Mask:
    """Return where depth with a bound ``error`` may be off by more than 1 %, or has no bound."""
    return np.asarray(~np.isfinite(error) | (error > DOUBTFUL * depth))


class Canvas:
    """The layers of an image while they are filled, flat.

    Args:
        valid: (H, W) of the image.
        central: whether depth is measured from one centre.
        needed: the modes without which a pixel is not valid, where views need not see all of them.
    """

    def __init__(self, valid: Mask, central: bool, needed: Collection[str] = ()) -> None:
        self._valid = valid
        self._central = central
        self._seen = {mode: np.zeros(valid.size, np.bool_) for mode in needed}
        self.flat: dict[str, NDArray[Any]] = {}
        self._centers_w: Array = np.zeros(3) if central else np.zeros((valid.size, 3))

    def put(self, name: str, pixels: Ints, values: NDArray[Any]) -> None:
        """Set a layer's values at the pixels of a viewpoint; at all pixels if there are as many values.

        Args:
            name: of the layer.
            pixels: (N,) flat indices.
            values: (N, ...), or for all pixels.
        """
        if name in self._seen:
            self._seen[name][pixels] = True
        if self._central and len(values) == self._valid.size:
            self.flat[name] = values
        else:
            self.put_part(name, pixels, values)

    def put_part(self, name: str, pixels: Ints, values: NDArray[Any]) -> None:
        """Set the values (N, ...) of the layer of a name at ``pixels``, (N,) flat indices."""
        if name not in self.flat:
            self.flat[name] = np.zeros((self._valid.size, *values.shape[1:]), values.dtype)
        self.flat[name][pixels] = values

    @property
    def sky(self) -> Mask | None:
        """(H, W) where masks show objects that stand for the sky; None if they were not looked for."""
        return self.flat["sky"].reshape(self._valid.shape) if "sky" in self.flat else None

    def put_centers(self, pixels: Ints, centers_w: Array) -> None:
        """Set where depth is measured from: ``centers_w`` (3,), or (N, 3) at flat indices ``pixels`` (N,)."""
        if self._central:
            self._centers_w = centers_w
        else:
            self._centers_w[pixels] = centers_w

    def layers(self) -> dict[str, NDArray[Any]]:
        """Return the layers, (H, W, ...)."""
        shaped = {}
        for name, values in self.flat.items():
            if name == "sky":
                continue
            shaped[name] = values.reshape(*self._valid.shape, *values.shape[1:])
            if (outside := modalities.get(name).outside) or self._seen:
                shaped[name][~self.valid] = outside
        return shaped

    @property
    def valid(self) -> Mask:
        """(H, W) the image's valid pixels, as far as views see them in all needed modes."""
        if not self._seen:
            return self._valid
        seen = np.logical_and.reduce([self._valid.reshape(-1), *self._seen.values()])
        return np.asarray(seen.reshape(self._valid.shape))

    @property
    def centers_w(self) -> Array:
        """(3,) or (H, W, 3) where depth is measured from, world frame, metres."""
        return self._centers_w if self._central else self._centers_w.reshape(*self._valid.shape, 3)


def derived_layers(
    sampled: Mapping[str, NDArray[Any]], valid: Mask, R_w_c: Array, objects_of: Callable[[], ObjectTable]
) -> tuple[dict[str, NDArray[Any]], ObjectTable | None, dict[Color, int]]:
    """Return an image's modalities, in the camera's frame, with the layers that are derived from them.

    Args:
        sampled: mode to (H, W, ...); directions in the world frame.
        valid: (H, W) of the image.
        R_w_c: (3, 3) of the camera.
        objects_of: returns the objects that masks show.

    Returns:
        layers, objects (None without masks), unknown mask colours and the number of their pixels.
    """
    layers: dict[str, NDArray[Any]] = {}
    objects: ObjectTable | None = None
    unknown: dict[Color, int] = {}
    for mode, values in sampled.items():
        row = modalities.get(mode)
        name = "normals" if row.interpolation == "plane" else mode
        turned = row.interpolation in ("direction", "plane")
        layers[name] = _turned(values, R_w_c) if turned else values
        if "labels" in row.derives:
            objects = objects_of()
            if values.ndim == 2:
                labels, layers[name] = labels_of_ids(values, objects)
                ids, counts = np.unique(values[(labels == 0) & (values > 0)], return_counts=True)
                pairs = zip(ids.tolist(), counts.tolist(), strict=True)
                unknown = {(0, i >> 8, i & 255): n for i, n in pairs}
            else:
                labels, unknown = labels_of(values, objects)
            layers["labels"] = np.where(valid, labels, np.uint16(0))
    return layers, objects, unknown


def _turned(directions: NDArray[Any], R_w_c: Array) -> NDArray[np.float32]:
    """Return (H, W, 3) directions in a camera's frame."""
    turned = np.empty(directions.shape, np.float32)
    for first in range(0, len(directions), _ROWS):
        turned[first : first + _ROWS] = directions[first : first + _ROWS] @ R_w_c
    return turned


def mark_beyond_reach(layers: dict[str, NDArray[Any]], valid: Mask) -> None:
    """Tell surfaces that are farther than captures reach from the sky.

    Depth is +inf for both: right without a label, and unsure with one.

    Args:
        layers: of the image; ``depth_error`` and ``unsure`` are changed.
        valid: (H, W).
    """
    if "depth" not in layers or "labels" not in layers:
        return
    endless = valid & (layers["depth"] == np.inf)
    if not endless.any():
        return
    sky = endless & (layers["labels"] == 0) & ~layers["label_edge"] & ~layers["unsure"]
    layers["depth_error"][sky] = 0
    beyond = endless & (layers["labels"] > 0)
    if beyond.any():
        layers["unsure"] = beyond | layers["unsure"]


def mark_other_surfaces(layers: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return an image's layers with a ``label_edge`` where depth says that the surface may be another one.

    A bound above 1 % of depth is that of an edge or of relief between a capture's pixels: the label may be
    the other surface's, too.
    """
    marked = dict(layers)
    if "label_edge" in layers and "depth" in layers and "depth_error" in layers:
        other = np.isfinite(layers["depth"]) & inexact(layers["depth"], layers["depth_error"])
        marked["label_edge"] = layers["label_edge"] | other
    return marked


_PARTS = 32.0  # depth moves by at most its bound divided by this
_LEAST_DIGITS = 11
"""Binary digits that a depth keeps however wide its bound is, as half floats: beside a step it stays on its
surface."""
_DIGITS = 6
"""Binary digits of bounds. Half floats, in which files have them, have 11: the last ones say nothing, and by
measurement all 11 take twice the bytes."""
_HALF_LARGEST = 65504.0
_HALF_STEP = 2.0 ** (-13 - _DIGITS)
"""The largest half float, and the distance between the least ones of so few digits."""
# from there on it has all its digits
_HALF_NORMAL = np.float32(2.0**-14)
_HALF_SCALE = np.float32(2.0**24)
_EXPONENT = 0x7FF << 52  # the bits of a float64 that hold its exponent


def round_depth(depth: Floats, error: Floats) -> tuple[Floats, Floats]:
    """Return depth and ``error``, its bound, (H, W) metres, rounded; neither argument is changed.

    Infinite depth, 0, and depth whose bound is 0 or infinite stay. A bound becomes the next number of six
    binary digits that is not less, as half floats have them; +inf beyond the last.
    """
    rounded = np.empty(depth.size, np.float32)
    bound = np.empty(depth.size, np.float32)
    run(_round_depth, (depth.reshape(-1), error.reshape(-1), rounded, bound))
    return rounded.reshape(depth.shape), bound.reshape(depth.shape)


def as_halves(bounds: Floats) -> NDArray[np.float16]:
    """Return bounds (H, W) >= 0 as half floats: exact where they are rounded, else rounded up."""
    halves = np.empty(bounds.size, np.uint16)
    values = np.ascontiguousarray(bounds, np.float32).reshape(-1)
    run(_half_bits, (values, values.view(np.uint32), halves))
    return halves.view(np.float16).reshape(bounds.shape)


@njit("float32[::1], uint32[::1], out uint16[::1]", nogil=True, error_model="numpy")
def _half_bits(bounds: Floats, bits: NDArray[np.uint32], halves: NDArray[np.uint16]) -> None:
    """A half float has 13 binary digits less than float32, and an exponent that is 112 less; small
    ones count in steps of 2^-24."""
    u32 = np.uint32  # wider integers would not be vectorized
    for i in range(bounds.shape[0]):
        small = u32(np.ceil(min(bounds[i], _HALF_NORMAL) * _HALF_SCALE))
        large = u32((u32(bits[i] + u32(0x1FFF)) >> u32(13)) - u32(112 << 10))
        halves[i] = small if bounds[i] < _HALF_NORMAL else min(large, u32(0x7C00))  # the bits of +inf


@njit("float32[::1], float32[::1], out float32[::1], out float32[::1]", nogil=True, error_model="numpy")
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
