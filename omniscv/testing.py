"""A pytest plugin: an UnrealCV server for tests, and captures recorded once and replayed ever after.

pytest finds it by itself where omniscv is installed. docs/testing.md shows how to use it.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    import mock_server
    from omniscv.captures.source import Source

_MARKERS = (
    "unreal(scene='four-wall', **options): what unreal_server serves; options as of mock_server.serve: "
    "dialect, faults, latency_ms, depth ...",
    "recorded(file): the file that recorded_source replays, relative to recorded_dir.",
)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.getgroup("omniscv").addoption(
        "--unrealcv",
        metavar="HOST:PORT",
        help="the game that recorded_source records, where --record-mode says so; else it records the mock",
    )


def pytest_configure(config: pytest.Config) -> None:
    for line in _MARKERS:
        config.addinivalue_line("markers", line)


@pytest.fixture
def unreal_server(request: pytest.FixtureRequest) -> Iterator[mock_server.Server]:
    """A mock UnrealCV server, running: ``@pytest.mark.unreal(scene=..., dialect=...)`` says which."""
    import mock_server

    marker = request.node.get_closest_marker("unreal")
    options: dict[str, Any] = {"scene": "four-wall", **(marker.kwargs if marker else {})}
    with mock_server.serve(**options) as server:
        yield server


@pytest.fixture(scope="module")
def recorded_dir(request: pytest.FixtureRequest) -> Path:
    """Where a module's recorded files are: ``captures/MODULE`` beside it; override it for another place."""
    return request.path.parent / "captures" / request.path.stem


@pytest.fixture
def recorded_source(request: pytest.FixtureRequest, recorded_dir: Path) -> Iterator[Source]:
    """A source of captures from a recorded file, named by ``@pytest.mark.recorded(file)`` or by the test.

    pytest-recording's ``--record-mode`` decides:

    ==============  =================================================================
    none (default)  replay; what is not in the file is an error
    once            record if there is no file, else replay
    new_episodes    replay what is in the file, record the rest
    all             record all that is asked for; what else is in the file stays
    rewrite         record a new file, which takes the old one's place at the end
    ==============  =================================================================
    """
    from omniscv.captures.recording import RecordedSource, Recording

    path = recorded_dir / _file(request)
    mode = request.config.getoption("--record-mode", None) or "none"
    if mode == "none" or (mode == "once" and path.exists()):
        if not path.exists():
            pytest.fail(f"{path}: expected a recorded file; make it with --record-mode=once", pytrace=False)
        with RecordedSource(path) as replay:
            yield replay
        return
    whole = mode in ("once", "rewrite")
    target = path.with_name(f"{path.name}.new") if whole else path
    if whole:
        target.unlink(missing_ok=True)
    with _live(request) as live, Recording(live, target, anew=mode == "all") as recording:
        recording.objects()
        yield recording
    target.replace(path)


def _file(request: pytest.FixtureRequest) -> str:
    marker = request.node.get_closest_marker("recorded")
    if marker:
        return str(marker.args[0])
    name = "".join("-" if c in "<>?%*:|\"'/\\" else c for c in request.node.name)
    return f"{name}.sqlite"


def _live(request: pytest.FixtureRequest) -> Source:
    """The game that the command line names, or the mock that the test's marker describes."""
    from omniscv.captures.opening import open_source

    if request.config.pluginmanager.has_plugin("recording"):
        from pytest_recording import network

        network.unblock()  # @pytest.mark.block_network means: except for recording
    game = request.config.getoption("--unrealcv")
    uri = request.getfixturevalue("unreal_server").uri if game is None else f"unreal://{game}"
    return open_source(uri)
