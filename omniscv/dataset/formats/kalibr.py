"""Kalibr's ``camchain.yaml``: the cameras of a rig, each with its place after the one before it.

Cameras that keep their places to each other are a rig (:mod:`omniscv.dataset.sequences`); of several rigs
each has a file, ``camchain-CAMERA.yaml`` by its first camera. The cameras are ``cam0``, ``cam1``, ... in the
order of their names, which ``rostopic`` holds. ``cam_overlaps`` lists the cameras that see some of the same
directions. :mod:`omniscv.calibration.kalibr` describes the rest.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from omniscv.arguments import fields
from omniscv.calibration import rig_to_kalibr, write_kalibr
from omniscv.cameras import Camera
from omniscv.cameras.rig import Rig, RigCamera
from omniscv.dataset.sequences import rigs
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.geometry import Array
from omniscv.storage.local import whole_file

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
    out.mkdir(parents=True, exist_ok=True)
    found, written = rigs(frames), []
    for each in found:
        suffix = f"-{next(iter(each.rig.cameras))}" if len(found) > 1 else ""
        with whole_file(path := out / f"camchain{suffix}.yaml") as part:
            part.write_text(_chain(each.rig), encoding="utf-8")
        written.append(path)
    return written


def _chain(rig: Rig) -> str:
    numbered = {f"cam{i}": mounted for i, mounted in enumerate(rig.cameras.values())}
    chain = yaml.safe_load(rig_to_kalibr(Rig(numbered)))
    for camera_name, entry, mounted in zip(rig.cameras, chain.values(), numbered.values(), strict=True):
        others = [(i, each) for i, each in enumerate(numbered.values()) if each is not mounted]
        entry["rostopic"] = f"/{camera_name}"
        entry["cam_overlaps"] = [i for i, other in others if _overlap(mounted, other)]
    return yaml.safe_dump(chain, sort_keys=False, default_flow_style=None)


def _overlap(mounted: RigCamera, other: RigCamera) -> bool:
    """Whether a camera sees, far away, some of what another one does."""
    camera, R_other_camera = mounted.camera, other.pose.rotation.T @ mounted.pose.rotation
    u, v = np.meshgrid(np.linspace(0, camera.width, _SAMPLES), np.linspace(0, camera.height, _SAMPLES))
    rays = camera.unproject(np.stack([u, v], axis=-1))
    directions: Array = rays.directions[rays.valid] @ R_other_camera.T
    return bool(other.camera.project(directions)[1].any())
