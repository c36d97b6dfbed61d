"""What rays meet in captured depth, and what a strategy knows of it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from omniscv.geometry import Array
from omniscv.geometry.arrays import Floats, Ints, Mask

_SAME_SURFACE = 0.003  # relative to the reach: rays that end nearer to each other meet the same surface
_APART = 0.02
"""Of the reach: parts of a ray that two centres are unsure of, nearer to each other, may be at one edge."""
_SHORT = 0.25
"""Of the reach: a hidden part up to this long widens the bound, a longer one makes the pixel unsure."""
_MARGIN = 1.3  # by which a neighbouring surface may go on beyond the pixels that show it

_NOWHERE: Mask = np.zeros((), np.bool_)

DOUBTFUL = 0.01
"""Of the depth: it is inexact where it may be off by more."""

FAR_M = 1e12
"""Distance at which the direction to a point of the sky is the ray's own."""


class KnownDepth(NamedTuple):
    """What is known of the depth of N pixels, and what it says to other modalities.

    Attributes:
        distance: (N,) float32 metres along the pixels' own rays, +inf no surface, 0 where no view sees it.
        error: (N,) float32 metres, bound on the error of ``distance``; +inf where nothing bounds it.
        direction_error: (N,) float32 radians, how far from where a pixel is looked up its own surface may
            show; None for rays from their own origins.
        grazes: (N,) bool, whether a ray passes within a capture's pixel of another surface on its way.
        unsure: (N,) bool, not verified by any capture.
        relief: (N,) bool, whether relief makes depth doubtful.
    """

    distance: Floats
    error: Floats
    direction_error: Floats | None = None
    grazes: Mask = _NOWHERE
    unsure: Mask = _NOWHERE
    relief: Mask = _NOWHERE


class Hits(np.recarray[Any, Any]):
    """What N rays meet: a record for each.

    Attributes:
        reach: (N,) metres along each ray, +inf for the sky, NaN where it is unknown.
        error: (N,) bound on the error of ``reach``, metres, where the ray passes all that is beside it; +inf
            where nothing bounds it.
        direction_error: (N,) radians, bound on the resulting error of the direction from the centre.
        hidden_from, hidden_to: (N,) metres along the ray, the part of it that the centre does not see;
            +inf and -inf if it sees all.
        beside_from, beside_to: (N,) metres along the ray, the part of it where another surface is within a
            pixel; +inf and -inf if none is.
        sure: (N,) whether all of the way is visible from the centre.
        grazes: (N,) whether the ray hardly passes behind the surface that it meets.
    """

    reach: Array
    error: Array
    direction_error: Array
    hidden_from: Array
    hidden_to: Array
    beside_from: Array
    beside_to: Array
    sure: Mask
    grazes: Mask

    @classmethod
    def unknown(cls, count: int) -> Hits:
        """Return the hits of rays of which nothing is known."""
        return np.full(count, _UNKNOWN).view(cls)

    def of(self, rows: Ints | Mask) -> Hits:
        """Return the hits of some of the rays."""
        return self[rows].view(Hits)

    def known_depth(self) -> KnownDepth:
        """Return the depth of the rays' pixels; a short hidden part of the way, and what is beside it, add to
        its error.

        Rays that end nowhere are hidden from +inf to -inf, and unsure.
        """
        with np.errstate(invalid="ignore"):
            hidden = np.where(self.sure, 0.0, self.reach - self.hidden_from)
            beside = self.beside_from <= self.beside_to
            may_be_nearer = np.fmax(hidden, np.where(beside, _MARGIN * (self.reach - self.beside_from), 0.0))
            long = ~(np.abs(self.hidden_to - self.hidden_from) <= _SHORT * self.reach)
        return KnownDepth(
            self.reach.astype(np.float32),
            np.fmax(self.error, may_be_nearer).astype(np.float32),
            self.direction_error.astype(np.float32),
            self.grazes | beside | ~self.sure,
            ~self.sure & long,
        )

    def distrust(self, rows: Mask) -> None:
        """Mark some of N hits as unsure, and their rays as hidden all the way."""
        self.sure[rows] = False
        self.hidden_from[rows] = 0.0
        self.hidden_to[rows] = np.inf

    @property
    def _end(self) -> Interval:
        """(N,) from and to where rays end, metres along them; beyond an edge they may meet anything."""
        same = _SAME_SURFACE * self.reach
        nearer = np.where(np.isfinite(self.error), self.error, 0.0)
        with np.errstate(invalid="ignore"):
            least = np.where(np.isposinf(self.reach), np.inf, self.reach - nearer - same)
        return least, self.reach + self.error + same

    def narrow(self, others: Hits) -> Mask:
        """Leave in doubt only what another centre does not see free: where it ends, or is in doubt, too.

        A ray ends where its centre says, or somewhere that its centre is unsure of. So two centres together
        are unsure only of what both are unsure of.

        Returns:
            (N,) whether the other centre does not contradict the end; other rays are left as they are.
        """
        hidden = (self.hidden_from, self.hidden_to)
        beside = (self.beside_from, self.beside_to)
        unseen = _wider(others.hidden_from, others.hidden_to)
        near = _wider(others.beside_from, others.beside_to)
        end = _wider(*others._end)
        start, stop = _common((self._end, unseen), (self._end, near), (self._end, others._end))
        agree = np.asarray(start <= stop)
        still_hidden = _common((hidden, unseen), (hidden, end))
        still_beside = _common((beside, unseen), (beside, near), (beside, end), (hidden, near))
        self.hidden_from[agree] = still_hidden[0][agree]
        self.hidden_to[agree] = still_hidden[1][agree]
        self.beside_from[agree] = still_beside[0][agree]
        self.beside_to[agree] = still_beside[1][agree]
        self.sure[agree] = self.hidden_from[agree] > self.hidden_to[agree]
        return agree


Interval = tuple[Array, Array]
"""From and to, (N,) each; empty where it ends before it begins."""


def _wider(start: Array, end: Array) -> Interval:
    """Return an interval that is wider by what two centres may be apart at one edge."""
    return start * (1 - _APART), end * (1 + _APART)


def _common(*pairs: tuple[Interval, Interval]) -> Interval:
    """Return the least intervals that hold what is in both of any pair."""
    starts = np.array([np.maximum(a[0], b[0]) for a, b in pairs])
    ends = np.array([np.minimum(a[1], b[1]) for a, b in pairs])
    overlap = starts <= ends
    return np.where(overlap, starts, np.inf).min(axis=0), np.where(overlap, ends, -np.inf).max(axis=0)


HIT = np.dtype(
    [(name, np.float64 if kind == "Array" else np.bool_) for name, kind in Hits.__annotations__.items()]
)
_UNKNOWN = np.array((np.nan, np.inf, 0.0, np.inf, -np.inf, np.inf, -np.inf, False, False), HIT)
