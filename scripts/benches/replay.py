"""How fast recordings are replayed from the page cache, faces of 1024 px.

Six faces a mode, each mode in a file of its own. "read and checked" is the payload as it lies in the file,
each byte through its checksum; its goal is 500 MB/s. "replayed" goes on to pixels, the same as for what comes
over the wire: there PNG costs what PNG costs, so the pixels that come out are given beside the payload that
goes in. "noise" is a picture that PNG cannot shrink, as photographs nearly are; the room's faces are smooth.
"""

import contextlib
import zlib
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np

import omniscv
from benches import Figure, Reference, best_ms
from omniscv import modalities
from omniscv.geometry import Pose, cube_rotations
from omniscv.sources import Capture, Request, View
from omniscv.sources.recording import RecordedSource
from omniscv.sources.recording.store import Store

GOAL_MB_S = 500
NOISE = "lit, noise"


def measure(quick: bool) -> Iterator[Figure]:
    size, turns, repeats = (16, 1, 1) if quick else (1024, 5, 4)
    with TemporaryDirectory() as folder:
        for name, path in record(Path(folder), size).items():
            requests = faces(size, name.partition(",")[0]) * repeats
            with contextlib.closing(Store(path)) as store, RecordedSource(path) as source:
                captures = list(source.capture(requests))
                payload = sum(len(capture.payload) for capture in captures) / 1e3
                pixels = sum(capture.pixels.nbytes for capture in captures) / 1e3
                work = {
                    "check": lambda store=store: [check(store) for _ in range(repeats)],
                    "replay": lambda source=source, requests=requests: list(source.capture(requests)),
                }
                took = best_ms(work, turns)
            title, goal = f"{name}, faces of {size} px", Reference("goal", GOAL_MB_S)
            yield Figure(title, "payload read and checked", "MB/s", payload / took["check"], limit=goal)
            yield Figure(title, "payload replayed", "MB/s", payload / took["replay"])
            yield Figure(title, "pixels replayed", "MB/s", pixels / took["replay"])
            yield Figure(title, "replayed", "captures/s", 1e3 * len(requests) / took["replay"])


def faces(size: int, mode: str) -> list[Request]:
    """Return the six faces at a centre."""
    pose = (0, 0, 1.5)
    return [Request(View(Pose(pose, R_w_c), 90.0, size, size), mode) for _, R_w_c in cube_rotations()]


def record(folder: Path, size: int) -> dict[str, Path]:
    """Record the room's faces in each mode, and faces of noise."""
    files = {name: folder / f"{i}.sqlite" for i, name in enumerate((*modalities.names(), NOISE))}
    for mode in modalities.names():
        live = omniscv.open_source("mock://four-wall")
        with omniscv.record(live, files[mode]) as source:
            for _ in source.capture(faces(size, mode)):
                pass
    random = np.random.default_rng(1)
    with contextlib.closing(Store(files[NOISE], write=True)) as store:
        for request in faces(size, "lit"):
            noise = random.integers(0, 256, (size, size, 3), dtype=np.uint8)
            payload = cv2.imencode(".png", noise[..., ::-1])[1].tobytes()
            store.add(Capture(request, request.view, noise, payload=payload, encoding="png"))
    return files


def check(store: Store) -> None:
    """Read every payload, and compare its checksum."""
    assert all(zlib.crc32(row.payload) == row.payload_checksum for row in store.rows())
