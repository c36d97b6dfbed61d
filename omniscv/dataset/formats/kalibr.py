"""Kalibr's ``camchain.yaml``: the cameras of a rig, each with its place after the one before it.

Cameras that keep their places to each other are a rig (:mod:`omniscv.dataset.rigs`); of several rigs each
has a file, ``camchain-CAMERA.yaml`` by its first camera. The cameras are ``cam0``, ``cam1``, ... in the order
of their names, which ``rostopic`` holds. ``T_cn_cnm1`` takes points, in metres, from the camera before to this
one; ``cam_overlaps`` lists the cameras that see some of the same directions. The models are those of
:mod:`omniscv.calibration.kalibr`.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from omniscv.arguments import fields
from omniscv.calibration import write_kalibr
from omniscv.cameras import Camera
from omniscv.compose.files import whole_file
from omniscv.dataset.frames import Frame
from omniscv.dataset.rigs import Rig, relative, rigs
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose

name = "kalibr"

_SAMPLES = 33
"""Rows and columns of the pixels whose directions are compared."""


def refuses(camera: Camera) -> str | None:
    """Return why Kalibr cannot carry a camera; None where it can."""
    try:
        write_kalibr({"cam0": camera})
    except ArgumentError as cause:
        return str(cause).removeprefix("cam0: ")
    return None


def check_options(options: Mapping[str, Any], cameras: Mapping[str, Camera]) -> None:
    """Raise ArgumentError for an option: there are none."""
    fields("", options, {})


def write(frames: Sequence[Frame], out: Path, options: Mapping[str, Any]) -> list[Path]:
    """Write the chains.

    Raises:
        ArgumentError: a camera that Kalibr cannot carry, or an option.
    """
    fields("", options, {})
    cameras = {frame.camera_name: frame.camera for frame in frames}
    out.mkdir(parents=True, exist_ok=True)
    found, written = rigs(frames), []
    for rig in found:
        suffix = f"-{next(iter(rig.sensors))}" if len(found) > 1 else ""
        with whole_file(path := out / f"camchain{suffix}.yaml") as part:
            part.write_text(_chain(rig, cameras), encoding="utf-8")
        written.append(path)
    return written


def _chain(rig: Rig, cameras: Mapping[str, Camera]) -> str:
    sensors = [(each, cameras[each], pose) for each, pose in rig.sensors.items()]
    chain = yaml.safe_load(write_kalibr({f"cam{i}": camera for i, (_, camera, _) in enumerate(sensors)}))
    for i, (camera_name, camera, pose) in enumerate(sensors):
        entry = chain[f"cam{i}"]
        entry["rostopic"] = f"/{camera_name}"
        others = [(j, other, place) for j, (_, other, place) in enumerate(sensors) if j != i]
        entry["cam_overlaps"] = [
            j for j, other, place in others if _overlap(camera, other, relative(place, pose).rotation)
        ]
        if i > 0:
            entry["T_cn_cnm1"] = _matrix(relative(pose, sensors[i - 1][2]))
    return yaml.safe_dump(chain, sort_keys=False, default_flow_style=None)


def _overlap(camera: Camera, other: Camera, R_other_camera: Array) -> bool:
    """Whether a camera sees, far away, some of what another one does."""
    u, v = np.meshgrid(np.linspace(0, camera.width, _SAMPLES), np.linspace(0, camera.height, _SAMPLES))
    rays = camera.unproject(np.stack([u, v], axis=-1))
    _, seen = other.project(rays.directions[rays.valid] @ R_other_camera.T)
    return bool(seen.any())


def _matrix(pose: Pose) -> list[list[float]]:
    rows = np.column_stack([pose.rotation, pose.position]) + 0.0
    return [*rows.tolist(), [0.0, 0.0, 0.0, 1.0]]
