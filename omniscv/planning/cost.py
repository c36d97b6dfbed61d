"""What a plan costs, before it is run."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from omniscv import modalities
from omniscv.planning.base import Round, Task, drive
from omniscv.planning.registry import get, rounds
from omniscv.sources.base import Request


@dataclass(frozen=True)
class Cost:
    """What a strategy asks of a source. Where that depends on what is captured, an estimate, and the most.

    Attributes:
        strategy: its name.
        views: pictures, each in every mode.
        requests, most_requests: captures.
        pixels: captured, over all modes.
        bytes: on the wire, estimated.
        seconds: estimated.
    """

    strategy: str
    views: int
    requests: int
    most_requests: int
    pixels: int
    bytes: float
    seconds: float


def cost(strategy: str, tasks: Iterable[Task], modes: Sequence[str], seconds_per_request: float) -> Cost:
    """Return the cost of images whose views are captured once each.

    Args:
        strategy: its name; in place of the one that the tasks' options have.
        tasks: one an image.
        modes: what is captured.
        seconds_per_request: of the source.

    Raises:
        ArgumentError: the source cannot do what the strategy needs.
    """
    requests: dict[Request, None] = {}
    further = most = 0
    for task in tasks:
        bound = task.options.max_error_px if get(strategy).approximate else None
        task = replace(task, options=replace(task.options, strategy=strategy, max_error_px=bound))

        def plan(round_: Round) -> None:
            requests.update(dict.fromkeys(round_.requests(modes)))

        drive(rounds(task), plan)
        estimate, limit = get(strategy).further_views(task)
        further, most = further + estimate, most + limit
    each = len({*modes, "depth"}) if further else len(modes)
    areas = [request.view.width * request.view.height for request in requests]
    largest = max(areas, default=0)
    wire_bytes = sum(a * modalities.get(r.mode).wire_bytes for a, r in zip(areas, requests, strict=True))
    count = len(requests) + further * each
    return Cost(
        strategy,
        views=len({request.view for request in requests}) + further,
        requests=count,
        most_requests=len(requests) + most * each,
        pixels=sum(areas) + further * each * largest,
        bytes=wire_bytes + further * largest * sum(modalities.get(mode).wire_bytes for mode in modes),
        seconds=count * seconds_per_request,
    )
