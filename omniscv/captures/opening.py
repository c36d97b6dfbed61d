"""Sources by address."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

from omniscv.captures.source import Source
from omniscv.errors import ArgumentError

if TYPE_CHECKING:
    from mock_server import Server
    from omniscv.captures.unreal.link import Link

Endpoint = tuple[str, int] | str
"""(host, port), or the path of a Unix socket."""

_FORMS = "unreal://host:port, unreal+unix:///path, launch:PATH, mock://scene, or a recorded file"


def open_source(uri: str | Path, **options: Any) -> Source:
    """Opens a source of captures.

    Args:
        uri: ``unreal://host:port`` or ``unreal+unix:///path`` for a live server; ``launch:PATH`` for a
            packaged game, started for this source alone (``omniscv.captures.unreal.launch``);
            ``mock://four-wall`` for the mock server, likewise, with its options behind a question mark
            (``mock://four-wall?latency_ms=5&depth=float32``; ``dialect=0.3.10&size=512x512``;
            ``fault=delay=0.2@0.05``, repeatable, and ``seed`` of the faults); else the path of a recorded
            file.
        options: for live sources: ``timeout_s``, ``retries``, ``fix_exposure``.

    Raises:
        ArgumentError: an address of another form, or an option that the source does not take.
        SourceError: nobody answers there.
        RecordError: the file is not there, or is no recording.
    """
    text = str(uri)
    if text.startswith("launch:"):
        from omniscv.captures.unreal.launch import open_launched

        return open_launched(text, **options)
    if "://" not in text:
        from omniscv.captures.recording import RecordedSource

        if options:
            raise ArgumentError(f"options: expected none for a recorded file, got {', '.join(options)}")
        return RecordedSource(text)
    parts = urlsplit(text)
    if parts.scheme == "mock":
        return _open_mock(text, options)
    return _open_live(_endpoint(text, _FORMS), options)


@contextmanager
def open_link(uri: str, *, timeout_s: float = 30.0, retries: int = 5) -> Iterator[Link]:
    """A bare connection to a live server, for commands of one's own.

    Args:
        uri: ``unreal://host:port``, ``unreal+unix:///path`` or ``mock://scene``, as for :func:`open_source`.
        timeout_s: how long connecting, and each reply, may take.
        retries: how often to try again while nothing comes at all.

    Raises:
        ArgumentError: an address of another form.
    """
    from omniscv.captures.unreal.link import Link

    with ExitStack() as held:
        if uri.startswith("mock://"):
            server = held.enter_context(_mock(uri))
            endpoint: Endpoint = (server.host, server.port)
        else:
            endpoint = _endpoint(uri, "unreal://host:port, unreal+unix:///path or mock://scene")
        link = Link(endpoint, timeout_s, retries)
        held.callback(link.close)
        yield link


def _endpoint(uri: str, forms: str) -> Endpoint:
    parts = urlsplit(uri)
    if parts.scheme == "unreal+unix" and parts.path:
        return parts.path
    if parts.scheme == "unreal":
        try:
            host, port = parts.hostname, parts.port or 9000
        except ValueError as cause:
            raise ArgumentError(f"source: expected {forms}; got {uri!r}") from cause
        if host:
            return host, port
    raise ArgumentError(f"source: expected {forms}; got {uri!r}")


def _open_live(endpoint: Endpoint, options: dict[str, Any]) -> Source:
    from omniscv.captures.unreal.dialects import open_live

    try:
        return open_live(endpoint, **options)
    except TypeError as cause:
        raise ArgumentError(
            f"options: expected timeout_s, retries, fix_exposure; got {', '.join(options)}"
        ) from cause


def size_of(text: str) -> tuple[int, int]:
    """Width and height of a text such as ``640x480``; ValueError if it is none."""
    width, height = text.split("x")
    return int(width), int(height)


_MOCK_OPTIONS: dict[str, Callable[[str], Any]] = {
    "dialect": str,
    "depth": str,
    "latency_ms": float,
    "seed": int,
    "size": size_of,
}


def _mock(uri: str) -> Server:
    """A mock server as an address describes it."""
    import mock_server

    parts = urlsplit(uri)
    query = parse_qs(parts.query, keep_blank_values=True)
    faults = query.pop("fault", [])
    if unknown := sorted(set(query) - set(_MOCK_OPTIONS)):
        known = ", ".join([*_MOCK_OPTIONS, "fault"])
        raise ArgumentError(f"source: expected options among {known} in {uri!r}, got {unknown[0]!r}")
    try:
        settings = {key: _MOCK_OPTIONS[key](values[-1]) for key, values in query.items()}
        return mock_server.serve(parts.netloc + parts.path, faults=faults, **settings)
    except ValueError as wrong:
        raise ArgumentError(f"source: {uri!r}: {wrong}") from wrong


def _open_mock(uri: str, options: dict[str, Any]) -> Source:
    server = _mock(uri)
    try:
        source = _open_live((server.host, server.port), options)
    except BaseException:
        server.stop()
        raise
    leave = source.close

    def close() -> None:
        leave()
        server.stop()

    source.close = close  # type: ignore[method-assign]
    return source
