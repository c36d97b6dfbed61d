"""Ground truth that is captured finer than colours, whatever the strategy."""

from contextlib import closing
from dataclasses import replace

from omniscv.errors import ArgumentError
from omniscv.planning.base import Round, Rounds, Task

_LARGEST_PX = 16384


def with_finer_truth(rounds: Rounds, task: Task) -> Rounds:
    """Yield a strategy's rounds with the task's ``truth_scale``; what is sent goes on to the strategy.

    Raises:
        ArgumentError: the source cannot set the size of views, or they get too large.
    """
    scale = task.options.truth_scale
    if not task.capabilities.can_set_size:
        raise ArgumentError(f"truth_scale: expected 1 of a source that cannot set the size, got {scale}")
    with closing(rounds):
        following = next(rounds, None)
        while following is not None:
            views = [view for viewpoint in following.viewpoints for view in viewpoint.views]
            largest = max((max(view.width, view.height) for view in views), default=0)
            if scale * largest > _LARGEST_PX:
                raise ArgumentError(
                    f"truth_scale: expected views of at most {_LARGEST_PX} px, got {scale} x {largest}; "
                    "give a smaller face_size or truth_scale"
                )
            kept = yield Round(tuple(replace(each, truth_scale=scale) for each in following.viewpoints))
            try:
                following = rounds.send(kept)
            except StopIteration:
                return
