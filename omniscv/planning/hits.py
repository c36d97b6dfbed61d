"""What rays meet in captured depth, and what a strategy knows of it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from omniscv.geometry import Array
from omniscv.geometry.arrays import Floats, Ints, Mask

_SAME_SURFACE = 0.003  # relative to the reach: rays that end nearer to each other meet the same surface
_SHORT = 0.25
"""Of the reach: a hidden part up to this long widens the bound, a longer one makes the pixel unsure."""

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
        error: (N,) bound on the error of ``reach``, metres; +inf where nothing bounds it.
        direction_error: (N,) radians, bound on the resulting error of the direction from the centre.
        hidden_from, hidden_to: (N,) metres along the ray, the part of it that the centre does not see;
            +inf and -inf if it sees all.
        beside_from, beside_to: (N,) metres along the ray, the part of it where another surface is within a
            pixel; +inf and -inf if none is.
        sure: (N,) whether all of the way is visible from the centre.
        grazes: (N,) whether the ray passes within a pixel of another surface on its way.
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
        """Return the depth of the rays' pixels; a short hidden part of the way adds to its error.

        Rays that end nowhere are hidden from +inf to -inf, and unsure.
        """
        with np.errstate(invalid="ignore"):
            may_be_nearer = np.where(self.sure, 0.0, self.reach - self.hidden_from)
            long = ~(np.abs(self.hidden_to - self.hidden_from) <= _SHORT * self.reach)
        return KnownDepth(
            self.reach.astype(np.float32),
            np.fmax(self.error, may_be_nearer).astype(np.float32),
            self.direction_error.astype(np.float32),
            self.grazes | ~self.sure,
            ~self.sure & long,
        )

    def distrust(self, rows: Mask) -> None:
        """Mark some of N hits as unsure, and their rays as hidden all the way."""
        self.sure[rows], self.hidden_from[rows], self.hidden_to[rows] = False, 0.0, np.inf

    def join(self, others: Hits) -> Mask:
        """Combine with hits of the same rays from another centre, where both end at the same surface.

        Two centres together may see all of a ray of which each sees a part.

        Returns:
            (N,) whether both end at the same surface.
        """
        with np.errstate(invalid="ignore"):
            off = np.where(self.reach == others.reach, 0.0, np.abs(self.reach - others.reach))
            same = off <= self.error + others.error + _SAME_SURFACE * self.reach
            vague = others.error > _SAME_SURFACE * self.reach  # it may be the surface beside this one
        open_ = same & ~self.sure
        self.hidden_from[open_] = np.maximum(self.hidden_from, others.hidden_from)[open_]
        self.hidden_to[open_] = np.minimum(self.hidden_to, others.hidden_to)[open_]
        self.sure[open_] = self.hidden_from[open_] >= self.hidden_to[open_]
        grazing = open_ & (others.grazes | vague)
        self.grazes[grazing] = True
        self.beside_from[grazing] = np.minimum(self.beside_from, others.beside_from)[grazing]
        self.beside_to[grazing] = np.maximum(self.beside_to, others.beside_to)[grazing]
        self.error[grazing] = np.maximum(self.error, off + others.error)[grazing]
        return np.asarray(same)


_UNKNOWN = np.array(
    (np.nan, np.inf, 0.0, np.inf, -np.inf, np.inf, -np.inf, False, False),
    [(name, np.float64 if kind == "Array" else np.bool_) for name, kind in Hits.__annotations__.items()],
)
