"""How work on one image scales with threads: 1, 2, 4, ..., as many as there are cores.

Panoramas from six faces: one with its map kept, and one of a new orientation in colour, masks and depth. Each
is a whole render; the ratio is its speed by that of one thread. Encoding is left out: files of several frames
are written at a time.
"""

import os
from collections.abc import Callable, Iterator
from itertools import count, takewhile

import cv2

from benches import Figure, Reference, best_ms
from omniscv import Renderer, RenderOptions, cameras, parallel
from omniscv.geometry import Pose
from omniscv.parallel import keep_freed_memory
from omniscv.sources.scene import SceneSource, open_scene

MODES = ("lit", "object_mask", "depth")


def measure(quick: bool) -> Iterator[Figure]:
    keep_freed_memory()
    works, alone = ways(64 if quick else 2048), dict[str, float]()
    for threads in takewhile(lambda n: n <= (os.cpu_count() or 1), (2**i for i in count())):
        parallel.limit(threads)
        cv2.setNumThreads(threads)
        for name, ms in best_ms(works, 1 if quick else 9).items():
            one = Reference("one thread", 1e3 / alone.setdefault(name, ms))
            yield Figure(f"{threads} threads", name, "images/s", 1e3 / ms, one)
    parallel.limit(os.cpu_count() or 1)


def ways(width: int) -> dict[str, Callable[[], object]]:
    """Return the works, on captures that are traced once."""
    scene = open_scene("scene://four-wall").scene
    renderer, turn = Renderer(SceneSource(scene, cached_views=6)), count()
    camera = cameras.create("equirectangular", width=width, height=width // 2)
    options = RenderOptions("cube", face_size=width // 2)
    level = Pose.from_angles((0, 0, 1.5), yaw_deg=20, pitch_deg=5)

    def turned() -> object:
        pose = Pose.from_angles((0, 0, 1.5), yaw_deg=0.1 * next(turn))
        return renderer.render(camera, pose, MODES, options)

    return {
        "map kept, colour": lambda: renderer.render(camera, level, ("lit",), options),
        "new orientation, all layers": turned,
    }
