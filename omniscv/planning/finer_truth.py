"""Ground truth that is captured finer than colours, whatever the strategy."""

from dataclasses import replace

from omniscv.errors import ArgumentError
from omniscv.planning.base import Rounds, Task, Viewpoint, changed

_LARGEST_PX = 16384


def with_finer_truth(rounds: Rounds, task: Task) -> Rounds:
    """Yield a strategy's rounds with the task's ``truth_scale``.

    Raises:
        ArgumentError: the source cannot set the size of views, or they get too large.
    """
    scale = task.options.truth_scale
    if not task.capabilities.can_set_size:
        raise ArgumentError(f"truth_scale: expected 1 of a source that cannot set the size, got {scale}")

    def finer(viewpoint: Viewpoint) -> Viewpoint:
        largest = max((max(view.width, view.height) for view in viewpoint.views), default=0)
        if scale * largest > _LARGEST_PX:
            raise ArgumentError(
                f"truth_scale: expected views of at most {_LARGEST_PX} px, got {scale} x {largest}; "
                "give a smaller face_size or truth_scale"
            )
        return replace(viewpoint, truth_scale=scale)

    yield from changed(rounds, finer)
