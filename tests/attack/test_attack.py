"""Some attacks of each family, always the same ones; ``scripts/attack`` runs as many as there is time for."""

from contextlib import nullcontext

import pytest

from attack.runner import ROUND, Tally, Worker, carried_out, run

SHORT = {
    **{"texts": 8, "recordings": 4, "servers": 2, "folders": 2},
    **{"datasets": 2, "records": 2, "names": 2, "shards": 3, "stores": 2},
}
"""By family: how many cases the suite runs; with ``--soak``, ten rounds of ``scripts/attack``, with signals,
which ``tests/cli/test_progress.py`` tests in the suite."""


class Here:
    """Runs cases in this process: few are soon done, and the suite has a time limit of its own."""

    run = staticmethod(carried_out)


@pytest.fixture(scope="module")
def worker(request):
    with Worker() if request.config.getoption("--soak") else nullcontext(Here()) as runs:
        yield runs


@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    "family", [pytest.param(name, marks=[pytest.mark.soak] * (name not in SHORT)) for name in ROUND]
)
def test_a_family_finds_nothing(family, worker, request):
    count = 10 * ROUND[family] if request.config.getoption("--soak") else SHORT[family]
    tally = Tally()
    run([family], 0, {family: count}, tally, worker=worker)
    assert tally.cases[family] == count
    assert not tally.faults, "\n".join(tally.lines())
