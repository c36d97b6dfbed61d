"""Hostile servers, over real sockets: replies that lie, stall, flood or break off."""

import contextlib
import io
import random
import socket
import struct
import threading
import time

import numpy as np
from support.unreal import frame, receive

from attack.commands import nothing_left, ran, require
from attack.samples import JOB, pictures, sample, server

SECONDS = 25
"""For a command whose server may be silent: timeout 0.4 s, one retry."""

MAGIC = b"\xc1\x83\x2b\x9e"


TRANSPORT = {
    "other-id": lambda rng, i, body: frame(b"%d:" % rng.choice([0, 1, int(i) + 1, 2**31, 2**63]) + body),
    "no-id": lambda rng, i, body: frame(body),
    "wild-id": lambda rng, i, body: frame(rng.choice([b"", b"-1", b"x", b"9" * 5000, b" 7"]) + b":" + body),
    "magic": lambda rng, i, body: rng.randbytes(4) + struct.pack("<I", len(body)) + body,
    "size-0": lambda rng, i, body: MAGIC + struct.pack("<I", 0),
    "size-4-gib": lambda rng, i, body: MAGIC + struct.pack("<I", 0xFFFFFFFF) + body,
    "size-more": lambda rng, i, body: (
        MAGIC + struct.pack("<I", len(i) + len(body) + 1 + rng.randint(1, 99)) + i + b":" + body
    ),
    "size-less": lambda rng, i, body: MAGIC + struct.pack("<I", max(1, len(body) // 2)) + i + b":" + body,
    "cut": lambda rng, i, body: frame(i + b":" + body)[: rng.randrange(len(body) + 9)] + b"\0CLOSE",
    "close": lambda rng, i, body: b"\0CLOSE",
    "silent": lambda rng, i, body: b"",
    "garbage": lambda rng, i, body: rng.randbytes(rng.choice([1, 8, 100, 100_000])),
    "twice": lambda rng, i, body: frame(i + b":" + body) * 2,
    "event": lambda rng, i, body: frame(b"clicked") + frame(i + b":" + body),
    "bytewise": lambda rng, i, body: b"\0SLOW" + frame(i + b":" + body),
    "endless": lambda rng, i, body: MAGIC + struct.pack("<I", 1 << 28) + b"\0FLOOD",
}
"""By name: what is sent in place of a reply. Whatever comes of them, images are the honest ones."""


def png(rng, body):
    kind = rng.randrange(6)
    if kind == 0:
        return body[: rng.randrange(len(body) + 1)]
    if kind == 1:
        data = bytearray(body)
        for _ in range(rng.choice([1, 10])):
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        return bytes(data)
    if kind == 2:  # another size than its data
        side = rng.choice([0, 1, 17, 65535, 2**31 - 1])
        return body[:16] + struct.pack(">II", side, side) + body[24:]
    if kind == 3:
        return b"\x89PNG\r\n\x1a\n" + rng.randbytes(rng.choice([0, 20, 3000]))
    return rng.choice([body + body, b"BM" + body, b"", b"\0" * 50, body.replace(b"IDAT", b"IEND")])


def npy(rng, body):
    shape = rng.choice(
        [
            "(16, 16)",
            "(0, 0)",
            "(-1, 16)",
            "(999999999, 999999999)",
            "(16,)",
            "()",
            "(16, 16, 16)",
            "[" * 1000,
            "(" + "9" * 5000 + ",)",
        ]
    )
    descr = rng.choice(
        ["'<f4'", "'|O'", "'<f8'", "'>f4'", "'<c16'", "'V99'", "__import__('os')", "[('a', '<f4')]"]
    )
    order = rng.choice(["False", "True", "7"])
    header = f"{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}".encode()
    made = (
        b"\x93NUMPY\x01\x00"
        + struct.pack("<H", min(65535, len(header)))
        + header
        + rng.randbytes(rng.choice([0, 1024]))
    )
    stream = io.BytesIO()
    values = rng.choice([np.nan, np.inf, -1.0, 0.0, 1e38, 1e-40])
    np.save(
        stream, np.full(rng.choice([(16, 16), (8, 8), (16, 16, 1), (1, 1), (512, 512)]), values, np.float32)
    )
    return rng.choice(
        [made, stream.getvalue(), body[: rng.randrange(len(body) + 1)], b"\x93NUMPY" + rng.randbytes(50)]
    )


TEXTS = [
    b"",
    b"ok",
    b"error",
    b"error " + b"x" * 100_000,
    b"error \x1b[31m[/b]\xe2\x80\xae",
    b"\xff\xfe\x00",
    b"nan nan nan",
    b"1e400 0 0",
    b"0 0",
    b"0 0 0 0 0 0 0",
    b"(R=999,G=0,B=0,A=255)",
    b"(R=" + b"9" * 5000 + b",G=0,B=0)",
    b"(R=-1,G=1.5,B=x)",
    b"9" * 100_000,
    b" ".join(b"Obj%d" % i for i in range(30_000)),
    b"A A A",
    b"[/b] \x1b]0;x\x07 ../up",
    b"0 1 2 3 4",
    b"-1",
    b"640x480",
    b"90",
    b"0",
    b"1.0.1",
    b"0.3.10",
    b"a\nb\r\nc",
    b"None",
    b"{}",
    b"\xe2\x80\xae",
]


def text(rng, body):
    return rng.choice([*TEXTS, body + body, body[::-1], body[: len(body) // 2], rng.randbytes(30)])


class Hostile:
    """Relays to the mock server, and spoils the replies that a seed chooses; a context manager."""

    def __init__(self, rng):
        self.seed, self.honest = rng.random(), rng.random() < 0.5
        self.first, self.share = rng.choice([0, 0, 3, 10, 20]), rng.choice([0.05, 0.3, 1.0])
        self.behaviours = rng.sample(list(TRANSPORT), rng.choice([1, 1, 2]))
        self.content = rng.choice([png, npy, text, text])
        self.greets = rng.random() < 0.95
        self.count, self.stopped = 0, False
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.threads = [threading.Thread(target=self._accept, daemon=True)]
        self.lock, self.sockets = threading.Lock(), [self.listener]

    @property
    def uri(self):
        return f"unreal://127.0.0.1:{self.listener.getsockname()[1]}"

    def __enter__(self):
        self.threads[0].start()
        return self

    def __exit__(self, *error):
        self.stopped = True
        for each in list(self.sockets):
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()
        for each in self.threads:
            each.join(10)

    def _accept(self):
        with contextlib.suppress(OSError):
            while not self.stopped:
                client, _ = self.listener.accept()
                self.sockets.append(client)
                thread = threading.Thread(target=self._serve, args=(client,), daemon=True)
                self.threads.append(thread)
                thread.start()

    def _serve(self, client):
        with (
            contextlib.suppress(OSError, ValueError),
            client,
            socket.create_connection((server().host, server().port)) as upstream,
        ):
            greeting = receive(upstream)
            if self.greets:
                client.sendall(frame(greeting))
            while not self.stopped:
                identity, _, command = receive(client).partition(b":")
                upstream.sendall(frame(b"7:" + command))
                body = receive(upstream).partition(b":")[2]
                with self.lock:
                    number = self.count
                    self.count += 1
                self._reply(client, number, identity, body)

    def _reply(self, client, number, identity, body):
        rng = random.Random(f"{self.seed} {number}")
        if number < self.first or rng.random() >= self.share:
            return client.sendall(frame(identity + b":" + body))
        if not self.honest:
            kind = {b"\x89PNG": png, b"\x93NUM": npy}.get(body[:4], text)
            spoiled = kind(rng, body) if kind is self.content else body
            return client.sendall(frame(identity + b":" + spoiled))
        data = TRANSPORT[rng.choice(self.behaviours)](rng, identity, body)
        if data.startswith(b"\0SLOW"):
            for each in data[5:205]:
                client.sendall(bytes([each]))
                time.sleep(0.01)
            return client.sendall(data[205:])
        if data.endswith(b"\0FLOOD"):
            client.sendall(data[:-6])
            while not self.stopped:
                client.sendall(bytes(1 << 16))
                time.sleep(0.01)
        client.sendall(data.removesuffix(b"\0CLOSE"))
        if data.endswith(b"\0CLOSE"):
            raise OSError("closed on purpose")
        return None


def case(rng, folder):
    """A hostile server is an error in one line, in time; where only the transport lied, images are right."""
    true = sample()
    with nothing_left(folder) as work, Hostile(rng) as hostile:
        (work / "job.yaml").write_text(JOB.format(source=hostile.uri))
        started = time.monotonic()
        kind = rng.random()
        if kind < 0.6:
            outcome = ran(["render", "job.yaml"])
            if outcome.code == 0 and hostile.honest:
                require(pictures(work / "images") == true.images, "images differ from the honest server's")
            half = [each.name for each in work.rglob("*part*")]
            require(not half, f"half files are left: {half}")
        elif kind < 0.7:
            ran(["doctor", hostile.uri, "--timeout", "0.1", "--patience", "1"])
        else:
            outcome = ran(["record", "job.yaml", "--out", "room.sqlite"])
            if (work / "room.sqlite").exists():
                verified = ran(["captures", "verify", "room.sqlite"])
                require(verified.code == 0, f"the recording does not verify: {verified.out}{verified.err}")
        took = time.monotonic() - started  # the doctor makes hundreds of exchanges, and may lose many
        require(took < SECONDS or 0.6 <= kind < 0.7, f"{took:.1f} s")
