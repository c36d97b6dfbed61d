"""The evaluations by name, and their results: figures beside the paper's, raw values, charts."""

import csv
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

from matplotlib import figure

from omniscv.arguments import one_of
from omniscv.compose.files import finite, write_json
from omniscv.errors import ArgumentError
from omniscv.storage.local import whole_file

NAMES = ("layout", "calibration", "lines", "odometry")

INK = "#1c2330"
BLUE = "#0072b2"
ORANGE = "#e69f00"
GREEN = "#009e73"
RED = "#d55e00"
SKY = "#56b4e9"
PINK = "#cc79a7"
COLORS = BLUE, ORANGE, GREEN, RED, SKY, PINK
"""Okabe and Ito's colours, which people with any colour vision tell apart."""

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Figure:
    """A number of an evaluation.

    Attributes:
        name: such as ``edges F1, 4-wall rooms``.
        value: ours; NaN where nothing could be measured.
        unit: such as ``deg`` or ``%``; empty for a ratio.
        paper: the paper's, if it prints one.
        n: number of images, segments or poses of which the value is the mean or the worst.
    """

    name: str
    value: float
    unit: str = ""
    paper: float | None = None
    n: int = 1


@dataclass(frozen=True)
class Report:
    """The outcome of an evaluation.

    Attributes:
        figures: for the table, and for ``NAME.json``.
        rows: the raw values, for ``NAME.json`` and ``NAME.csv``; all rows have the same keys.
        about: sizes, seeds, noise; plain JSON values.
        written: files in the output folder.
    """

    figures: Sequence[Figure]
    rows: Sequence[Row]
    about: Mapping[str, Any] = field(default_factory=dict)
    written: Sequence[Path] = ()

    def write(self, name: str, out: Path) -> list[Path]:
        """Write ``NAME.json`` and ``NAME.csv`` of an evaluation into the folder ``out``.

        ``name`` is that of the evaluation. Returns all files of the report.
        """
        content: dict[str, Any] = {"evaluation": name, "figures": list(map(asdict, self.figures))}
        content |= {"about": dict(self.about), "raw": list(map(dict, self.rows))}
        as_json = out / f"{name}.json"
        as_csv = out / f"{name}.csv"
        write_json(as_json, finite(content))
        with whole_file(as_csv) as part, part.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(self.rows[0]) if self.rows else [])
            writer.writeheader()
            writer.writerows(self.rows)
        return [as_json, as_csv, *self.written]


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

    Its package has ``evaluate(settings)``, and in ``OPTIONS`` the names of its options.

    Raises:
        ArgumentError: unknown name, or an option that the evaluation does not take.
        OmniscvError: of its source.
    """
    one_of("evaluation", name, NAMES)
    evaluation = import_module(f"omniscv.evaluate.{name}")
    if unknown := sorted(set(settings.options) - evaluation.OPTIONS):
        known = ", ".join(sorted(evaluation.OPTIONS)) or "none"
        raise ArgumentError(f"{name}: unknown option {unknown[0]!r}; known options: {known}")
    report: Report = evaluation.evaluate(settings)
    return report


@contextmanager
def chart(path: Path, width: int, height: int) -> Iterator[figure.Figure]:
    """Yield an empty drawing of ``width`` by ``height`` px, and write it to ``path`` as a PNG at the end."""
    drawing = figure.Figure(figsize=(width / 100, height / 100), dpi=100, layout="constrained")
    yield drawing
    with whole_file(path) as part:
        drawing.savefig(part)
