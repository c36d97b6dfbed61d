"""Six faces of one place as a cube: which edges meet, and the steps across them.

A step is the mean difference across an edge, less that between pixels beside it; outlines of masks have none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from omniscv.errors import MissingCaptureError
from omniscv.geometry import Array, Pose, cube_rotations
from omniscv.sources.base import Request, Source, View

SIDES = np.array([(0, -1, 0), (1, 0, 0), (0, 1, 0), (-1, 0, 0)])  # top, right, bottom, left
_SAME = 1e-3  # directions of the middles of edges


class Edge(NamedTuple):
    """Two faces and their sides (top, right, bottom, left) that meet."""

    a: int
    side_a: int
    b: int
    side_b: int


@dataclass(frozen=True, eq=False)
class Cube:
    """Six square pictures of 90 degrees, at one centre, in any orientation, that see every direction."""

    views: tuple[View, ...]
    pixels: NDArray[np.uint8]  # (6, s, s, 3)
    border: int  # px that were captured beyond the 90 degrees on every side, and are left out
    labels: NDArray[np.int64]  # (6, s, s) of the objects; all 0 without masks

    @classmethod
    def of(
        cls, views: Sequence[View], pixels: Sequence[NDArray[Any]], masks: Sequence[NDArray[Any]] = ()
    ) -> Cube | None:
        """Return the cube that views are; None for other views, or pixels of another type than uint8.

        Args:
            views: of the six faces, in any order.
            pixels: (h, w, 3) of each.
            masks: of each, (h, w) ids or (h, w, 3) colours; they may have other sizes than colours.
        """
        alike = {(view.width, view.height, round(view.fov_deg, 3), view.lens) for view in views}
        if len(views) != 6 or len(alike) > 1 or any(picture.dtype != np.uint8 for picture in pixels):
            return None
        border = round(views[0].width / 2 - views[0].focal_px)
        size = views[0].width - 2 * border
        if views[0].lens or views[0].width != views[0].height or border < 0 or size < 2:
            return None
        inner = slice(border, border + size)
        faces = tuple(View(view.pose, 90, size, size) for view in views)
        labels = np.zeros((6, size, size), np.int64)
        for labels_of_face, mask in zip(labels, masks, strict=False):
            rows = (np.arange(border, border + size) + 0.5) * len(mask) // views[0].width
            colors = np.atleast_3d(mask)[np.ix_(rows.astype(int), rows.astype(int))].astype(np.int64)
            labels_of_face[:] = colors @ (1 << 16 * np.arange(colors.shape[-1]))
        cube = cls(faces, np.stack([picture[inner, inner] for picture in pixels]), border, labels)
        return cube if len(cube.edges) == 12 else None

    @classmethod
    def recorded(cls, source: Source, center_w: Array, state: str = "") -> Cube | None:
        """Return the colours of a recording's source at an optical centre; None where they are no cube.

        Args:
            source: of a recording; None is returned for a live one.
            center_w: (3,) the centre, metres, world frame.
            state: of the world.
        """
        views = source.recorded()
        if views is None:
            return None
        six = [View(Pose(center_w, R_w_c), 90, 1, 1) for _, R_w_c in cube_rotations()]
        requests = [Request(view, "lit", state) for view in views.faces(center_w, six)]
        try:
            faces = list(source.capture(requests))
        except MissingCaptureError:  # recorded in other modes only
            return None
        return cls.of([capture.view for capture in faces], [capture.pixels for capture in faces])

    def recolored(self, pixels: NDArray[np.uint8]) -> Cube:
        """Return the cube with other colours (6, h, h, 3), of its border, too."""
        inner = slice(self.border, self.border + self.pixels.shape[1])
        return replace(self, pixels=pixels[:, inner, inner])

    @cached_property
    def edges(self) -> tuple[Edge, ...]:
        """The edges at which two faces meet: twelve."""
        sides = []
        for face, view in enumerate(self.views):
            for side in range(4):
                middle_w = view.pose.R_w_c @ np.add(SIDES[side], (0, 0, 1))
                sides.append((face, side, middle_w))
        edges = []
        for (a, side_a, middle_a), (b, side_b, middle_b) in combinations(sides, 2):
            if a != b and np.abs(middle_a - middle_b).max() < _SAME:
                edges.append(Edge(a, side_a, b, side_b))
        return tuple(edges)

    def lines(self, edge: Edge, depth: int = 2) -> tuple[Array, Array]:
        """Return (depth, s, 3) rows of both faces, the outermost first, in the same order along the edge."""
        a = np.rot90(self.pixels[edge.a], edge.side_a)[:depth].astype(np.float64)
        b = np.rot90(self.pixels[edge.b], edge.side_b)[:depth].astype(np.float64)
        return a, b[:, ::-1]

    def at_edge(self, edge: Edge) -> tuple[Array, Array]:
        """Return (s, 3) colours of both faces on the edge itself, extrapolated from two rows."""
        a, b = self.lines(edge)
        return 1.5 * a[0] - 0.5 * a[1], 1.5 * b[0] - 0.5 * b[1]

    def continuous(self, edge: Edge) -> NDArray[np.bool_]:
        """Return (s,) where both faces show one object, in the order of :meth:`lines`."""
        a = np.rot90(self.labels[edge.a], edge.side_a)
        b = np.rot90(self.labels[edge.b], edge.side_b)
        return np.asarray(a[0] == b[0, ::-1])

    def steps(self) -> Array:
        """Return (12,) steps across the edges, less what pixels beside them differ by; none at outlines."""
        steps = []
        for edge in self.edges:
            continuous = self.continuous(edge)
            a, b = self.lines(edge)
            a = a[:, continuous]
            b = b[:, continuous]
            inside = np.abs(a[0] - a[1]) / 2 + np.abs(b[0] - b[1]) / 2
            steps.append((np.abs(a[0] - b[0]) - inside).mean() if inside.size else 0.0)
        return np.array(steps)
