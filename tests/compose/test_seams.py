"""No seam: at the edges and corners of the cube the image is as good as in the middle of its faces."""

import numpy as np
import pytest
from support.exact import FIXED, float_source

import omniscv
from mock_server import load_scene
from omniscv.cameras import create
from omniscv.geometry import Pose

WAVES = load_scene("waves")
POSE = Pose.from_angles((0, 0, 0), yaw_deg=15.0, pitch_deg=20.0, roll_deg=10.0)
CAMERAS = {
    "equirectangular": create("equirectangular", width=1024, height=512),
    "fisheye-equidistant": create("fisheye-equidistant", width=512, height=512, fov_deg=240),
    "cylindrical": create("cylindrical", width=1024, height=512, fov_h_deg=360, fov_v_deg=150),
}
SOURCES = {"overscan": float_source(WAVES), "fixed 90 degrees": float_source(WAVES, FIXED)}


PAIRS = [
    (name, kind, ("bilinear", "bicubic")[(i + j) % 2])
    for i, name in enumerate(CAMERAS)
    for j, kind in enumerate(SOURCES)
]


@pytest.mark.parametrize(("name", "kind", "filter"), PAIRS)
def test_edges_and_corners_are_as_good_as_the_middle(name, kind, filter):
    camera = CAMERAS[name]
    image = omniscv.render(camera, POSE, SOURCES[kind], filter=filter, face_size=512)
    rays_w = camera.unproject().directions @ POSE.R_w_c.T
    error = np.abs(image.lit - WAVES.trace((0, 0, 0), rays_w).color).max(axis=-1)
    # Distance from the nearest edge of the cube, in px of the face, along the face.
    axes = np.sort(np.abs(rays_w), axis=-1)
    edge_px = (1 - axes[..., 1] / axes[..., 2]) * 256
    corner_px = (1 - axes[..., 0] / axes[..., 2]) * 256
    valid = image.valid
    near_edge, near_corner = valid & (edge_px < 2), valid & (corner_px < 2) & (edge_px < 2)
    inside = valid & (edge_px > 2)
    assert near_edge.sum() > 500
    assert near_corner.sum() > 0
    # A wave is shortest, in px of the face, at the face's middle, where its own plane is crossed head on.
    assert error[near_edge].max() <= error[inside].max()
    assert error[near_corner].max() <= error[inside].max()
    assert np.sqrt((error[near_edge] ** 2).mean()) <= np.sqrt((error[inside] ** 2).mean())
