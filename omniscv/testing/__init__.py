"""A pytest plugin: a UnrealCV server for tests, and captures recorded once and replayed from then on.

pytest loads it wherever omniscv is installed; docs/testing.md shows how to use it. What it needs is imported
when a test uses a fixture, so that it costs other projects nothing.
"""

from __future__ import annotations

import inspect
import shutil
from collections.abc import Generator, Iterator, Mapping
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    import mock_server
    from omniscv.sources import Source
    from omniscv.testing.contracts import check_camera, check_source


__all__ = ["check_camera", "check_source", "recorded_dir", "recorded_source", "unreal_server"]

_passed = pytest.StashKey[bool]()
_MARKERS = {
    "unreal": inspect.signature(lambda scene="four-wall", **options: None),
    "recorded": inspect.signature(lambda file=None: None),
}
"""By marker, the arguments that it takes."""


def __getattr__(name: str) -> Any:
    """Import the contracts when a test uses them."""
    if name not in ("check_camera", "check_source"):
        raise AttributeError(f"module 'omniscv.testing' has no attribute {name!r}")
    return resolve_name(f"omniscv.testing.contracts:{name}")


def pytest_addoption(parser: pytest.Parser) -> None:
    text = "the game that recorded_source records where --record-mode asks for it; the mock if not given"
    parser.getgroup("omniscv").addoption("--unrealcv", metavar="HOST:PORT", help=text)


def pytest_configure(config: pytest.Config) -> None:
    unreal = "unreal(scene='four-wall', **options): what unreal_server serves; see mock_server.serve"
    recorded = "recorded(file=None): the recording of recorded_source, relative to recorded_dir"
    for line in (unreal, recorded):
        config.addinivalue_line("markers", line)


def _arguments(request: pytest.FixtureRequest, name: str) -> dict[str, Any]:
    """Return the arguments of a test's marker by name, with defaults; fail the test for others."""
    marker = request.node.get_closest_marker(name) or getattr(pytest.mark, name).mark
    try:
        bound = _MARKERS[name].bind(*marker.args, **marker.kwargs)
    except TypeError as wrong:
        pytest.fail(f"@pytest.mark.{name}: expected {_MARKERS[name]}, got others: {wrong}", pytrace=False)
    bound.apply_defaults()
    return bound.arguments


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Store whether a test, the ``item``, has passed, for fixtures that are torn down after it.

    ``call`` is the phase that has ended.
    """
    report = yield
    if report.when != "teardown":
        item.stash[_passed] = report.when == "call" and report.passed
    return report


@pytest.fixture
def unreal_server(request: pytest.FixtureRequest) -> Iterator[mock_server.Server]:
    """A running mock UnrealCV server, as ``@pytest.mark.unreal("six-wall", dialect=...)`` describes it.

    The scene is a name, the path of a YAML file, or a mapping of the same keys.
    """
    import mock_server

    given = _arguments(request, "unreal")
    scene = given["scene"]
    try:
        scene = mock_server.Scene("described", dict(scene)) if isinstance(scene, Mapping) else scene
        server = mock_server.serve(scene, **given["options"])
    except (ValueError, TypeError) as wrong:
        pytest.fail(f"@pytest.mark.unreal: {wrong}", pytrace=False)
    with server:
        yield server


@pytest.fixture(scope="module")
def recorded_dir(request: pytest.FixtureRequest) -> Path:
    """The folder of a module's recordings: ``captures/MODULE`` beside it; override it for another one."""
    return request.path.parent / "captures" / request.path.stem


@pytest.fixture
def recorded_source(request: pytest.FixtureRequest, recorded_dir: Path) -> Iterator[Source]:
    """A source that replays a recording, named by ``@pytest.mark.recorded(file)`` or after the test.

    It is in the folder that the fixture ``recorded_dir`` returns for the module of the ``request``.

    pytest-recording's ``--record-mode`` decides whether it records:

    ==============  =================================================================
    none (default)  replay; a capture that is not in the file is an error
    once            record if there is no file, or one without captures; else replay
    new_episodes    replay what is in the file, record the rest
    all             record every request anew; what else is in the file stays
    rewrite         record a new file
    ==============  =================================================================

    New captures are written to a temporary file, which replaces the recording if the test passes.
    """
    from omniscv.sources.recording import RecordedSource, Recording
    from omniscv.sources.recording.files import publish, target_of, written_for

    path = recorded_dir / _recording_name(request)
    mode = request.config.getoption("--record-mode", None) or "none"
    if mode == "none" or (mode == "once" and _holds_captures(path)):
        if not path.exists():
            pytest.fail(f"{path}: expected a recording; make it with --record-mode=once", pytrace=False)
        with RecordedSource(path) as replay:
            yield replay
        return
    target = target_of(path)
    with written_for(target) as written:
        if mode in ("new_episodes", "all") and _holds_captures(path):
            shutil.copyfile(target, written)
        with _live(request) as live, Recording(live, written, anew=mode == "all") as recording:
            recording.objects()
            yield recording
        if request.node.stash.get(_passed, False):
            publish(written, target)


def _recording_name(request: pytest.FixtureRequest) -> str:
    """Return the name of a test's recording: as its marker gives it, else its own, as a name of a file."""
    file: str | None = _arguments(request, "recorded")["file"]
    if file:
        return file
    name = request.node.name.translate(str.maketrans(dict.fromkeys("<>?%*:|\"'/\\", "-")))
    return f"{name}.sqlite"


def _holds_captures(path: Path) -> bool:
    """Return whether a file exists and holds captures; opening it also applies a journal that is left."""
    from omniscv.sources.recording import RecordedSource

    if not path.exists() or path.stat().st_size == 0:
        return False
    with RecordedSource(path) as replay:
        return bool(replay.states())


def _live(request: pytest.FixtureRequest) -> Source:
    """Open the game of ``--unrealcv``, else the mock that the test's marker describes."""
    from omniscv.sources import open_source

    if request.config.pluginmanager.has_plugin("recording"):
        from pytest_recording import network

        network.unblock()  # @pytest.mark.block_network blocks replays, not recording
    game = request.config.getoption("--unrealcv")
    return open_source(request.getfixturevalue("unreal_server").uri if game is None else f"unreal://{game}")
