"""The evaluations, by name."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

from omniscv.arguments import one_of
from omniscv.errors import ArgumentError
from omniscv.evaluate.report import Report

NAMES = ("layout", "calibration", "lines", "odometry")


@dataclass(frozen=True)
class Settings:
    """How an evaluation runs.

    Attributes:
        out: an existing folder for the pictures.
        quick: render fewer and smaller images, to finish within a minute.
        source: an address; None for the evaluation's own scenes of the mock.
        options: of this evaluation alone, such as ``predictions``.
        progress: called with (steps done, steps in all).
    """

    out: Path
    quick: bool = False
    source: str | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    progress: Callable[[int, int], None] = lambda done, total: None


def run(name: str, settings: Settings) -> Report:
    """Run an evaluation: render, run the algorithm, score it, draw the chart into ``settings.out``.

    Its module ``NAME/evaluation.py`` has ``evaluate(settings)``, and in ``OPTIONS`` the names of its options.

    Raises:
        ArgumentError: unknown name, or an option that the evaluation does not take.
        OmniscvError: of its source.
    """
    one_of("evaluation", name, NAMES)
    evaluation = import_module(f"omniscv.evaluate.{name}.evaluation")
    if unknown := sorted(set(settings.options) - evaluation.OPTIONS):
        known = ", ".join(sorted(evaluation.OPTIONS)) or "none"
        raise ArgumentError(f"{name}: unknown option {unknown[0]!r}; known options: {known}")
    report: Report = evaluation.evaluate(settings)
    return report
