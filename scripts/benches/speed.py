"""The figures of docs/performance.md in one run: composition, maps, a sequence, starts, a large recording.

``scripts/bench speed --before 9bf8d27`` measures an older commit first, and prints both. It uses nothing of
the package but what that commit has, too.
"""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2

import omniscv
from benches import Figure, Reference, best_ms, compose, maps, sequence, start
from omniscv import cameras, jobs
from omniscv.geometry import Pose
from omniscv.sources import Request, View
from omniscv.sources.recording.inspection import info

KEPT = (
    ("equirectangular", 1024, 2048, 1024, {}, 1.15),
    ("fisheye-equidistant", 1024, 1024, 1024, {"fov_deg": 185}, 1.25),
    ("equirectangular", 2048, 256, 128, {}, 4.0),
)
"""Models, faces, sizes, and the goals of their times by that of one ``cv2.remap``."""
MODES = ("lit", "object_mask", "depth")


def measure(quick: bool) -> Iterator[Figure]:
    cv2.setNumThreads(omniscv.parallel.cores())
    yield from kept_maps(1 if quick else 15, 32 if quick else 1)
    took = best_ms(maps.maps(64 if quick else 2048), 1 if quick else 10)
    for (name, ms), goal in zip(took.items(), (12, 70), strict=True):
        yield Figure("maps of 2048x1024", name, "ms", ms, limit=Reference("goal", goal))
    with TemporaryDirectory() as folder:
        yield from frames(Path(folder), *((2, 64) if quick else (30, 1920)))
    memory = "/dev/shm"  # a commit for each capture: not to measure how long disks take
    with TemporaryDirectory(dir=memory if Path(memory).is_dir() else None) as folder:
        yield from recorded(Path(folder) / "large.sqlite", 30 if quick else 20_000)
    yield from first_image(1 if quick else 4)


def kept_maps(turns: int, part: int) -> Iterator[Figure]:
    """Compose from decoded faces, the map kept."""
    for model, face_size, width, height, more, goal in KEPT:
        camera = cameras.create(model, width=width // part, height=height // part, **more)
        ways = compose.ways(camera, face_size // part)
        for name in ("nearest", "bicubic", "area", compose.FIXED, "the paper's algorithm"):
            ways.pop(name, None)
        took = best_ms(ways, turns)
        title = f"6 x {face_size}^2 to {model} {width}x{height}, map kept"
        limit = took.pop(compose.FLOAT)
        ours = took.pop("bilinear")
        yield Figure(title, "time", "ms", ours, limit=Reference("one cv2.remap", limit))
        yield Figure(title, "by one cv2.remap", "times", ours / limit, limit=Reference("goal", goal))
        for name, ms in took.items():
            yield Figure(title, "time", "ms", ours, Reference(name, ms))


def frames(folder: Path, count: int, width: int) -> Iterator[Figure]:
    """Compose a sequence from a recording into files: lit, object_mask, labels, depth and their marks."""
    capturing = sequence.job(str(folder), "mock://four-wall", 1, width, "png")
    jobs.capture(capturing, folder / "room.sqlite")
    for frames in (2, count):  # the first compiles
        job = sequence.job(str(folder), str(folder / "room.sqlite"), frames, width, "png")
        started, used = time.perf_counter(), time.process_time()
        jobs.run(job)
        seconds, used = time.perf_counter() - started, time.process_time() - used
    size = sum(path.stat().st_size for path in Path(job.out).iterdir()) / count
    title = f"sequence of {width}x{width // 2}: lit, mask, labels, depth, marks, in files"
    yield Figure(title, "frames", "1/s", count / seconds, limit=Reference("goal", 10))
    yield Figure(title, "processor time of a frame", "ms", 1e3 * used / count, limit=Reference("goal", 150))
    yield Figure(title, "size of a frame", "MB", size / 1e6, limit=Reference("goal", 5))


def recorded(path: Path, count: int) -> Iterator[Figure]:
    """Open a recording of many captures, and list what it holds."""
    poses = (Pose.from_angles((0.0002 * i, 0, 1.5)) for i in range(-(-count // len(MODES))))
    views = (View(pose, 90.0, 8, 8) for pose in poses)
    requests = [Request(view, mode) for view in views for mode in MODES]
    with omniscv.record(omniscv.open_source("scene://four-wall"), path) as source:
        for _ in source.capture(requests):
            pass

    def opened() -> None:
        with omniscv.open_source(str(path)):
            pass

    ways: dict[str, Callable[[], object]] = {"open": opened, "info": lambda: info(path)}
    for name, ms in best_ms(ways, 2, time.process_time).items():
        yield Figure(f"recording of {len(requests):,} captures", name, "ms", ms, limit=Reference("goal", 300))


def first_image(turns: int) -> Iterator[Figure]:
    """Start processes whose kernels are cached."""
    with TemporaryDirectory() as folder:
        kernel = Path(folder) / "kernel.py"
        kernel.write_text(start._KERNEL)
        ways = {
            "image": lambda: start.running("-c", start._IMAGE),
            "kernel": lambda: start.running(str(kernel)),
        }
        took = best_ms(ways, turns)
    title, peer = "a new process, kernels cached", Reference("a kernel of numba", took["kernel"])
    yield Figure(title, "first image, 256x128", "ms", took["image"], peer)
