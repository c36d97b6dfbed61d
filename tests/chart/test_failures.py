"""The chart of failures: errors are measured against exact truth, and answers are told apart."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from omniscv.chart import failures
from omniscv.chart.failures import Cause, Row

ROOT = Path(__file__).resolve().parents[2]
COLUMNS = ("panorama", "8 viewpoints")


def told(address, position, timeout_s, patience_s):
    """What the doctor, who takes seconds, finds of the depth that the address makes radial."""
    assert (position == failures._POSE.position).all()
    return [SimpleNamespace(name="depth, turned", verdict="bad")] if "fault=" in address else []


@pytest.fixture(
    scope="module", params=[told, pytest.param(None, marks=pytest.mark.soak)], ids=["told", "doctor"]
)
def rows(request):
    """Depth that is radial in full."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(failures, "examine_address", request.param or failures.examine_address)
        small = "size=96x72"
        radial = Cause("radial depth", "of the way", (1,), f"{small}&fault=radial-depth={{}}", sound=small)
        patch.setattr(failures, "CAUSES", (radial,))
        patch.setattr(failures, "COLUMNS", COLUMNS)
        return failures.measure(width=32)


def test_strong_faults_are_found(rows):
    assert {row.column for row in rows} == set(COLUMNS)
    assert {row.said for row in rows} == {"doctor"}
    assert all(row.wrong > 0.5 and "depth, turned" in row.findings for row in rows)


def test_weak_faults_hold():
    """Without a doctor's finding, what is as true as without the fault."""
    images = dict.fromkeys(failures.COLUMNS, (0.01, 0.0))
    sound = failures._Outcome(images, frozenset())
    weak = failures._Outcome(images | {"exact": (0.02, 0.0005), "auto": (0.02, 0.02)}, frozenset())
    rows = failures._rows(failures.CAUSES[0], 0.001, weak, sound)
    assert [row.said for row in rows] == ["holds", "marked", "holds", "silent"]


def table(rows):
    """A Markdown table of the strengths at which each strategy breaks, and of the answers there."""
    columns = failures.COLUMNS
    lines = [f"| cause | strengths | {' | '.join(columns)} | the doctor |", "|---" * (len(columns) + 3) + "|"]
    for cause in dict.fromkeys(row.cause for row in rows):
        mine = [row for row in rows if row.cause == cause]
        strengths = ", ".join(dict.fromkeys(str(row.strength) for row in mine))
        cells = []
        for column in failures.COLUMNS:
            broken = [row for row in mine if row.column == column and row.said != "holds"]
            answers = [row for i, row in enumerate(broken) if i == 0 or broken[i - 1].said != row.said]
            cells.append("; ".join(f"{row.strength}: {row.said}" for row in answers) or "holds")
        findings = next((row.findings for row in mine if row.findings), ())
        start = f"| {cause} | {strengths} {mine[0].unit}".rstrip()
        lines.append(f"{start} | {' | '.join(cells)} | {'; '.join(findings[:3])} |")
    return "\n".join(lines) + "\n"


def test_the_page_has_the_table_of_its_data():
    """And a second table explains every cause that is silent."""
    rows_of_docs = [Row(**row) for row in json.loads((ROOT / "docs" / "chart-failures.json").read_text())]
    page = (ROOT / "docs" / "failures.md").read_text(encoding="utf-8")
    assert table(rows_of_docs) in page
    assert {row.cause for row in rows_of_docs} == {cause.name for cause in failures.CAUSES}
    silent = {row.cause for row in rows_of_docs if row.said == "silent"}
    assert all(page.count(f"\n| {cause}") >= 2 for cause in silent)
