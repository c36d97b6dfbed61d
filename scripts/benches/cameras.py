"""How long each camera model takes to unproject and to project 2048 x 1024 pixels.

Models in closed form are to unproject within 60 ms and to project within 400 ms; iterative ones within 150 ms
and 1200 ms. Processor time counts, the best of seven.
"""

import time
from collections.abc import Iterator

import numpy as np

from benches import Figure, Reference, best_ms
from omniscv import cameras
from omniscv.cameras import Camera

ITERATIVE = {"scaramuzza", "kannala-brandt", "fisheye624", "ftheta", "unified", "noncentral-spherical-mirror"}
CLOSED_MS, ITERATIVE_MS = (60, 400), (150, 1200)
DISTORTION = (-0.3, 0.1, 1e-3, -2e-3, -0.01, 0, 0, 0, 1e-3, 0, 0, 0)


def measure(quick: bool) -> Iterator[Figure]:
    width, turns = (32, 1) if quick else (2048, 7)
    for name, camera in models(width).items():
        points = points_of(camera)
        work = {"unproject": camera.unproject, "project": lambda c=camera, p=points: c.project(p)}
        took = best_ms(work, turns, time.process_time)
        bounds = ITERATIVE_MS if name in {*ITERATIVE, "pinhole, distorted"} else CLOSED_MS
        for (what, ms), bound in zip(took.items(), bounds, strict=True):
            title = f"{width} x {width // 2} pixels, processor time"
            yield Figure(title, f"{name}: {what}", "ms", ms, limit=Reference("goal", bound))


def models(width: int) -> dict[str, Camera]:
    """Return every model by name, and a pinhole that has to be solved."""
    size = {"width": width, "height": width // 2}
    found = {}
    for name in cameras.names():
        example = cameras.model(name).example(width // 2).to_dict()
        given = {key: value for key, value in example.items() if key not in ("center", "cx", "cy")}
        found[name] = cameras.from_dict({**given, **size})
    bent = {"fx": width / 2, "fy": width / 2, "distortion": DISTORTION}
    return {**found, "pinhole, distorted": cameras.create("pinhole", **size, **bent)}


def points_of(camera: Camera) -> np.ndarray:
    """Return 10 m along every ray; where there is none, some point, so that nothing is saved on it."""
    rays = camera.unproject()
    elsewhere = np.random.default_rng(0).normal(scale=10, size=rays.directions.shape)
    return np.where(rays.valid[..., None], rays.origins + 10 * rays.directions, elsewhere)
