"""The live UnrealCV server, over the official client: the only package that knows the wire."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args
from urllib.parse import urlsplit

from omniscv.arguments import one_of, shown, whole_number
from omniscv.errors import ArgumentError
from omniscv.sources.base import ProcessBound, Source
from omniscv.sources.registry import Opener, advice_on, read_size, split_address
from omniscv.sources.unreal.client import PATIENCE_S, RETRIES, TIMEOUT_S, Connection, Endpoint
from omniscv.sources.unreal.driver import CameraOptions
from omniscv.sources.unreal.launcher import Connect, launch
from omniscv.sources.unreal.source import connect
from omniscv.sources.world import CameraExposure, Freeze, exposure_bias

if TYPE_CHECKING:
    from mock_server import Scene, Server

_Readers = dict[str, Callable[[str], Any]]
_LAUNCH_OPTIONS: _Readers = {"port": int, "size": read_size, "fov_deg": float, "startup_timeout_s": float}
_MOCK_TEXTS: _Readers = dict.fromkeys(("dialect", "depth", "fault", "shared_memory"), str)
_MOCK_NUMBERS: _Readers = dict.fromkeys(("latency_ms", "frames_per_s", "time_step_s"), float)
_MOCK_OPTIONS: _Readers = {**_MOCK_TEXTS, **_MOCK_NUMBERS, "seed": int, "size": read_size}
MOST_WARMUP = 1000  # frames after each move
_PORT = 9000  # of an address without one
_MAX_ADDRESS = 200  # characters, more than a socket's path and most names of hosts can have


def _opener(open_address: Callable[[str, Connect, ExitStack], Source]) -> Opener:
    """Return the opener for a function that opens an address; what it starts, it leaves to an exit stack.

    The options of an opener are those of :class:`omniscv.sources.registry.SourceOptions`.
    """

    def opener(
        address: str,
        timeout_s: float = TIMEOUT_S,
        patience_s: float = PATIENCE_S,
        retries: int = RETRIES,
        fix_exposure: bool = False,
        exposure: CameraExposure | None = None,
        warmup: int = 0,
        freeze: Freeze | None = None,
    ) -> Source:
        how = None if freeze is None else one_of("freeze", freeze, get_args(Freeze))
        bias = None if exposure is None else exposure_bias("exposure", exposure)

        def connect_to(endpoint: Endpoint, scene: Scene | None = None) -> Source:
            frames = whole_number("warmup", warmup, least=0, most=MOST_WARMUP)
            options = CameraOptions(fix_exposure, bias, frames)
            return connect(Connection(endpoint, timeout_s, patience_s, retries), options, how, scene)

        with ExitStack() as host:
            source = open_address(address, connect_to, host)
            return ProcessBound(source, address, host.pop_all())

    return opener


@_opener
def open_unreal(address: str, connect: Connect, host: ExitStack) -> Source:
    """Open the ``address`` ``unreal://host:port`` or ``unreal+unix:///path``.

    Args:
        address: as above; a query such as ``?camera=1`` is refused.
        connect: opens an endpoint as a source.
        host: without use, as nothing is started.
    """
    endpoint = _endpoint(address)
    if "camera=" in urlsplit(address).query:
        expected = "expected no ?camera, as captures are of a camera that is spawned"
        raise ArgumentError(f"source: {expected}, got {shown(address)}; give --position, --yaw and --pitch")
    return connect(endpoint)


@_opener
def open_launched(address: str, connect: Connect, host: ExitStack) -> Source:
    """Start a packaged game, and open it.

    Args:
        address: ``launch:PATH?port=9001``, with options of :func:`launch`.
        connect: opens an endpoint as a source.
        host: stops the game when it is closed.
    """
    path, options = split_address(address, _LAUNCH_OPTIONS)
    return launch(Path(path), connect, host, **options)


@_opener
def open_mock(address: str, connect: Connect, host: ExitStack) -> Source:
    """Start the mock server for this source alone, and open it.

    Args:
        address: ``mock://four-wall?dialect=0.3.10``, with options of :func:`mock_server.serve`.
        connect: opens an endpoint, and its scene, as a source.
        host: stops the server when it is closed.
    """
    server = host.enter_context(_mock(address))
    return connect((server.host, server.port), scene=server.scene)


@contextmanager
def open_connection(
    address: str, timeout_s: float = TIMEOUT_S, patience_s: float = PATIENCE_S
) -> Iterator[Connection]:
    """Yield a connection to a live or mock server, which connects when it is first used.

    Args:
        address: ``unreal://host:port``, ``unreal+unix:///path`` or ``mock://SCENE``.
        timeout_s: see :class:`Connection`.
        patience_s: see :class:`Connection`.
    """
    with ExitStack() as resources:
        if address.startswith("mock://"):
            server = resources.enter_context(_mock(address))
            endpoint: Endpoint = (server.host, server.port)
        else:
            endpoint = _endpoint(address)
        yield resources.enter_context(closing(Connection(endpoint, timeout_s, patience_s)))


def _endpoint(address: str) -> Endpoint:
    with suppress(ValueError):  # brackets, a port that is no number, a part of a name that is too long
        parts = urlsplit(address if len(address) <= _MAX_ADDRESS else "")
        if parts.scheme == "unreal+unix" and parts.path.isprintable() and parts.path:
            return parts.path
        host = parts.hostname
        if parts.scheme == "unreal" and host and host.encode("idna").decode().isprintable():
            return host, _PORT if parts.port is None else parts.port
    expected = "expected unreal://host:port or unreal+unix:///path"
    raise ArgumentError(f"source: {expected}, got {shown(address)}{advice_on(address)}")


def _mock(address: str) -> Server:
    import mock_server

    scene, options = split_address(address, _MOCK_OPTIONS, repeatable=("fault",))
    faults: Any = options.pop("fault", ())
    try:
        return mock_server.serve(scene, faults=faults, **options)
    except ValueError as wrong:
        raise ArgumentError(f"source: {shown(address)}: {wrong}") from wrong
