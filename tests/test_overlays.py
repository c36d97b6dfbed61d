"""Layouts drawn over images."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from support.rooms import L_SHAPE, room_of_plan

from omniscv import Pose, cameras
from omniscv.errors import ArgumentError
from omniscv.truth import project_layout
from omniscv.viewing.overlays import draw_layout


@pytest.mark.parametrize("name", ["equirectangular", "fisheye-equidistant", "noncentral-spherical-mirror"])
def test_every_visible_curve_is_drawn_in_its_colour_and_nothing_else_is(name):
    camera = cameras.model(name).example(256)
    record = project_layout(room_of_plan(L_SHAPE), camera, Pose.from_angles((3, -1.5, 1.4)))
    picture = np.full((camera.height, camera.width, 3), 7, np.uint8)
    drawn = draw_layout(picture, record)
    assert (picture == 7).all()
    changed = (drawn != 7).any(axis=-1)
    every = np.concatenate([piece["pixels"] for edge in record["edges"] for piece in edge["pieces"]])
    column, row = np.minimum(every.astype(int), [camera.width - 1, camera.height - 1]).T
    assert changed[row, column].all()
    rows, columns = np.nonzero(changed)
    away, _ = cKDTree(every).query(np.c_[columns, rows] + 0.5)
    assert away.max() < 6  # a corner's ring
    bright = {"floor": 0, "vertical": 1, "ceiling": 2}  # red, green, blue
    for edge in record["edges"]:
        for piece in edge["pieces"]:
            if piece["visible_room"] and len(piece["pixels"]) > 60:
                u, v = piece["pixels"][len(piece["pixels"]) // 2]
                shade = drawn[int(v), min(int(u), camera.width - 1)]
                assert shade.argmax() == bright[edge["kind"]]


def test_only_colour_pictures_are_drawn_on():
    record = project_layout(
        room_of_plan(L_SHAPE), cameras.model("pinhole").example(64), Pose.from_angles((0, 0, 1))
    )
    with pytest.raises(ArgumentError, match=r"picture: expected \(H, W, 3\) uint8, got float64"):
        draw_layout(np.zeros((64, 64, 3)), record)
