"""The chart of sensors: measured variances are those of the standard."""

import json

import pytest

from omniscv.chart import sensor
from omniscv.cli import run


def test_measured_variances_are_those_due():
    rows = sensor.measure(width=64)
    assert all(row.variance == pytest.approx(row.due, rel=5 * (2 / 64**2) ** 0.5) for row in rows)


def test_the_command_draws_it(tmp_path):
    assert run(["chart", "sensor", "--quick", "--out", str(tmp_path)]) == 0
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"chart-sensor.json", "chart-sensor.svg", "chart-sensor.png"}
    assert len(json.loads((tmp_path / "chart-sensor.json").read_text())) == 3 * 25
