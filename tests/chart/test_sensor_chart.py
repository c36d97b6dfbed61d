"""The chart of sensors: what it measures is what is due."""

import json

import pytest

from omniscv.chart import sensor
from omniscv.cli import run


def test_measured_variances_are_those_due(tmp_path):
    rows = sensor.measure(width=64)
    assert all(row.variance == pytest.approx(row.due, rel=5 * (2 / 64**2) ** 0.5) for row in rows)
    files = sensor.write(rows[::6], tmp_path)
    assert [path.name for path in files] == ["chart-sensor.json", "chart-sensor.svg", "chart-sensor.png"]
    assert len(json.loads(files[0].read_text())) == len(rows[::6])


def test_the_command_draws_it(tmp_path, capsys):
    assert run(["chart", "sensor", "--quick", "--out", str(tmp_path)]) == 0
    assert (tmp_path / "chart-sensor.svg").exists()
