"""A world, a camera and its marks at every scale."""

from dataclasses import replace

import numpy as np
import pytest
from support.judged import Errors

import mock_server
import omniscv
from omniscv.cameras import create
from omniscv.geometry import Pose
from omniscv.sources.base import SourceWrapper

CAMERAS = {
    "ball": lambda s: create(
        "noncentral-spherical-mirror", 48, 48, mirror_radius=0.3 * s, distance=0.3 * s, fov_deg=280
    ),
    "ring": lambda s: create("noncentral-panorama", 48, 24, radius=0.5 * s),
    "panorama": lambda s: create("equirectangular", 128, 64),
}
CASES = [("ball", {"strategy": "exact"}), ("ring", {"viewpoints": 8, "accuracy": 0.1}), ("panorama", {})]
POSE = Pose.from_angles((0.1, 0.2, 1.5), yaw_deg=10, pitch_deg=5, roll_deg=-7)


class Scaled(SourceWrapper):
    """A source whose world is so many times larger."""

    def __init__(self, source, scale):
        super().__init__(source)
        self.scale = scale

    def capture(self, requests):
        requests = list(requests)
        inner = [replace(each, view=moved(each.view, 1 / self.scale)) for each in requests]
        for request, capture in zip(requests, self._source.capture(inner), strict=True):
            pixels = capture.pixels
            if request.mode == "depth":
                pixels = np.float32(pixels.astype(np.float64) * self.scale)
            yield replace(capture, request=request, view=moved(capture.view, self.scale), pixels=pixels)


def moved(view, scale):
    return replace(view, pose=Pose(view.pose.t_w_c * scale, view.pose.R_w_c))


def made(name, way, scale):
    """An image of the world at a scale, as it would be of the world as it is."""
    pose = Pose(POSE.t_w_c * scale, POSE.R_w_c)
    with omniscv.open_source("scene://six-wall?traces=0") as source:
        scaled, modes = Scaled(source, scale), ("object_mask", "depth")
        image = omniscv.render(CAMERAS[name](scale), pose, scaled, modes, face_size=128, **way)
    metres = {layer: image[layer] / np.float32(scale) for layer in ("depth", "depth_error")}
    return replace(image, camera=CAMERAS[name](1), pose=POSE, layers={**image.layers, **metres})


@pytest.mark.parametrize(("name", "way"), CASES)
def test_marks_are_the_same_at_every_scale(name, way):
    """Of a room of 7 mm, of 7 m and of 7 km."""
    least, image, most = (made(name, way, scale) for scale in (1e-3, 1.0, 1e3))
    scene = mock_server.load_scene("six-wall")
    for other in (least, most):
        assert abs(other.doubtful - image.doubtful) < 0.002
        assert abs(other.label_edge.sum() - image.label_edge.sum()) < 0.002 * image.valid.sum()
        assert Errors(other, scene).uncovered.sum() <= 1


def test_a_centre_a_micrometre_off_a_wall():
    x, (y, z) = -3.0 + 1e-6, np.random.default_rng(0).uniform((-1, 0.5), 2)
    camera, pose = CAMERAS["panorama"](1), Pose.from_angles((x, y, z), yaw_deg=40, pitch_deg=25)
    with omniscv.open_source("scene://six-wall?traces=0") as source:
        image = omniscv.render(camera, pose, source, ("object_mask", "depth"))
    assert not Errors(image, mock_server.load_scene("six-wall")).uncovered.any()
