"""Shared by the tests of live sources: tracing of captures, and a relay that changes replies."""

import contextlib
import socket
import struct
import threading
from contextlib import contextmanager

import numpy as np

import omniscv

MODES = ("lit", "object_mask", "depth", "normals")


def agrees(capture, source, scene):
    """Whether all pixels but those on an edge, where a last digit decides, are as traced for its view."""
    view = capture.view
    lengths = view.ray_lengths()
    v, u = np.mgrid[: view.height, : view.width] + 0.5
    x, y = (u - view.width / 2) / view.focal_px, (v - view.height / 2) / view.focal_px
    rays_c = np.stack([x, y, np.ones_like(x)], axis=-1)
    hits = scene.trace(view.pose.t_w_c, rays_c @ view.pose.R_w_c.T)
    if capture.mode == "lit":  # colours are rounded to 8 bits
        wrong = (np.abs(capture.pixels - 255 * hits.color) > 0.5 + 1e-4).any(axis=-1)
    elif capture.mode == "object_mask":
        wrong = labels_of(capture.pixels, source.objects()) != hits.label
    elif capture.mode == "normals":  # 8 bits for -1 to 1, then made a unit vector again
        wrong = (np.abs(capture.pixels - hits.normal) > 2 / 255).any(axis=-1)
    else:  # half floats, of metres along the ray or planar centimetres
        to_wire = lengths if source.capabilities.dialect == "0.3.10" else 100.0
        sent = np.where(np.isfinite(hits.distance), hits.distance / lengths * to_wire, 1.0)
        step = np.spacing(sent.astype(np.float16)).astype(float) / to_wire
        off = np.abs(np.where(np.isinf(capture.pixels), 0, capture.pixels) - sent / to_wire)
        both_sky = np.isinf(capture.pixels) & np.isinf(hits.distance)
        wrong = ~both_sky & ~((off <= step / 2 + 1e-6) & np.isfinite(capture.pixels))
    return wrong.mean() < 0.005


def labels_of(mask, table):
    """(H, W) the label of each pixel by its colour; 0 for black, -1 for a colour of no object."""
    labels = np.where(mask.any(axis=-1), -1, 0)
    for name, color in table.colors.items():
        labels[(np.abs(mask.astype(int) - color) <= table.tolerance).all(axis=-1)] = table.label(name)
    return labels


def many_balls(count=48):
    """A scene with more objects than the 26 first mask colours, whose channels are 0, 127 and 255."""
    return {
        f"Ball_{i:02}": {"solids": [{"sphere": 0.2, "at": [2, 0.4 * (i % 8) - 1.4, 0.4 * (i // 8) + 0.4]}]}
        for i in range(count)
    }


@contextmanager
def relayed(server, change):
    """The address of a relay to a server: each reply is ``change(command, forward)``.

    ``forward(command)`` sends a command on, and returns the bytes that come back; text may be returned too.
    """
    with socket.create_server(("127.0.0.1", 0)) as listener:
        threading.Thread(target=_relay, args=(listener, server, change), daemon=True).start()
        yield f"unreal://127.0.0.1:{listener.getsockname()[1]}"
        listener.shutdown(socket.SHUT_RDWR)


def answering(reply, *parts):
    """A relay's change: commands that have one of these parts are answered by a reply."""
    return lambda command, forward: reply if any(part in command for part in parts) else forward(command)


@contextmanager
def opened(server, change, **options):
    """A source of a server, through a relay that changes its replies."""
    with relayed(server, change) as uri, omniscv.open_source(uri, **options) as source:
        yield source


def _relay(listener, server, change):
    with contextlib.suppress(OSError):
        while True:
            client, _ = listener.accept()
            upstream = socket.create_connection((server.host, server.port))
            for each in (client, upstream):
                each.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # else replies wait for each other
            with client, upstream, contextlib.suppress(OSError):
                _relay_client(client, upstream, change)


def _relay_client(client, upstream, change):
    def forward(command):
        upstream.sendall(frame(b"7:" + command.encode()))
        return receive(upstream).partition(b":")[2]

    client.sendall(frame(receive(upstream)))
    while True:
        identity, _, command = receive(client).partition(b":")
        reply = change(command.decode(), forward)
        body = reply.encode() if isinstance(reply, str) else reply
        client.sendall(frame(identity + b":" + body))


def frame(payload):
    """A frame of the protocol."""
    return b"\xc1\x83\x2b\x9e" + struct.pack("<I", len(payload)) + payload


def receive(connection):
    """The next frame's payload; OSError at the end of the stream."""
    data = b""
    size = 8
    while len(data) < size:
        block = connection.recv(size - len(data))
        if not block:
            raise OSError("the stream ended")
        data += block
        if len(data) == 8 == size:
            size += struct.unpack("<I", data[4:])[0]
    return data[8:]
