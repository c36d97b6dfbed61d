"""Folders of images to look at, traced exactly: what a page shows of them is known."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

import mock_server
from omniscv import Pose, cameras
from omniscv.compose.files import write
from omniscv.sources.base import ObjectTable
from support.traced_frames import traced

CAMERAS = {
    "panorama": cameras.create("equirectangular", width=256, height=128),
    "fisheye": cameras.create("fisheye-equidistant", width=128, height=128, fov_deg=185),
    "mirror": cameras.create(
        "noncentral-spherical-mirror", width=128, height=128, mirror_radius=0.3, distance=0.3, fov_deg=200
    ),
}
POSE = Pose.from_angles((0.3, -0.2, 1.4), yaw_deg=25, pitch_deg=-8)


@dataclass
class Looked:
    scene: mock_server.Scene
    folder: Path

    def trace(self, camera, pixel):
        """The hit of the ray of a pixel's centre."""
        rays = camera.unproject(np.array([pixel]) + 0.5)
        return self.scene.trace(POSE.to_world(rays.origins), rays.directions @ POSE.R_w_c.T)


def images(folder, scene="four-wall"):
    scene = mock_server.load_scene(scene)
    objects = ObjectTable({name: (i, 0, 255 - i) for i, name in enumerate(scene.objects)})
    for stem, camera in CAMERAS.items():
        described = {"camera": camera.to_dict(), "pose": POSE.to_dict()}
        write(traced(scene, camera, POSE), described, objects, folder, stem)
    return Looked(scene, folder)
