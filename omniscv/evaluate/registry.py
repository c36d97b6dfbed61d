"""The evaluations, by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

from omniscv.arguments import shown
from omniscv.errors import ArgumentError
from omniscv.evaluate.figures import Report


@dataclass(frozen=True)
class Settings:
    """How an evaluation runs.

    Attributes:
        out: folder for pictures, which is there.
        quick: small images and few of them: within a minute.
        source: an address; the evaluation's own scenes of the mock if not given.
        options: of this evaluation alone, such as ``predictions``.
        progress: called with (steps done, steps in all).
    """

    out: Path
    quick: bool = False
    source: str | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    progress: Callable[[int, int], None] = lambda done, total: None


class Evaluation(Protocol):
    """What an evaluation is: a module with a function. ``OPTIONS`` names the options that it takes."""

    OPTIONS: frozenset[str]

    def evaluate(self, settings: Settings) -> Report:
        """Render, run the algorithm, score it, draw the chart into ``settings.out``."""


_MODULES = {
    "layout": "omniscv.evaluate.layout",
    "calibration": "omniscv.evaluate.calibration",
    "lines": "omniscv.evaluate.lines",
    "odometry": "omniscv.evaluate.odometry",
}
"""Imported when used."""


def names() -> tuple[str, ...]:
    """Return the names of all evaluations."""
    return tuple(_MODULES)


def run(name: str, settings: Settings) -> Report:
    """Run an evaluation.

    Raises:
        ArgumentError: no evaluation has that name, or it does not take an option.
        OmniscvError: of its source.
    """
    if name not in _MODULES:
        raise ArgumentError(f"evaluation: expected one of {', '.join(names())}; got {shown(name)}")
    evaluation: Evaluation = import_module(_MODULES[name])
    if unknown := sorted(set(settings.options) - evaluation.OPTIONS):
        known = ", ".join(sorted(evaluation.OPTIONS)) or "none"
        raise ArgumentError(f"{name}: expected options among {known}; got {', '.join(unknown)}")
    return evaluation.evaluate(settings)
