"""How fast a sequence is composed from a recording: 100 frames of 1920 x 960, files written.

Panoramas in lit, object_mask and depth, with a new orientation each, so that every map is new; colours as PNG
and as JPEG XL, both lossless. The goal is 10 frames/s on two cores: 200 ms of processor time a frame, which
holds on a busy machine too. All frames are at one place, whose captures are decoded once. Parts of the work
are ms of all cores a frame by the clock, so they add up to more than it. Memory must not grow with the
sequence: the most that the process held at the end is given beside the most after a tenth of the frames.
"""

import resource
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import wraps
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import cv2

import omniscv.compose.composition
import omniscv.compose.files
import omniscv.compose.samplers
import omniscv.sources.recording.rows
from benches import Figure, Reference
from omniscv.compose.atlas import Atlas
from omniscv.compose.samplers import CpuSampler
from omniscv.geometry import Pose
from omniscv.jobs import Job, capture, run
from omniscv.sources.recording.store import Store

MODES = ("lit", "object_mask", "depth")
GOAL_FRAMES_S, GOAL_CPU_MS = 10, 200
PARTS = (
    (Store, "get", "read"),
    (omniscv.sources.recording.rows, "decode", "decode"),
    (omniscv.compose.samplers, "look_up", "map"),
    (Atlas, "coordinates", "map"),
    (CpuSampler, "sample", "sample"),
    (CpuSampler, "sample_depth", "sample"),
    (omniscv.compose.composition, "labels_of", "labels"),
    (omniscv.compose.files, "write_picture", "encode"),
    (Path, "write_bytes", "write"),
)


def measure(quick: bool) -> Iterator[Figure]:
    frames, width = (2, 64) if quick else (100, 1920)
    cv2.setNumThreads(2)
    for form in ("png",) if quick else ("png", "jxl"):
        with TemporaryDirectory() as folder:
            recording = Path(folder) / "room.sqlite"
            capture(job(folder, "mock://four-wall", 1, width, form), recording)
            for count in () if quick else (2, frames // 10):  # the first compiles
                run(job(folder, str(recording), count, width, form))
            early = peak_mb()
            with timed() as spent:
                started, used = time.perf_counter(), time.process_time()
                run(job(folder, str(recording), frames, width, form))
                seconds, used = time.perf_counter() - started, time.process_time() - used
        title, goal = f"{frames} frames as {form}", Reference("goal", GOAL_FRAMES_S)
        yield Figure(title, "speed", "frames/s", frames / seconds, limit=goal)
        limit = Reference("goal", GOAL_CPU_MS)
        yield Figure(title, "processor time", "ms a frame", 1e3 * used / frames, limit=limit)
        for part, took in spent.items():
            yield Figure(title, part, "ms a frame", 1e3 * took / frames)
        at_first = Reference("after a tenth", early)
        yield Figure(title, "most memory", "MB", peak_mb(), at_first)


def job(folder: str, source: str, frames: int, width: int, form: str) -> Job:
    """Return the sequence."""
    camera = omniscv.cameras.create("equirectangular", width=width, height=width // 2)
    poses = tuple(
        Pose.from_angles((0, 0, 1.5), yaw_deg=3.6 * i, pitch_deg=20 - 0.4 * i, roll_deg=0.2 * i)
        for i in range(frames)
    )
    return Job(source, {"pano": camera}, poses, Path(folder) / f"out-{frames}", MODES, image_format=form)


def peak_mb() -> float:
    """Return the most memory that this process has held."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


@contextmanager
def timed() -> Iterator[dict[str, float]]:
    """Yield what each part of the work takes, s of all threads; parts within others count once."""
    spent: dict[str, float] = defaultdict(float)
    lock, inside = threading.Lock(), threading.local()

    def counted(call: Callable[..., Any], part: str) -> Callable[..., Any]:
        @wraps(call)
        def timed_call(*arguments: Any, **options: Any) -> Any:
            outer, inside.taken = getattr(inside, "taken", 0.0), 0.0
            started = time.perf_counter()
            try:
                return call(*arguments, **options)
            finally:
                took = time.perf_counter() - started
                with lock:
                    spent[part] += took - inside.taken
                inside.taken = outer + took

        return timed_call

    with ExitStack() as patched:
        for owner, name, part in PARTS:
            patched.enter_context(patch.object(owner, name, counted(getattr(owner, name), part)))
        yield spent
