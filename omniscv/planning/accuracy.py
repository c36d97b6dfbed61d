"""The rounds of an image whose accuracy is given.

Colours are captured as fine as the image needs, ground truth first coarsely, then finer where the image is in
doubt (:mod:`omniscv.planning.refinement`). Images with several optical centres are captured from few
(:mod:`omniscv.planning.several_centers`).
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import closing
from dataclasses import replace

from omniscv.geometry.arrays import Ints
from omniscv.planning import strategy
from omniscv.planning.densities import SMALLEST
from omniscv.planning.patches import Doubt
from omniscv.planning.refinement import ROOM, Choice, Refinement
from omniscv.planning.rounds import Kept, Round, Rounds, Viewpoint, pass_on
from omniscv.planning.several_centers import SeveralCenters
from omniscv.planning.strategy import Task

_FINER_FACES = 1.2
"""How much more finely faces sample on the mean than patches of their focal length."""


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
        by_size = sorted(choice.patches, key=lambda each: (each.view.width, each.view.height))
        viewpoints = (
            Viewpoint(each.view.pose.t_w_c, (each.view,), each.pixels, self.truth) for each in by_size
        )
        return (yield Round(tuple(viewpoints)))

    def _first(self) -> Generator[Round, Kept | None, Kept | None]:
        """Yield captures of all that the image shows: ground truth in the smallest faces."""
        task = self.task
        base, options = self._faces(task.edge), task.options
        one_size = (
            options.face_size != "auto" or options.truth_scale > 1 or not task.capabilities.can_set_size
        )
        if base is None or one_size or not self.truth:
            return (yield from pass_on(strategy.rounds(task)))
        if self.colors:
            yield Round((replace(base, modes=self.colors),))
        first = self._faces(SMALLEST) or base
        self.expected_ms = self.local_ms(ROOM)
        self.focal_px[:] = _FINER_FACES * first.views[0].focal_px
        return (yield Round((replace(first, modes=self.truth),)))

    def _faces(self, edge: int) -> Viewpoint | None:
        """Return the only viewpoint of a central camera, with views as fine as faces of a size; else None."""
        task = self.task
        sized = replace(task, options=replace(task.options, face_size=edge))
        planned = strategy.rounds(task if edge == task.edge else sized)
        with closing(planned):
            viewpoints = next(planned).viewpoints
        return viewpoints[0] if len(viewpoints) == 1 else None
