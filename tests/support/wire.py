"""Talking to a server without, and with, the official client."""

import base64
import contextlib
import json
import socket
import struct
import subprocess
import sys
import warnings


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

    def settle(self):
        """Three synchronous round trips: enough for pose and picture."""
        for _ in range(3):
            self.ask("vget /unrealcv/version")


OLD_CLIENT = """
import base64, json, sys
sys.path.insert(0, sys.argv[1])
import unrealcv
unrealcv.client.message_client.endpoint = sys.argv[2], int(sys.argv[3])
assert unrealcv.client.connect(timeout=20)
for line in sys.stdin:
    reply = unrealcv.client.request(json.loads(line), timeout=20)
    data = reply if isinstance(reply, bytes) else reply.encode()
    print(json.dumps([isinstance(reply, str), base64.b64encode(data).decode()]), flush=True)
"""


@contextlib.contextmanager
def old_client(server, folder):
    """The request function of the official client 0.3.10, from a folder: both versions have one name."""
    command = [sys.executable, "-W", "ignore", "-c", OLD_CLIENT, folder, server.host, str(server.port)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:

        def request(text):
            process.stdin.write(json.dumps(text) + "\n")
            process.stdin.flush()
            is_text, data = json.loads(process.stdout.readline())
            return base64.b64decode(data).decode() if is_text else base64.b64decode(data)

        yield request
        process.stdin.close()


def leave(client):
    """Ends a client at once: its own ``disconnect`` waits for the thread that reads."""
    if client.sock is not None:
        client.sock.shutdown(socket.SHUT_RDWR)
    client.disconnect()


def official_api(server, size):
    """The official high-level API, connected to a server; every public one is too old for its questions."""
    from unrealcv.api import UnrealCv_API

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*too old to report", category=UserWarning)
        return UnrealCv_API(server.port, server.host, size)
