"""What an evaluation finds: figures beside the paper's, raw values, and files of both."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from omniscv.compose.files import finite, write_json
from omniscv.storage.local import whole_file


@dataclass(frozen=True)
class Figure:
    """A number of an evaluation.

    Attributes:
        name: what it is, such as ``edges F1, 4-wall rooms``.
        value: ours; NaN where nothing could be measured.
        unit: such as ``deg`` or ``%``; empty for a ratio.
        paper: the paper's, if it prints one.
        n: of how many images, segments or poses it is the mean or the worst.
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
        rows: the raw values, a mapping per row with the same keys, for ``NAME.json`` and ``NAME.csv``.
        about: how they came about: sizes, seeds, noise; plain JSON values.
        written: pictures that the evaluation has drawn into the output folder.
    """

    figures: Sequence[Figure]
    rows: Sequence[Mapping[str, Any]]
    about: Mapping[str, Any] = field(default_factory=dict)
    written: Sequence[Path] = ()

    def write(self, name: str, out: Path) -> list[Path]:
        """Write ``NAME.json`` and ``NAME.csv`` into a folder; return all files of the report."""
        content = {
            "evaluation": name,
            "figures": [asdict(each) for each in self.figures],
            "about": dict(self.about),
            "raw": [dict(row) for row in self.rows],
        }
        as_json, as_csv = out / f"{name}.json", out / f"{name}.csv"
        write_json(as_json, finite(content))
        with whole_file(as_csv) as part, part.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(self.rows[0]) if self.rows else [])
            writer.writeheader()
            writer.writerows(self.rows)
        return [as_json, as_csv, *self.written]
