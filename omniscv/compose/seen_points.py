"""Points that rays meet, seen from an optical centre that is not their own.

A capture from another centre can only claim what is visible from both. So each ray is marched through the
depth that was captured at the shared centre, and through the small pictures of depth at the camera's
position (:mod:`omniscv.planning.viewpoints`): each sees a part of the ray's way. Where they agree on what the
ray meets, and together see all of the way, the point is known. Depth and labels are then bounded at that
point, pixel by pixel.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from omniscv.compose.samplers import Sampler
from omniscv.depth.depth_shell import depth_shell
from omniscv.depth.hits import FAR_M, Hits, KnownDepth
from omniscv.depth.ray_marching import march
from omniscv.geometry import Array
from omniscv.geometry.arrays import Faces, Floats, Mask, Pixels
from omniscv.sources.base import Capture

_ROUNDED = 2.0**-22
"""Relative rounding errors of depth, of the point's depth and of their difference, all float32."""


class SeenPoints(NamedTuple):
    """The points that N rays meet.

    Attributes:
        known: their depth along the rays, from the rays' own origins; what is not visible from the shared
            centre counts as another surface.
        toward_w: (N, 3) from the shared centre to them, of any length; NaN where unknown.
    """

    known: KnownDepth
    toward_w: Array

    @classmethod
    def find(
        cls, captures: Sequence[Capture], origins_w: Array, directions_w: Array, around: Hits
    ) -> SeenPoints:
        """Return the points that N rays meet.

        Args:
            captures: depth from the shared centre.
            origins_w, directions_w: (N, 3), unit directions.
            around: what the rays meet, as far as the camera's position sees it.
        """
        center_w = captures[0].view.pose.t_w_c
        hits = march(depth_shell(center_w, captures, cube=False), origins_w, directions_w)
        visible = ~np.isnan(hits.reach)
        agree = hits.narrow(around)
        better = ~agree & ~hits.sure & (around.sure | ~visible)
        hits[better] = around[better]
        reach = np.where(np.isposinf(hits.reach), FAR_M, hits.reach)[:, None]
        toward_w = origins_w + reach * directions_w - center_w
        known = hits.known_depth()
        return cls(known._replace(grazes=known.grazes | ~visible | better), toward_w)

    def bound(self, distance: Floats) -> Floats:
        """Return (N,) the bound on the error of depth; +inf where nothing bounds it."""
        with np.errstate(invalid="ignore"):
            off = np.where(distance == self.known.distance, 0, np.abs(distance - self.known.distance))
            rounded = np.where(np.isfinite(distance), _ROUNDED * distance, 0)
        bound = off + self.known.error + rounded
        return np.nan_to_num(bound, nan=np.inf, posinf=np.inf).astype(np.float32)

    def label_edges(self, toward: Sampler, faces: Faces, boundaries: Pixels, values: Pixels) -> Mask:
        """Return (N,) whether labels may be others than those at the points.

        Args:
            toward: samples the faces in the directions of ``toward_w``.
            faces, boundaries: masks from the shared centre, and where their values change.
            values: (N, ...) of the rays, as the image shows them.
        """
        there = toward.sample("nearest", faces)
        seen = toward.sample("nearest", [np.ones(face.shape[:2], np.bool_) for face in faces])
        differs = (there != values).reshape(len(values), -1).any(axis=1)
        at_edge = toward.label_edges(boundaries, self.known.direction_error)
        return np.asarray(differs | ~seen | at_edge | self.known.grazes)
