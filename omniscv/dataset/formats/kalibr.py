"""Kalibr's ``camchain.yaml``: the cameras of a rig, each with its pose relative to the one before it.

Cameras with a constant pose relative to each other are a rig (:mod:`omniscv.dataset.sequences`). Each of
several rigs has a file, ``camchain-CAMERA.yaml`` by its first camera. The cameras are ``cam0``, ``cam1``, ...
in the order of their names, which ``rostopic`` holds. ``cam_overlaps`` lists the cameras that see some of the
same directions. :mod:`omniscv.calibration.kalibr` describes the other keys. A dataset with an IMU has one
chain, with each camera's pose on the IMU, ``T_cam_imu``; images are stamped with the time that they show, so
``timeshift_cam_imu`` is 0. Rolling shutters have their line delay.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yaml

from omniscv.calibration.forms import matrix_of_pose
from omniscv.calibration.kalibr import KALIBR
from omniscv.cameras import Camera
from omniscv.cameras.rig import Rig, RigCamera
from omniscv.dataset.exporting import Format, register
from omniscv.dataset.sequences import by_camera, rigs, timed
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
        if frames and frames[0].imu is not None and timed(frames):
            track, first = frames[0].imu, {name: mine[0] for name, mine in by_camera(frames).items()}
            on_imu = {name: RigCamera(frame.camera, track.on_body(frame)) for name, frame in first.items()}
            return [write_text(out / "camchain.yaml", _chain(Rig(on_imu), on_imu=True))]
        chains = [of_frames.rig for of_frames in rigs(frames)]
        written = []
        for rig in chains:
            suffix = f"-{next(iter(rig.cameras))}" if len(chains) > 1 else ""
            written.append(write_text(out / f"camchain{suffix}.yaml", _chain(rig)))
        return written


def _chain(rig: Rig, on_imu: bool = False) -> str:
    first = next(iter(rig.cameras)) if on_imu else None
    seen = rig.seen_from(first) if first is not None else rig
    chain = yaml.safe_load(
        KALIBR.write({f"cam{i}": mounted for i, mounted in enumerate(seen.cameras.values())}, rig=True)
    )
    numbered = {f"cam{i}": mounted for i, mounted in enumerate(rig.cameras.values())}
    for entry, mounted in zip(chain.values(), numbered.values(), strict=True):
        if on_imu:
            entry |= {"T_cam_imu": matrix_of_pose(mounted.pose.inverse()), "timeshift_cam_imu": 0.0}
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
