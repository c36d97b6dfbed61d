"""Growth of processor time and memory with megapixels, poses, cameras at a place, and viewpoints.

Each job runs in a process of its own, on captures that cost next to nothing. A slope is the exponent between
two jobs of which one is eight times the other: 1 if twice as much takes twice.
"""

import math
import resource  # noqa: TID251
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from benches import Figure
from benches._faces import Noise
from omniscv import Renderer, RenderOptions, cameras
from omniscv.geometry import Pose

FACTOR = 8
POSE = Pose.from_angles((0.1, -0.2, 1.45), yaw_deg=20.0)


def measure(quick: bool) -> Iterator[Figure]:
    width, least = (64, 1) if quick else (8192, 16)
    for what, job in JOBS.items():
        few, many = (_alone(job, width, count) for count in (least, FACTOR * least))
        yield Figure(what, f"{FACTOR * least}", "CPU s", many[0])
        yield Figure(what, f"{FACTOR * least}", "MB at most", many[1])
        for unit, first, last in zip(("slope of CPU s", "slope of MB"), few, many, strict=True):
            yield Figure(
                what, f"{least} to {FACTOR * least}", unit, max(math.log(last / first, FACTOR), 0.01)
            )


def sizes(renderer: Renderer, width: int, count: int) -> None:
    """Compose one panorama of a share of the pixels of the largest."""
    wide = 2 * round(width * math.sqrt(count / (16 * FACTOR)) / 2)
    camera = cameras.create("equirectangular", wide, wide // 2)
    renderer.render(camera, POSE, ("lit",), RenderOptions("cube", face_size=max(wide // 4, 8)))


def poses(renderer: Renderer, width: int, count: int) -> None:
    """Compose panoramas at as many positions, each in another orientation."""
    camera, options = cameras.create("equirectangular", width // 16, width // 32), _options(width)
    for i in range(count):
        renderer.render(camera, Pose.from_angles((0.01 * i, 0, 1.5), yaw_deg=3.7 * i), ("lit",), options)


def cameras_at_a_place(renderer: Renderer, width: int, count: int) -> None:
    """Compose as many fisheyes of one viewpoint and instant."""
    size = width // 32
    lenses = [cameras.create("fisheye-equidistant", size, size, fov_deg=170 + i / 4) for i in range(count)]
    for _ in renderer.render_together([(lens, POSE) for lens in lenses], ("lit",), _options(width)):
        pass


def viewpoints(renderer: Renderer, width: int, count: int) -> None:
    """Compose one non-central panorama from as many optical centres, close enough that no ray is marched."""
    camera = cameras.create("noncentral-panorama", width // 16, width // 32, radius=0.04)
    options = RenderOptions("cube", viewpoints=count, face_size=max(width // 64, 8))
    renderer.render(camera, POSE, ("lit",), options)


JOBS = {
    "megapixels": sizes,
    "poses": poses,
    "cameras at a place": cameras_at_a_place,
    "viewpoints": viewpoints,
}


def _options(width: int) -> RenderOptions:
    return RenderOptions("cube", face_size=max(width // 64, 8))


def _alone(job: Callable[[Renderer, int, int], None], width: int, count: int) -> tuple[float, float]:
    with ProcessPoolExecutor(1, get_context("spawn")) as process:
        return process.submit(_measured, job, width, count).result()


def _measured(job: Callable[[Renderer, int, int], None], width: int, count: int) -> tuple[float, float]:
    """Processor time, s, and peak memory of the process, MB; one small job before loads the kernels."""
    job(Renderer(Noise()), min(width, 1024), 1)
    started = time.process_time()
    job(Renderer(Noise()), width, count)
    return time.process_time() - started, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
