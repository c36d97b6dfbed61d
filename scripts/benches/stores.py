"""How fast a worker puts small frames into a store that is 50 ms away, also where 12 % of its requests fail.

The store is in memory, so that its own work takes no processor. Of a hundred requests five fail before they
are served and three after it, two are cut, and two take 2 s more. A worker of a cluster makes parts of 16
frames one after the other, as here.
"""

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

import fsspec
from fsspec.implementations.memory import MemoryFileSystem

import omniscv
from benches import Figure, Reference
from omniscv.job import load
from omniscv.make import parts_of, run_part

LATENCY_S, STALL_S = 0.05, 2.0
BEFORE, AFTER, LATE = (7, 23, 28, 41, 62, 70, 88), (15, 50, 77), (33, 96)
"""Numbers of the requests in a hundred that fail."""
WANTED = 10.0  # frames a second; a third of it where requests fail
JOB = """
source: scene://four-wall
cameras: {{pano: {{model: equirectangular, width: 32, height: 16}}}}
poses: {{path: {{waypoints: [[-1, 0.2, 1.5], [1, 0.2, 1.5]], speed: 1, rate: {rate}}}}}
modes: [lit, object_mask, depth]
face_size: 16
out: far://rooms/{name}
"""


class Far(MemoryFileSystem):  # type: ignore[misc] # fsspec is imported without its types
    """A store in memory that answers late."""

    protocol = "far"
    store: ClassVar[dict[str, Any]] = {}
    pseudo_dirs: ClassVar[list[str]] = [""]
    fails: ClassVar[bool] = False
    requests: ClassVar[int] = 0
    counting: ClassVar[threading.Lock] = threading.Lock()


def far(name: str) -> Any:
    """Return an operation of :class:`Far`."""

    def served(self: Far, *values: Any, **options: Any) -> Any:
        with Far.counting:
            Far.requests += 1
            number = Far.requests % 100 if Far.fails else 0
        time.sleep(LATENCY_S + STALL_S * (number in LATE))
        if number in BEFORE:
            raise ConnectionResetError
        result = getattr(MemoryFileSystem, name)(self, *values, **options)
        if number in AFTER:
            raise ConnectionResetError
        return result

    return served


for operation in ("info", "find", "get_file", "cat_file", "pipe_file", "put_file", "rm_file"):
    setattr(Far, operation, far(operation))


def measure(quick: bool) -> Iterator[Figure]:
    fsspec.register_implementation("far", Far, clobber=True)
    for fails, wanted in ((False, WANTED), (True, WANTED / 3)):
        Far.store.clear()
        Far.fails, Far.requests = fails, 0
        name = "12 % of requests fail" if fails else "50 ms a request"
        yield Figure(
            "frames of a worker",
            name,
            "frames/s",
            made(2 if quick else 128),
            limit=Reference("wanted", wanted),
        )


def made(frames: int) -> float:
    """Return the frames a second of making a dataset part by part."""
    with TemporaryDirectory() as folder, omniscv.open_source("scene://four-wall") as source:
        path = Path(folder) / "job.yaml"
        path.write_text(JOB.format(rate=frames / 2.01, name=path.parent.name), encoding="utf-8")
        job, began = load(path), time.perf_counter()
        for part in parts_of(job):
            run_part(job, part, source=source)
        return len(job) / (time.perf_counter() - began)
