"""The lines of boxes in images: where the boxes are, whatever the camera."""

import numpy as np
import pytest

import omniscv
from omniscv import cameras, truth
from omniscv.viewing.look.layers import box_lines

WIDE = cameras.create("equirectangular", width=256, height=128)


def points(kind, camera, record):
    lines = np.concatenate(box_lines(kind, camera, record))
    return lines[np.isfinite(lines).all(axis=1)]


def test_a_box_over_the_seam_continues_at_the_left():
    u, v = points("boxes", WIDE, {"bbox": [0, 40, 256, 30], "bbox_wrap": [240, 40, 40, 30]}).T
    assert (v.min(), v.max()) == (40, 70)
    assert ((u >= 240) | (u <= 24)).all()
    assert {240, 24} <= set(u)


@pytest.mark.parametrize("name", ["equirectangular", "noncentral-panorama"])
def test_lines_of_a_box_in_space_end_at_its_corners(name):
    camera, pose = cameras.model(name).example(200), omniscv.Pose.from_angles((0, 0, 1.5))
    with omniscv.open_source("scene://four-wall") as source:
        boxes = {"Sofa": source.geometry().boxes["Sofa"], "Table": source.geometry().boxes["Table"]}
    seen = 0
    for record in truth.boxes3d(boxes, camera, pose, {"Sofa": 1, "Table": 2}):
        lines = points("boxes3d", camera, record)
        pixels, valid = camera.project(pose.to_camera(boxes[record["name"]].corners_w()))
        for pixel in pixels[valid]:
            assert np.abs(lines - pixel).max(axis=1).min() < 1e-6
            seen += 1
    assert seen >= 8
