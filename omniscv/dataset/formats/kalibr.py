"""Kalibr's ``camchain.yaml``: the cameras of a rig, each with its pose relative to the one before it.

Cameras with a constant pose relative to each other are a rig (:mod:`omniscv.dataset.sequences`). Each of
several rigs has a file, ``camchain-CAMERA.yaml`` by its first camera. The cameras are ``cam0``, ``cam1``, ...
in the order of their names, which ``rostopic`` holds. ``cam_overlaps`` lists the cameras that see some of the
same directions. :mod:`omniscv.calibration.kalibr` describes the other keys.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yaml

from omniscv.calibration.kalibr import KALIBR
from omniscv.cameras import Camera
from omniscv.cameras.rig import Rig
from omniscv.dataset.exporting import Format, register
from omniscv.dataset.sequences import rigs
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.records import NoOptions
from omniscv.storage.local import write_text

_SAMPLES = 33
"""Rows and columns of the pixels whose directions are compared."""


@register
class Kalibr(Format):
    """See the module."""

    name = "kalibr"

    def refuses(self, camera: Camera) -> str | None:
        try:
            KALIBR.values_of(camera)
        except ArgumentError as cause:
            return str(cause)
        return None

    def write(self, frames: Sequence[Frame], out: Path, options: NoOptions) -> list[Path]:
        chains = [of_frames.rig for of_frames in rigs(frames)]
        written = []
        for rig in chains:
            suffix = f"-{next(iter(rig.cameras))}" if len(chains) > 1 else ""
            written.append(write_text(out / f"camchain{suffix}.yaml", _chain(rig)))
        return written


def _chain(rig: Rig) -> str:
    numbered = {f"cam{i}": mounted for i, mounted in enumerate(rig.cameras.values())}
    chain = yaml.safe_load(KALIBR.write(numbered, rig=True))
    for camera_name, entry, mounted in zip(rig.cameras, chain.values(), numbered.values(), strict=True):
        sizes = mounted.camera.width, mounted.camera.height
        pixels = np.meshgrid(*(np.linspace(0, size, _SAMPLES) for size in sizes))
        rays = mounted.camera.unproject(np.stack(pixels, axis=-1))
        directions = rays.directions[rays.valid]  # of points far away
        entry["rostopic"], entry["cam_overlaps"] = f"/{camera_name}", []
        for i, other in enumerate(numbered.values()):
            R_other_camera = other.pose.rotation.T @ mounted.pose.rotation
            if other is not mounted and other.camera.project(directions @ R_other_camera.T)[1].any():
                entry["cam_overlaps"].append(i)
    return yaml.safe_dump(chain, sort_keys=False, default_flow_style=None)
