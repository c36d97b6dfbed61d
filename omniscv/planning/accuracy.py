"""The rounds of an image whose accuracy is given.

Colours are captured as fine as the image needs, ground truth first coarsely, then finer where the image is in
doubt (:mod:`omniscv.planning.refinement`). Images with several optical centres are captured from few
(:mod:`omniscv.planning.several_centers`).
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import closing
from dataclasses import replace

import numpy as np

from omniscv.geometry.arrays import Ints
from omniscv.planning import strategy
from omniscv.planning.cube_faces import FACE_BORDER_PX
from omniscv.planning.densities import SMALLEST
from omniscv.planning.refinement import ROOM, Choice, Doubt, Refinement, first_view
from omniscv.planning.rounds import Kept, Round, Rounds, Viewpoint, pass_on, pixels_of
from omniscv.planning.several_centers import SeveralCenters
from omniscv.planning.strategy import Task

_LARGEST = 8 * SMALLEST
"""px of the first faces of ground truth, at most."""
_PROBED = 2
"""Views in which an image of more views is measured first."""
_CAPS, _STEEP = 0.2, 0.7
"""Density of edges in faces that look up or down, relative to others, and the least sine of their pitch."""

_Probed = Generator[Round, Kept | None, int]


def rounds(task: Task) -> Rounds:
    """Return the rounds of a task's strategy; with ``accuracy``, and finer ones until it is reached.

    Then the last round has no viewpoints, and says why captures stop.

    Raises:
        ArgumentError: as :func:`omniscv.planning.strategy.rounds`.
    """
    return strategy.rounds(task) if task.options.accuracy is None else _refinement(task).rounds()


def expected(task: Task) -> tuple[int, int]:
    """Return how many requests and pixels a task's accuracy is expected to take in a furnished room."""
    return _refinement(task).expected()


def _refinement(task: Task) -> Refinement:
    return OneCenter(task) if task.rays.origins is None else SeveralCenters(task)


class OneCenter(Refinement):
    """The captures of an image whose rays start at one optical centre."""

    def rounds(self) -> Rounds:
        yield from self.counted(self._rounds())

    def _rounds(self) -> Rounds:
        kept = yield from self._first()
        if kept is not None:
            yield from self.finer(kept)

    def doubts(self, pixels: Ints) -> list[Doubt]:
        directions_w = self.task.directions_w(pixels)
        return [Doubt(0, self.task.pose.t_w_c, pixels, directions_w, self.focal_px[pixels])]

    def capture(self, choice: Choice) -> Generator[Round, Kept | None, Kept | None]:
        for each in choice.patches:
            self.focal_px[each.pixels] = choice.focal_px
        by_size = sorted(choice.patches, key=lambda each: (each.patch.view.width, each.patch.view.height))
        return (
            yield Round(
                tuple(
                    Viewpoint(each.patch.view.pose.t_w_c, (each.patch.view,), each.pixels, self.truth)
                    for each in by_size
                )
            )
        )

    def _first(self) -> Generator[Round, Kept | None, Kept | None]:
        """Yield captures of all that the image shows: ground truth as coarse as the aim allows."""
        task = self.task
        base = self._faces(task.edge)
        if base is None or not self._sizes_free() or not self.truth:
            return (yield from pass_on(strategy.rounds(task)))
        if self.colors:
            yield Round((replace(base, modes=self.colors),))
        small = self._faces(SMALLEST) or base
        face_of = first_view(task.directions_w(base.pixels), small.views, FACE_BORDER_PX)
        probed = _PROBED if len(small.views) > _PROBED else 0
        if probed:
            edge = yield from self._probe(base, small, face_of)
        else:
            edge = self._best_edge(ROOM, base)
        self.expected_ms = self.local_ms(ROOM, edge)
        faces, pixels = self._faces(edge) or base, base.pixels
        if edge == SMALLEST:
            faces, pixels = replace(small, views=small.views[probed:]), pixels[face_of >= probed]
        self.focal_px[:] = faces.views[0].focal_px
        return (yield Round((replace(faces, pixels=pixels, modes=self.truth),)))

    def _probe(self, base: Viewpoint, small: Viewpoint, face_of: Ints) -> _Probed:
        """Yield the first small faces, and return the size of faces that promises to reach the aim for least.

        Args:
            base, small: the views of colours, and those of the smallest faces.
            face_of: (N,) the small view that shows each pixel.
        """
        probed = face_of < _PROBED
        first = replace(small, views=small.views[:_PROBED], pixels=base.pixels[probed], modes=self.truth)
        kept = yield Round((first,))
        if kept is None or kept.doubt is None:
            return self._best_edge(ROOM, base)
        dense = np.array([_CAPS if abs(view.pose.R_w_c[2, 2]) > _STEEP else 1.0 for view in small.views])[
            face_of
        ]
        share = np.count_nonzero(kept.doubt()) / max(1.0, dense[probed].sum()) * dense.mean()
        return self._best_edge(share, base)

    def _sizes_free(self) -> bool:
        """Return whether ground truth may be captured in another size than colours."""
        options, capabilities = self.task.options, self.task.capabilities
        return options.face_size == "auto" and options.truth_scale == 1 and capabilities.can_set_size

    def _faces(self, edge: int) -> Viewpoint | None:
        """Return the only viewpoint of a central camera, with views as fine as faces of a size; else None."""
        task = self.task
        sized = replace(task, options=replace(task.options, face_size=edge))
        planned = strategy.rounds(task if edge == task.edge else sized)
        with closing(planned):
            viewpoints = next(planned).viewpoints
        return viewpoints[0] if len(viewpoints) == 1 else None

    def _best_edge(self, share: float, base: Viewpoint) -> int:
        """Return the size of the first faces of ground truth that promises to reach the aim for least.

        Args:
            share: of the pixels that the smallest faces leave in doubt.
            base: the views of colours.
        """
        count, area = len(base.views), pixels_of(base.views)
        modes = len(self.truth)

        def pixels(edge: int) -> float:
            return modes * area * (edge / self.task.edge) ** 2

        def ms(edge: int) -> float:
            return float(self.price.of(modes * count, pixels(edge))) + self.local_ms(share, edge)

        edges = range(SMALLEST, _LARGEST + 1, SMALLEST // 4)
        within = [edge for edge in edges if not self.full(pixels(edge), modes * count)]
        return min(within or edges[:1], key=ms)
