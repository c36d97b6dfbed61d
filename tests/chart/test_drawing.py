"""The files of all charts, fronts, and plain numbers."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from omniscv.chart import accuracy, central, drawing, failures, stability
from omniscv.chart.drawing import Dot, Look

DOCS = Path(__file__).parents[2] / "docs"


def of_docs(module, name, **changes):
    """Return the rows of a chart in docs; ``changes`` has functions of fields that JSON does not hold."""
    rows = json.loads((DOCS / f"{name}.json").read_text())
    return [module.Row(**row | {key: change(row[key]) for key, change in changes.items()}) for row in rows]


CHARTS = {
    "chart-accuracy": (
        accuracy,
        lambda: of_docs(accuracy, "chart-accuracy", seconds_at=lambda at: {int(ms): at[ms] for ms in at}),
        ("mirror ball", "the paper", accuracy.ASKED),
    ),
    "chart-central": (
        central,
        lambda: of_docs(central, "chart-central", rms=lambda rms: np.nan if rms is None else rms),
        ("py360convert", "bilinear"),
    ),
    "chart-failures": (
        failures,
        lambda: of_docs(failures, "chart-failures")[:8],
        ("found by the doctor",),
    ),
    "stability": (
        stability,
        lambda: stability.measure(models=["equirectangular", "octahedral"]),
        ("octahedral",),
    ),
}


@pytest.mark.parametrize("name", CHARTS)
def test_charts_are_written_and_drawn(name, tmp_path):
    module, rows, texts = CHARTS[name]
    data, drawn, picture = module.write(rows(), tmp_path / "new")
    assert [path.name for path in (data, drawn, picture)] == [
        f"{name}.{kind}" for kind in ("json", "svg", "png")
    ]
    written = json.loads(data.read_text())
    if (DOCS / f"{name}.json").exists():
        assert written == json.loads((DOCS / f"{name}.json").read_text())[: len(written)]
    assert all(text in drawn.read_text() for text in texts)
    with Image.open(picture) as opened:
        assert opened.width == 1600


def test_the_front_holds_what_nothing_beats():
    dots = [Dot("a", "", x, y) for x, y in ((1, 9), (2, 5), (2, 7), (3, 6), (4, 1), (5, 1))]
    assert drawing.front(dots) == [dots[0], dots[1], dots[4]]


def test_a_picture_has_the_same_bytes_every_time(tmp_path):
    def drawn(folder):
        figure, (axes,) = drawing.figure(1, 3.0, "The same")
        ways = [Dot("a", "one", 1, 2, default=True), Dot("a", "two", 3, 1)]
        drawing.dots(axes, ways, {"a": Look("#0072b2", "o", "-")})
        return [path.read_bytes() for path in drawing.write([], figure, folder, "chart")]

    assert drawn(tmp_path / "first") == drawn(tmp_path / "second")
