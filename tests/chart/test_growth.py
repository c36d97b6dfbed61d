"""The chart of growth: each job runs in a process of its own, and slopes are those of powers."""

import json

import pytest
from PIL import Image

from omniscv.chart import growth
from omniscv.chart.growth import Row


def powers(series, exponent):
    """Jobs whose time is a power of their count; memory stays."""
    return [Row(series, n, 0.3 * n**exponent, 250.0, 200.0) for n in (1, 2, 4, 8, 16, 32)]


@pytest.mark.parametrize("exponent", [0.0, 0.5, 1.0, 2.0])
def test_the_slope_of_a_power_is_its_exponent(exponent):
    rows = powers("poses", exponent)
    assert growth.slope(rows, "cpu_s") == pytest.approx(exponent)
    assert growth.slope(rows, "peak_mb") == pytest.approx(0)


def test_a_job_is_measured_in_a_process_of_its_own():
    ballast = bytearray(400 << 20)  # of this process; the other does not count it
    (row,) = growth.measure(width=64, most=1, series=["viewpoints"])
    assert (row.series, row.count) == ("viewpoints", 1)
    assert 0 < row.cpu_s < 60
    assert 0 < row.idle_mb <= row.peak_mb < len(ballast) >> 20


def test_it_is_written_and_drawn(tmp_path):
    rows = [row for exponent, series in enumerate(growth.SERIES) for row in powers(series, 1 + exponent / 10)]
    data, drawn, picture = growth.write(rows, tmp_path)
    assert [row["cpu_s"] for row in json.loads(data.read_text())] == [row.cpu_s for row in rows]
    assert all(series in drawn.read_text() for series in growth.SERIES)
    with Image.open(picture) as opened:
        assert opened.width == 1600


def test_the_title_says_what_the_slopes_are():
    rows = [row for exponent, series in enumerate(growth.SERIES) for row in powers(series, 1 + exponent / 10)]
    assert "slopes 1.00 to 1.30" in growth.finding(rows)
