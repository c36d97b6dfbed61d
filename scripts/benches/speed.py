"""The figures of docs/performance.md in one run: composition, maps, a sequence, starts, a large recording.

``scripts/bench speed --before COMMIT`` measures an older commit first, and prints both.
"""

import importlib
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np

import omniscv
from benches import Figure, Reference, best_ms, start
from benches._faces import Noise, made_map
from omniscv import Renderer, RenderOptions, cameras
from omniscv.cameras import Camera
from omniscv.chart.central import PAPER, peers
from omniscv.compose.atlas import OUTSIDE
from omniscv.depth.ray_lookup import look_up
from omniscv.geometry import Pose, cube_rotations
from omniscv.job import Job
from omniscv.make import capture as capture_job
from omniscv.make import run
from omniscv.planning import ImageRays
from omniscv.sources import Request, View
from omniscv.sources.recording.inspection import info

KEPT = (
    ("equirectangular", 1024, 2048, 1024, {}, 1.15),
    ("fisheye-equidistant", 1024, 1024, 1024, {"fov_deg": 185}, 1.25),
    ("equirectangular", 2048, 256, 128, {}, 4.0),
)
"""Models, faces, sizes, and the goals of their times by that of one ``cv2.remap``."""
MODES = ("lit", "object_mask", "depth")
OURS, REMAP, FIXED = "ours", "one cv2.remap", "one cv2.remap, fixed-point map"
"""Both remaps read one picture of the stacked faces. A fixed-point map has 1/32 px: it is not exact."""


def measure(quick: bool) -> Iterator[Figure]:
    with suppress(ImportError):  # as the command line does, since it has it
        importlib.import_module("omniscv.parallel").keep_freed_memory()
    cv2.setNumThreads(omniscv.parallel.cores())
    yield from kept_maps(1 if quick else 15, 32 if quick else 1)
    took = best_ms(maps(64 if quick else 2048), 1 if quick else 10)
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
        took = best_ms(ways(camera, face_size // part), turns)
        title = f"6 x {face_size}^2 to {model} {width}x{height}, map kept"
        limit, ours = took.pop(REMAP), took.pop(OURS)
        for name, ms in ((REMAP, limit), (FIXED, took.pop(FIXED))):
            yield Figure(title, "time", "ms", ours, limit=Reference(name, ms))
        yield Figure(title, "by one cv2.remap", "times", ours / limit, limit=Reference("goal", goal))
        for name, ms in took.items():
            yield Figure(title, "time", "ms", ours, Reference(name, ms))


def ways(camera: Camera, face_size: int) -> dict[str, Callable[[], object]]:
    """Return a render, one remap by its map and, for panoramas, other programs; all of the same faces."""
    source, pose = Noise(), Pose.from_angles((0, 0, 1.5), yaw_deg=20, pitch_deg=5)
    options = RenderOptions("cube", face_size=face_size, filter="bilinear")
    rays = ImageRays(camera)
    views = made_map(rays, pose, face_size)[0]
    lookup = look_up(rays.directions.reshape(-1, 3), views, pose.R_w_c)
    faces = [capture.pixels for capture in source.capture(Request(view, "lit") for view in views)]
    y = np.where(lookup.view < 0, OUTSIDE, lookup.y - 0.5 + lookup.view * len(faces[0])).astype(np.float32)
    size, picture = (camera.height, camera.width), np.concatenate(faces)
    maps = [lookup.x.reshape(size) - np.float32(0.5), y.reshape(size)]

    def remap(maps: Sequence[np.ndarray]) -> object:
        return cv2.remap(picture, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)

    found: dict[str, Callable[[], object]] = {
        OURS: partial(Renderer(source).render, camera, pose, ("lit",), options),
        REMAP: partial(remap, maps),
        FIXED: partial(remap, cv2.convertMaps(*maps, cv2.CV_16SC2)),
    }
    if camera.name == "equirectangular":
        square = source.face(face_size)
        for name, peer in peers({name: square for name, _ in cube_rotations()}, camera).items():
            if name != PAPER:
                found[name] = partial(peer, 0)
    return found


def maps(width: int) -> dict[str, Callable[[], object]]:
    """Return what makes maps: views, a lookup and coordinates; each call has an orientation of its own."""
    turn = count()

    def unprojected() -> ImageRays:
        return ImageRays(cameras.create("equirectangular", width=width, height=width // 2))

    def make(rays: ImageRays) -> object:
        return made_map(rays, Pose.from_angles((0, 0, 1.5), yaw_deg=0.1 * next(turn)), width // 2)

    rays = unprojected()
    return {
        "new orientation of a known camera": lambda: make(rays),
        "camera never seen": lambda: make(unprojected()),
    }


def frames(folder: Path, count: int, width: int) -> Iterator[Figure]:
    """Compose a sequence from a recording into files: lit, object_mask, labels, depth and their marks."""
    capture_job(sequence(folder, "mock://four-wall", 1, width), folder / "room.sqlite")
    for store in ("files", "fast"):
        for number in (2, count):  # the first compiles
            job = sequence(folder, str(folder / "room.sqlite"), number, width)
            job = replace(job, store=store, out=folder / f"{store}-{number}")
            started, used = time.perf_counter(), time.process_time()
            run(job)
            seconds, used = time.perf_counter() - started, time.process_time() - used
        size = sum(path.stat().st_size for path in Path(job.out).iterdir()) / count
        title = f"sequence of {width}x{width // 2}: lit, mask, labels, depth, marks, store: {store}"
        yield Figure(title, "frames", "1/s", count / seconds, limit=Reference("goal", 10))
        yield Figure(
            title, "processor time of a frame", "ms", 1e3 * used / count, limit=Reference("goal", 150)
        )
        yield Figure(title, "size of a frame", "MB", size / 1e6, limit=Reference("goal", 5))


def sequence(folder: Path, source: str, frames: int, width: int) -> Job:
    """Return a job of panoramas at one place, each in another orientation, so that every map is new."""
    camera = cameras.create("equirectangular", width=width, height=width // 2)
    poses = tuple(
        Pose.from_angles((0, 0, 1.5), yaw_deg=3.6 * i, pitch_deg=20 - 0.4 * i, roll_deg=0.2 * i)
        for i in range(frames)
    )
    return Job(source, poses, {"pano": camera}, folder / f"out-{frames}", MODES)


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
        kernel.write_text(start.KERNEL_PROGRAM)
        ways = {
            "image": lambda: start.running("-c", start.IMAGE_PROGRAM),
            "kernel": lambda: start.running(str(kernel)),
        }
        took = best_ms(ways, turns)
    title, peer = "a new process, kernels cached", Reference("a kernel of numba", took["kernel"])
    yield Figure(title, "first image, 256x128", "ms", took["image"], peer)
