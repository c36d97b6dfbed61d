"""What evaluations have in common: their files, and what is refused."""

import csv
import json

import pytest

from omniscv.errors import ArgumentError
from omniscv.evaluate import Figure, Report, Settings, run

FIGURES = [Figure("edges F1", 0.71, paper=0.642, n=10), Figure("ATE", 3.1, "mm")]
ROWS = [{"image": "a, 1", "error": 0.125, "n": 3}, {"image": 'b "2"', "error": 2.5e-9, "n": 4}]


def test_a_report_is_read_back_from_its_files(tmp_path):
    picture = tmp_path / "lines.png"
    written = Report(FIGURES, ROWS, {"size": [64, 32]}, [picture]).write("lines", tmp_path)
    assert written == [tmp_path / "lines.json", tmp_path / "lines.csv", picture]
    content = json.loads(written[0].read_text("utf-8"))
    first, second = content["figures"]
    assert first == {"name": "edges F1", "value": 0.71, "unit": "", "paper": 0.642, "n": 10}
    assert second == {"name": "ATE", "value": 3.1, "unit": "mm", "paper": None, "n": 1}
    assert content["raw"] == ROWS
    assert (content["evaluation"], content["about"]) == ("lines", {"size": [64, 32]})
    with written[1].open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["image"] for row in rows] == [row["image"] for row in ROWS]
    assert [float(row["error"]) for row in rows] == [row["error"] for row in ROWS]


def test_unknown_evaluations_and_options_of_others_are_refused(tmp_path):
    for name in ("line", "", "../lines"):
        with pytest.raises(ArgumentError, match=r"evaluation: expected one of l.*, .*odometry; got"):
            run(name, Settings(tmp_path))
    with pytest.raises(ArgumentError, match=r"lines: unknown option .predictions.; known options: none"):
        run("lines", Settings(tmp_path, options={"predictions": tmp_path}))
    assert not list(tmp_path.iterdir())
