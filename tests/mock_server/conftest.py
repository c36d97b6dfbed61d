"""Servers and clients for these tests."""

import contextlib
import functools
import logging
import warnings

import pytest
from support.expected_views import seen_by_hand
from support.wire import RawClient, leave

import mock_server


@pytest.fixture
def open_raw():
    with contextlib.ExitStack() as clients:

        def open_one(server):
            client = RawClient(server)
            clients.callback(client.socket.close)
            return client

        yield open_one


@pytest.fixture(scope="session")
def load_scene():
    """Loads scenes, each once: nothing changes them, and reading a file takes longer than most tests."""
    return functools.cache(mock_server.load_scene)


@pytest.fixture
def start(load_scene):
    """Starts servers, stopped after the test: ``start("four-wall", dialect="N1")``."""
    with contextlib.ExitStack() as servers:
        yield lambda scene="four-wall", **options: servers.enter_context(
            mock_server.serve(load_scene(scene), **options)
        )


@pytest.fixture(scope="module")
def serve_for_module():
    """Starts servers that are stopped after the module, and returns a raw client of each."""
    with contextlib.ExitStack() as opened:

        def start_one(scene, **options):
            client = RawClient(opened.enter_context(mock_server.serve(scene, **options)))
            opened.callback(client.socket.close)
            return client

        yield start_one


@pytest.fixture
def connect(monkeypatch):
    """Connects the official client to a server, or a Unix socket, and disconnects it after the test."""
    import unrealcv

    monkeypatch.setattr(logging.getLogger("unrealcv"), "level", logging.CRITICAL)
    clients = []

    def connect_one(server):
        unix = isinstance(server, str)
        client = unrealcv.Client(server if unix else (server.host, server.port), "unix" if unix else "inet")
        with warnings.catch_warnings():
            # Every public server is too old for the client's question about its commands.
            warnings.filterwarnings("ignore", message=".*too old to report", category=UserWarning)
            assert client.connect()
        clients.append(client)
        return client

    yield connect_one
    for client in clients:
        leave(client)


@pytest.fixture
def raw(start, open_raw):
    """A raw client of dialect N1."""
    return open_raw(start(dialect="N1", size=(40, 30)))


@pytest.fixture
def camera(raw):
    """A client with a spawned camera 1 of 40 x 30 pixels, turned and moved."""
    raw.ask("vset /cameras/spawn")
    for command in ("size 40 30", "fov 75.5", "location 10.0 -20.0 150.0", "rotation 10.0 30.0 5.0"):
        assert raw.ask(f"vset /camera/1/{command}") == b"ok"
    return raw


@pytest.fixture(scope="module")
def truth(load_scene):
    """The scene, hits and planar depth of ``camera``."""
    scene = load_scene("four-wall")
    return scene, *seen_by_hand(scene, (10, -20, 150), (10, 30, 5), 75.5, 40, 30)
