"""Stands in for two networks: predicts depth of panoramas from no more than how high the camera stands."""

import json
import math
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
HEIGHT_M = 1.5  # of the camera above the floor
CEILING_M = 1.2  # above the camera


def floor_and_walls(height: int, width: int, radius_m: float) -> np.ndarray:
    """Returns metres along rays: floor and ceiling, and a round wall around the camera."""
    latitude = (0.5 - (np.arange(height) + 0.5) / height) * math.pi
    wall = radius_m / np.cos(latitude)
    level = np.where(latitude < 0, HEIGHT_M, CEILING_M) / np.maximum(np.abs(np.sin(latitude)), 1e-6)
    return np.repeat(np.minimum(wall, level)[:, None], width, axis=1).astype(np.float32)


for description in sorted((HERE / "truth").glob("*.json")):
    camera = json.loads(description.read_text()).get("camera")
    if camera is None:
        continue
    for name, radius_m in (("small-room", 2.0), ("large-room", 4.0)):
        (HERE / name).mkdir(exist_ok=True)
        depth = floor_and_walls(camera["height"], camera["width"], radius_m)
        np.save(HERE / name / f"{description.stem}.npy", depth)
