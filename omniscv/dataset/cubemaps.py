"""Panoramas as six perspective pictures, for programs that have no equirectangular camera."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from omniscv.cameras import Equirectangular, Pinhole
from omniscv.compose.files import write_picture
from omniscv.frame import Frame
from omniscv.geometry import R_LEVEL, Pose, cube_rotations
from omniscv.modalities import get


def faces(frame: Frame, folder: Path) -> Iterator[Frame]:
    """Yield the faces of an equirectangular frame: front, right, back, left, up, down.

    A face spans 90 degrees, with as many pixels a degree in its middle as the panorama has at the horizon.
    Its colours are sampled by cubic interpolation. Camera and key get the face's name: ``CAMERA-front``.

    Args:
        frame: with colours.
        folder: where the pictures are written, as ``CAMERA-FACE/KEY.png``.
    """
    import cv2  # slow to load

    panorama = frame.camera
    assert isinstance(panorama, Equirectangular)
    size = math.ceil(panorama.width / math.pi)
    camera = Pinhole(size, size, fov_deg=90.0)
    rays = camera.unproject().directions
    lit, margin = frame.layer("lit"), 4
    wide = cv2.copyMakeBorder(lit, 0, 0, margin, margin, cv2.BORDER_WRAP)
    for face, R_w_f in cube_rotations():
        R_c_f = R_LEVEL.T @ R_w_f
        pixels, _ = panorama.project(rays @ R_c_f.T)
        place = (pixels - 0.5 + [margin, 0]).astype(np.float32)
        colors = cv2.remap(wide, place, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        camera_name = f"{frame.camera_name}-{face}"
        path = folder / camera_name / f"{camera_name}{frame.key.removeprefix(frame.camera_name)}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_picture(path, colors, get("lit"))
        turned = Pose(frame.pose.position, frame.pose.rotation @ R_c_f)
        yield replace(
            frame, key=path.stem, camera_name=camera_name, camera=camera, pose=turned, files={"lit": path}
        )
