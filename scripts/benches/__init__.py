"""What ``scripts/bench`` measures: each module here is a bench, and its docstring's first line its help.

A bench is a module with ``measure(quick)``, which yields figures; ``quick`` is a smoke test in small sizes.
To add one, add its file.
"""

from __future__ import annotations

import ast
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path


@dataclass(frozen=True)
class Reference:
    """What a figure is compared with: its name, and its figure in the same unit."""

    name: str
    value: float


@dataclass(frozen=True)
class Figure:
    """One row of the one table form.

    Attributes:
        table: its table's title.
        name: what is measured.
        unit: of the figure and of what it is compared with.
        ours: the figure.
        peer: what another way takes for the same.
        limit: what no way can pass, or what is to be reached.
    """

    table: str
    name: str
    unit: str
    ours: float
    peer: Reference | None = None
    limit: Reference | None = None

    @property
    def ratio(self) -> float | None:
        """Ours by the peer's or the limit's; None where there is neither."""
        other = self.peer or self.limit
        return None if other is None else self.ours / other.value

    def as_dict(self) -> dict[str, object]:
        """Return what a JSON file holds of it."""
        return {**asdict(self), "ratio": self.ratio}


def names() -> dict[str, str]:
    """Return the benches with their help, without importing them."""
    return {path.stem: _first_line(path) for path in sorted(Path(__file__).parent.glob("[a-z]*.py"))}


def figures(name: str, quick: bool = False, **options: str) -> list[Figure]:
    """Return what a bench measures; ``options`` are its own."""
    measured: Iterator[Figure] = import_module(f"benches.{name}").measure(quick, **options)
    return list(measured)


def best_ms(
    candidates: Mapping[str, Callable[[], object]],
    turns: int,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, float]:
    """Return the least time of each candidate.

    They are called in turns, so that other work on the machine slows all alike; one turn before compiles.
    """
    times: dict[str, list[float]] = {name: [] for name in candidates}
    for _ in range(turns + 1):
        for name, call in candidates.items():
            started = clock()
            call()
            times[name].append(clock() - started)
    return {name: 1e3 * min(each[1:]) for name, each in times.items()}


def _first_line(path: Path) -> str:
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return text.partition("\n")[0]
