"""``scripts/bench``: every bench runs, and its figures have the one form."""

import math
import runpy
import sys
from importlib.util import find_spec

import pytest
from support.command_line import ROOT

SCRIPTS = ROOT / "scripts"
NAMES = sorted(path.stem for path in (SCRIPTS / "benches").glob("[a-z]*.py"))


@pytest.fixture
def benches(monkeypatch):
    monkeypatch.syspath_prepend(SCRIPTS)
    import benches

    return benches


LONG = ("accuracy", "cluster", "growth", "reproject", "speed", "start", "stores")
"""Benches that take a second or more, even quick ones."""


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.soak] * (name in LONG))
        for name in NAMES
        if name != "live" and (name != "torch" or find_spec("torch"))
    ],
)
def test_every_figure_is_a_positive_number_in_the_one_form(benches, name):
    check(benches.figures(name, quick=True))


def check(found):
    rows = [(figure.table, figure.name, figure.unit, figure.peer, figure.limit) for figure in found]
    assert len(set(rows)) == len(rows) > 0
    for figure in found:
        assert all(figure.as_dict()[key] for key in ("table", "name", "unit"))
        assert figure.peer is None or figure.limit is None
        others = [other.value for other in (figure.peer, figure.limit) if other]
        assert all(math.isfinite(each) and each > 0 for each in (figure.ours, *others)), figure
        assert figure.ratio == (figure.ours / others[0] if others else None)


@pytest.mark.skipif(not find_spec("torch"), reason="needs PyTorch: scripts/test-torch")
def test_images_of_a_device(benches):
    check(benches.figures("torch", quick=True, device="cpu"))


@pytest.fixture
def bench(benches, monkeypatch):
    def run(*words):
        monkeypatch.setattr(sys, "argv", ["bench", *words])
        try:
            runpy.run_path(str(SCRIPTS / "bench"), run_name="__main__")
        except SystemExit as ended:
            return ended.code
        return 0

    return run


@pytest.mark.skipif(find_spec("torch") is not None, reason="PyTorch is here")
def test_a_package_that_is_missing_is_named_in_one_line(bench, capfd):
    assert bench("torch", "--quick") == 1
    assert capfd.readouterr().err == "bench torch: expected the package torch; pip install torch\n"
