"""Images with one optical centre and a given accuracy: small faces first, then patches along edges."""

from contextlib import closing
from dataclasses import replace

from omniscv.geometry.arrays import Ints
from omniscv.planning import tuned
from omniscv.planning.densities import SMALLEST
from omniscv.planning.patches import Doubt
from omniscv.planning.refinement import Choice, Refinement
from omniscv.planning.rounds import Round, Rounds, Viewpoint


class OneCenter(Refinement):
    """The captures of an image whose rays start at one optical centre."""

    def planned(self) -> Rounds:
        yield from self._first()
        if self.plan.doubt is not None:
            yield from self.finer()

    def doubts(self, pixels: Ints) -> list[Doubt]:
        directions_w = self.plan.directions_w(pixels)
        return [Doubt(0, self.plan.pose.t_w_c, pixels, directions_w, self.focal_px[pixels])]

    def capture(self, choice: Choice) -> Rounds:
        for patch in choice.patches:
            self.focal_px[patch.pixels] = choice.focal_px
        by_size = sorted(choice.patches, key=lambda patch: (patch.view.width, patch.view.height))
        viewpoints = []
        for patch in by_size:
            center_w = patch.view.pose.t_w_c
            viewpoints.append(Viewpoint(center_w, (patch.view,), patch.pixels, self.patched))
        yield Round(tuple(viewpoints))

    def _first(self) -> Rounds:
        """Yield captures of all that the image shows: ground truth in the smallest faces."""
        plan = self.plan
        base = self._faces(plan.edge)
        options = plan.options
        any_size = options.face_size == "auto" and options.truth_scale == 1 and plan.capabilities.can_set_size
        if base is None or not any_size or not self.truth:
            yield from self.exact().rounds()
            return
        if self.colors:
            yield Round((replace(base, modes=self.colors),))
        first = self._faces(SMALLEST) or base
        self.expected_ms = self.local_ms(tuned.ROOM)
        self.focal_px[:] = tuned.FINER_FACES * first.views[0].focal_px
        yield Round((replace(first, modes=self.truth),))

    def _faces(self, edge: int) -> Viewpoint | None:
        """Return the only viewpoint of a central camera, with views as fine as faces of a size; else None."""
        sized = {} if edge == self.plan.edge else {"face_size": edge}
        with closing(self.exact(**sized).rounds()) as planned:
            viewpoints = next(planned).viewpoints
        return viewpoints[0] if len(viewpoints) == 1 else None
