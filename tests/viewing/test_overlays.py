"""Truth drawn over images: where it is, and nowhere else."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from support.rooms import L_SHAPE, room_of_plan

import omniscv
from omniscv import Pose, cameras, truth
from omniscv.errors import ArgumentError
from omniscv.truth import SphericalBox, project_layout
from omniscv.viewing.overlays import draw_boxes, draw_layout

WIDE = cameras.create("equirectangular", width=256, height=128)
GREY = np.full((128, 256, 3), 90, np.uint8)


def changed(camera, grey, records, what):
    drawn = draw_boxes(grey, camera, records, (what,))
    assert (grey == 90).all()
    return (drawn != grey).any(axis=-1)


def record(**fields):
    return {"instance_id": 3, "name": "", **fields}


def test_a_box_over_the_seam_is_drawn_on_both_sides():
    at = changed(WIDE, GREY, {"boxes": [record(bbox=[0, 40, 256, 30], bbox_wrap=[240, 40, 40, 30])]}, "boxes")
    rows, columns = np.nonzero(at)
    assert 38 <= rows.min() < rows.max() <= 71
    assert set(columns) <= {*range(238, 256), *range(26)}
    assert at[55, 239:242].any()
    assert at[55, 22:26].any()
    assert not at[55, 26:238].any()


@pytest.mark.parametrize("name", ["equirectangular", "kannala-brandt"])
def test_boxes_on_the_sphere_are_drawn_on_their_border(name):
    """Each pixel that is drawn sees, within a pixel or two, the border of the box."""
    camera = cameras.model(name).example(200)
    grey = np.full((camera.height, camera.width, 3), 90, np.uint8)
    box = SphericalBox(10, 5, 40, 24, 15)
    at = changed(camera, grey, {"bfov": [record(bfov=box.to_dict(), rbfov=box.to_dict())]}, "rbfov")
    rays = camera.unproject()
    assert at.sum() > 50
    assert not at[~rays.valid].any()
    across = np.degrees(np.linalg.norm(np.diff(rays.directions, axis=1), axis=-1))
    assert np.abs(box.contains(rays.directions[at])).max() <= 2.5 * np.nanmax(across)


@pytest.mark.parametrize("name", ["equirectangular", "noncentral-panorama"])
def test_boxes_in_space_are_drawn_along_their_edges(name):
    camera, pose = cameras.model(name).example(200), omniscv.Pose.from_angles((0, 0, 1.5))
    with omniscv.open_source("scene://four-wall") as source:
        boxes = {"Sofa": source.geometry().boxes["Sofa"], "Table": source.geometry().boxes["Table"]}
    records = truth.boxes3d(boxes, camera, pose, {"Sofa": 1, "Table": 2})
    grey = np.full((camera.height, camera.width, 3), 90, np.uint8)
    at = changed(camera, grey, {"boxes3d": [{**each, "name": ""} for each in records]}, "boxes3d")
    seen = 0
    for box in boxes.values():
        pixels, valid = camera.project(pose.to_camera(box.corners_w()))
        for u, v in pixels[valid]:
            around = at[max(0, int(v) - 1) : int(v) + 2, max(0, int(u) - 1) : int(u) + 2]
            assert around.any()
            seen += 1
    assert seen >= 8
    assert at.mean() < 0.1


def test_names_and_colours_tell_objects_apart():
    two = [record(bbox=[10, 40, 30, 30]), {"instance_id": 4, "name": "Sofa", "bbox": [100, 40, 30, 30]}]
    drawn = draw_boxes(GREY, WIDE, {"boxes": two})
    assert not np.array_equal(drawn[55, 10], drawn[55, 100])
    assert (drawn[20:38, 100:130] != 90).any()
    with pytest.raises(ArgumentError, match="what: expected one of boxes, bfov, rbfov, boxes3d; got 'masks'"):
        draw_boxes(GREY, WIDE, {}, ("masks",))


@pytest.mark.parametrize("name", ["equirectangular", "noncentral-spherical-mirror"])
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
