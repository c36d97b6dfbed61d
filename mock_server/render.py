"""Traced perspective views of a scene."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mock_server.scene import Hits, Scene

Array = NDArray[np.float64]
Projection = tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class ViewHits(Hits):
    """A perspective view (H, W) in every mode; ``depth`` is planar, float64, metres, +inf for the sky."""

    depth: Array

    @cached_property
    def codes(self) -> NDArray[np.uint8]:
        """(H, W, 3) uint8, ``round(255 c)`` of the colours; computed when first used."""
        return np.round(255 * np.clip(self.paint(), 0, 1)).astype(np.uint8)


def pinhole_rays(
    R_w_c: Array,
    fov_deg: float,
    size: tuple[int, int],
    *,
    rows: slice = slice(None),
    projection: Projection | None = None,
) -> tuple[Array, Array]:
    """Return (H, W, 3) unit directions in the world frame, and (H, W) ray lengths per metre of depth.

    They are of a view of ``size`` (width, height), or of some ``rows`` of it. ``projection`` is fx, fy, cx,
    cy in px; None for square pixels around the middle.
    """
    width, height = size
    focal = width / 2 / np.tan(np.radians(fov_deg) / 2)
    fx, fy, cx, cy = projection or (focal, focal, width / 2, height / 2)
    x = (np.arange(width) + 0.5 - cx) / fx
    y = ((np.arange(height) + 0.5 - cy) / fy)[rows]
    length = np.sqrt(1 + x[None, :] ** 2 + y[:, None] ** 2)
    rays = np.empty((*length.shape, 3))
    for axis, (right, below, ahead) in enumerate(R_w_c):  # a short last axis is slow in NumPy
        rays[..., axis] = (x * right + (y * below)[:, None] + ahead) / length
    return rays, length


def trace_view(
    scene: Scene,
    center: Array,
    rays: Array,
    length: Array,
    hidden: Iterable[str] = frozenset(),
    near_m: float = 0.0,
) -> ViewHits:
    """Trace the rays of :func:`pinhole_rays` from an optical centre (3,), metres.

    Objects that are ``hidden`` are left out; surfaces are seen from a planar depth of ``near_m``.
    """
    skipped = near_m * length
    hits = scene.trace(center + skipped[..., None] * rays if near_m else center, rays, hidden)
    distance = hits.distance + skipped
    return ViewHits(hits.label, distance, hits.normal, hits.paint, distance / length)
