"""Strategies by name."""

from dataclasses import replace
from typing import TypeVar

from omniscv import plugins
from omniscv.errors import ArgumentError
from omniscv.planning.adaptive import Adaptive
from omniscv.planning.auto import Auto
from omniscv.planning.base import Rounds, Strategy, Task, changed
from omniscv.planning.cube import Cube
from omniscv.planning.faces import Faces
from omniscv.planning.finer_truth import with_finer_truth
from omniscv.planning.reproject import Reproject
from omniscv.planning.strips import Strips

S = TypeVar("S", bound=Strategy)

_strategies: dict[str, type[Strategy]] = {}


def register(strategy: type[S]) -> type[S]:
    """Add a strategy under its name; also as a decorator.

    Raises:
        ArgumentError: no subclass of Strategy with a name, or another class under a name that is taken.
    """
    if not (isinstance(strategy, type) and issubclass(strategy, Strategy) and hasattr(strategy, "name")):
        raise ArgumentError(f"strategy: expected a subclass of Strategy with a name, got {strategy!r}")
    if _strategies.setdefault(strategy.name, strategy) is not strategy:
        raise ArgumentError(f"strategy: expected a name that is not taken, got {strategy.name!r} again")
    return strategy


def names() -> tuple[str, ...]:
    """Return the names of all strategies."""
    plugins.load()
    return tuple(_strategies)


def get(name: str) -> Strategy:
    """Return the strategy of a name.

    Raises:
        ArgumentError: no strategy has that name.
    """
    if name not in _strategies and name not in names():
        raise ArgumentError(f"strategy: expected one of {', '.join(names())}; got {name!r}")
    return _strategies[name]()


def rounds(task: Task) -> Rounds:
    """Return the rounds of a task's strategy, in the task's state of the world.

    Raises:
        ArgumentError: an unknown strategy, or a bound on an error that it does not make.
    """
    strategy = get(task.options.strategy)
    if task.options.max_error_px is not None and not strategy.approximate:
        approximate = " or ".join(name for name, each in _strategies.items() if each.approximate)
        raise ArgumentError(f"max_error_px: expected strategy {approximate}, got {strategy.name!r}")
    found = strategy.rounds(task)
    if task.options.truth_scale > 1:
        found = with_finer_truth(found, task)
    return changed(found, lambda each: replace(each, state=task.state)) if task.state else found


for _strategy in (Auto, Cube, Faces, Strips, Reproject, Adaptive):
    register(_strategy)
