"""Servers and clients for these tests."""

import logging
import socket
import struct
import warnings

import pytest

import mock_server


class RawClient:
    """Bytes as they are on the wire, by the protocol's own description."""

    def __init__(self, server):
        self.socket = socket.create_connection((server.host, server.port), timeout=20)
        self.greeting = self.frame()
        self._id = 100

    def bytes(self, count):
        data = b""
        while len(data) < count:
            block = self.socket.recv(count - len(data))
            if not block:
                raise EOFError(data)
            data += block
        return data

    def frame(self):
        assert self.bytes(4) == b"\xc1\x83\x2b\x9e"
        return self.bytes(struct.unpack("<I", self.bytes(4))[0])

    def send(self, *payloads):
        self.socket.sendall(b"".join(b"\xc1\x83\x2b\x9e" + struct.pack("<I", len(p)) + p for p in payloads))

    def ask(self, command):
        """The body of the reply, with its id checked."""
        self._id += 1
        self.send(b"%d:%b" % (self._id, command.encode() if isinstance(command, str) else command))
        identity, colon, body = self.frame().partition(b":")
        assert (identity, colon) == (b"%d" % self._id, b":")
        return body

    def text(self, command):
        return self.ask(command).decode()


@pytest.fixture
def open_raw():
    """Opens raw clients, closed after the test."""
    clients = []

    def open_one(server):
        clients.append(RawClient(server))
        return clients[-1]

    yield open_one
    for client in clients:
        client.socket.close()


@pytest.fixture
def start():
    """Starts servers, stopped after the test: ``start("four-wall", dialect="N1")``."""
    servers = []

    def start_one(scene="four-wall", **options):
        servers.append(mock_server.serve(scene, **options))
        return servers[-1]

    yield start_one
    for server in servers:
        server.stop()


@pytest.fixture
def connect(monkeypatch):
    """Connects the official client, and disconnects it after the test."""
    import unrealcv

    monkeypatch.setattr(logging.getLogger("unrealcv"), "level", logging.CRITICAL)
    clients = []

    def connect_one(server):
        client = unrealcv.Client((server.host, server.port))
        with warnings.catch_warnings():
            # Every public server is too old for the client's question about its commands.
            warnings.filterwarnings("ignore", message=".*too old to report", category=UserWarning)
            assert client.connect()
        clients.append(client)
        return client

    yield connect_one
    for client in clients:
        leave(client)


def leave(client):
    """Ends a client at once: its own ``disconnect`` waits for the thread that reads."""
    if client.sock is not None:
        client.sock.shutdown(socket.SHUT_RDWR)
    client.disconnect()
