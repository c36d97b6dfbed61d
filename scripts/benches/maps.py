"""How long a map takes to make, for a new orientation and for a camera never seen, and what keeping saves.

A map is views, a lookup and coordinates. The goals are 15 ms and 100 ms at 2048 x 1024 by the clock;
processor time of both cores, which a busy machine distorts less, is to be at most twice that. A job of four
fisheyes at six turning poses, pose by pose, is to take at most 1.1 times what it takes camera by camera.
"""

import time
from collections.abc import Callable, Iterable, Iterator
from itertools import count

from benches import Figure, Reference, best_ms
from benches._faces import Noise, made_map
from omniscv import Renderer, RenderOptions, cameras
from omniscv.cameras import Camera
from omniscv.geometry import Pose
from omniscv.planning import ImageRays

FISHEYES = ("fisheye-equidistant", "fisheye-stereographic", "fisheye-equisolid", "fisheye-orthographic")
POSES = 6


def measure(quick: bool) -> Iterator[Figure]:
    turns, width, edge = (1, 64, 16) if quick else (15, 2048, 512)
    clocks = ("", 1, time.perf_counter), (", processor time", 2, time.process_time)
    for what, cores, clock in clocks:
        took = best_ms(maps(width), turns, clock)
        for (name, ms), goal in zip(took.items(), (15, 100), strict=True):
            limit = Reference("goal", cores * goal)
            yield Figure(f"map of {width} x {width // 2}{what}", name, "ms", ms, limit=limit)
    by_camera, by_pose = best_ms(orders(edge), max(1, turns // 3)).values()
    title = f"four fisheyes of {edge}^2 at {POSES} turning poses"
    peer = Reference("camera by camera", by_camera)
    yield Figure(title, "pose by pose", "ms", by_pose, peer)


def maps(width: int) -> dict[str, Callable[[], object]]:
    """Return what makes maps; each call has an orientation of its own."""
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


def orders(edge: int) -> dict[str, Callable[[], object]]:
    """Return one job in two orders, each time by a new renderer."""
    source, options = Noise(), RenderOptions("cube", face_size=edge)
    four = [cameras.create(name, width=edge, height=edge, fov_deg=170) for name in FISHEYES]
    poses = [Pose.from_angles((0, 0, 1.5), yaw_deg=11.0 * i, pitch_deg=2.0 * i) for i in range(POSES)]

    def work(items: Iterable[tuple[Camera, Pose]]) -> None:
        renderer = Renderer(source)
        for camera, pose in items:
            renderer.render(camera, pose, ("lit",), options)

    return {
        "camera by camera": lambda: work((camera, pose) for camera in four for pose in poses),
        "pose by pose": lambda: work((camera, pose) for pose in poses for camera in four),
    }
