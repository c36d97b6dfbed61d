"""Meshes: opening a million triangles, images of them by rays, and growth with the number of triangles."""

import resource  # noqa: TID251
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import omniscv
from benches import Figure, Reference

DATA = ("object_mask", "depth", "normals")
LEVELS = (2, 3, 4, 5, 6)
"""Subdivisions of the balls of the furnished room: 3,996 to 983,196 triangles."""
LIMITS = {
    "fisheye, data": 0.4,
    "fisheye, 4 colour rays": 2.0,
    "panorama, data": 1.04,
    "panorama, 4 colour rays": 5.2,
}
"""CPU seconds that are to be kept."""
_REPEATS = 3


def measure(quick: bool) -> Iterator[Figure]:
    px = 64 if quick else 1024
    for level in LEVELS[:2] if quick else LEVELS:
        found = _alone(level, px)
        name = f"{found['triangles']} triangles"
        if level == LEVELS[-1]:
            million = "a million triangles"
            yield Figure(million, "opening", "CPU s", found["opening"], limit=Reference("aim", 4.0))
            yield Figure(million, "opening", "MB", found["MB"], limit=Reference("aim", 1000.0))
            for what, most in LIMITS.items():
                yield Figure(million, what, "CPU s", found[what], limit=Reference("aim", most))
        yield Figure("growth", name, "CPU s, opening", found["opening"])
        yield Figure("growth", name, "CPU s, fisheye, data", found["fisheye, data"])


def _alone(level: int, px: int) -> dict[str, Any]:
    with ProcessPoolExecutor(1, get_context("spawn")) as process:
        return process.submit(_measured, level, px).result()


def _measured(level: int, px: int) -> dict[str, Any]:
    """Return CPU seconds of opening, and of images from places that differ; megabytes of the mesh."""
    sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))
    from support.judged_meshes import furnished

    fisheye = omniscv.cameras.create("fisheye-equidistant", width=px, height=px, fov_deg=185)
    panorama = omniscv.cameras.create("equirectangular", width=2 * px, height=px)
    with TemporaryDirectory() as folder:
        world = furnished(Path(folder), level)
        triangles = len(world.truth.corners)
        omniscv.open_source("scene://four-wall").close()
        before = _megabytes()
        started = time.process_time()
        with omniscv.open_source(world.address) as source:
            source.trace(np.zeros(3), np.array([[1.0, 0, 0]]))
            found = {"triangles": triangles, "opening": time.process_time() - started}
            found["MB"] = _megabytes() - before
            for name, camera in (("fisheye", fisheye), ("panorama", panorama)):
                for what, options in (("data", {}), ("4 colour rays", {"color_rays": 4})):
                    modes = ("lit", *DATA) if options else DATA
                    found[f"{name}, {what}"] = min(
                        _image(camera, source, modes, options, 0.1 * i) for i in range(_REPEATS)
                    )
    return found


def _image(camera: Any, source: Any, modes: tuple[str, ...], options: dict[str, Any], x: float) -> float:
    pose = omniscv.Pose.from_angles((x, 0.1, 1.4), yaw_deg=100 * x)
    started = time.process_time()
    omniscv.render(camera, pose, source, modes, **options)
    return time.process_time() - started


def _megabytes() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
