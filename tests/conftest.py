"""Options and settings that all tests share."""

import gc
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy: of small matrices, threads only wait

import pytest
from hypothesis import settings

from omniscv import parallel
from omniscv.cli import console
from omniscv.compose.composition import Composing
from omniscv.planning import Plan

_HERE = Path(__file__).parent

# Machines are shared: a slow example is no failure. Draws are the same every run, so that a red
# suite is red for everybody; the soak runs draw anew.
settings.register_profile("suite", deadline=None, derandomize=True, print_blob=True, max_examples=25)
settings.register_profile("soak", deadline=None, max_examples=10_000)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--soak", action="store_true", help="also run the long soaks")


def pytest_configure(config: pytest.Config) -> None:
    settings.load_profile("soak" if config.getoption("--soak") else "suite")
    console.FIRST_LINE_S = console._LINES_ELSEWHERE_S  # lines come with time, which tests do not count
    gc.set_threshold(20_000, 10, 20)  # by default it takes 5 % of the suite
    _share_cores()


def _share_cores() -> None:
    """Leave each worker of pytest-xdist its share of the cores: more threads only wait for each other."""
    workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    parallel.limit(sys.maxsize)
    if workers > 1:
        parallel.limit(max(1, parallel.cores() // workers))


def pytest_collection_finish() -> None:
    gc.freeze()  # modules and tests stay


def pytest_unconfigure() -> None:
    gc.unfreeze()  # OpenImageIO counts what is left


_FIRST = ("cluster", "extension", "docs", "sources", "evaluate", "attack", "compose", "planning")
"""Folders whose files take long, in their order: workers that have no file left wait for the last one."""


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    items.sort(key=_turn)
    if config.getoption("--soak"):
        return
    for item in items:
        if item.get_closest_marker("soak"):
            item.add_marker(pytest.mark.skip(reason="a long soak: asked for with --soak"))


def _turn(item: pytest.Item) -> int:
    folder = item.path.relative_to(_HERE).parts[0]
    return _FIRST.index(folder) if folder in _FIRST else len(_FIRST)


class CentralRays:
    """Whether images of central cameras may take ground truth by rays: in tests marked ``rays`` alone.

    What the others say of planning and composition would else be said of rays, which need neither. Hooks
    switch, and no fixture, as those of modules are made before those of tests.
    """

    allowed = False


_by_rays = Plan.by_rays
_trace = Composing._trace
_shade = Composing._shade


def _by_rays_if_allowed(plan: Plan) -> Plan:
    return plan if plan.rays.one_center and not CentralRays.allowed else _by_rays(plan)


def _check_allowed(composing: Composing) -> None:
    if composing._plan.rays.one_center and not CentralRays.allowed:
        raise AssertionError("a central image was traced: mark the test 'rays', or give captures alone")


def _trace_if_allowed(composing: Composing) -> None:
    _check_allowed(composing)
    _trace(composing)


def _shade_if_allowed(composing: Composing) -> None:
    _check_allowed(composing)
    _shade(composing)


Plan.by_rays = _by_rays_if_allowed  # type: ignore[method-assign]
Composing._trace = _trace_if_allowed  # type: ignore[method-assign]
Composing._shade = _shade_if_allowed  # type: ignore[method-assign]


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    CentralRays.allowed = item.get_closest_marker("rays") is not None


@pytest.fixture(scope="module")
def all_cores():
    """Every core, for tests of what threads share."""
    parallel.limit(sys.maxsize)
    yield
    _share_cores()


@pytest.fixture(scope="session")
def processes():
    """Starts processes that write files, and may be killed."""
    from support.killed import Processes

    found = Processes()
    yield found
    found.close()
