"""How densely the packages are written stays within bounds, and the gauge counts what it says."""

import runpy
import subprocess
import sys

import pytest
from support.command_line import ROOT

GAUGE = ROOT / "scripts" / "gauge"

SAMPLE = '''"""A docstring has no tokens."""

from numba import njit

a, b = 1, 2


def public(first, second):
    """Return what first and second give."""
    return [x for x in first if x] + [y for row in second for y in row]


def undocumented(first, second):
    return first + second


@njit
def kernel(x):
    u, v = x, x
    return u + v
'''


def counted(tmp_path, text):
    (tmp_path / "sample.py").write_text(text)
    return runpy.run_path(str(GAUGE))["counts_of"](tmp_path)


def test_it_counts_a_small_file(tmp_path):
    counts = counted(tmp_path, SAMPLE)
    assert counts.statements == 9  # an import, an assignment, three functions with four statements in them
    assert counts.packed == 1  # that in the kernel aside
    assert (counts.comprehensions, counts.nested) == (2, 1)
    assert (counts.functions, counts.public, counts.named) == (3, 2, 1)
    assert (counts.deep, counts.long) == (0, 0)


@pytest.mark.parametrize(("count", "figure"), [(13, "deep"), (12, None)])
def test_branches_count_from_thirteen_on(tmp_path, count, figure):
    text = "def f(x):\n" + "".join(f"    if x == {i}:\n        x = 0\n" for i in range(count))
    assert counted(tmp_path, text).deep == (figure == "deep")


def test_statements_count_from_thirty_one_on(tmp_path):
    for count in (30, 31):
        text = "def f(x):\n" + "    x += 1\n" * count
        assert counted(tmp_path, text).long == (count == 31)


def test_the_packages_are_within_the_bounds():
    done = subprocess.run(
        [sys.executable, GAUGE, "omniscv", "mock_server"], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout


def test_what_is_beyond_a_bound_is_named(tmp_path):
    (tmp_path / "dense.py").write_text("a, b = 1, 2\n")
    done = subprocess.run([sys.executable, GAUGE, tmp_path], capture_output=True, text=True)
    assert done.returncode == 1
    assert "packed: expected at most 4, got 1000.0" in done.stdout
