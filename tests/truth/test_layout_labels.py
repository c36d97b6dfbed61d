"""Corners of upright panoramas and maps of edges, and what papers measure on them, judged by shapely."""

import numpy as np
import pytest
import shapely
from scipy import ndimage
from support.rooms import L_SHAPE, PLAIN, T_SHAPE, U_SHAPE, room_of_plan

from omniscv import Pose, cameras
from omniscv.errors import ArgumentError
from omniscv.score.layouts import layout_scores
from omniscv.truth import project_layout
from omniscv.truth.layout_labels import CAMERA_HEIGHT_M, cor_id, exact_maps, original_maps, room_seen

PANORAMA = cameras.create("equirectangular", 1024, 512)
SMALL = cameras.create("equirectangular", 256, 128)

PLACES = [
    (PLAIN, (0.5, -1, 1.5)),
    (L_SHAPE, (0.5, -0.5, 1.4)),
    (T_SHAPE, (3, 1, 1.2)),
    (U_SHAPE, (2, 2, 1.7)),
]


def seen_from(plan, position, camera=PANORAMA, yaw_deg=0.0, height=2.8):
    return cor_id(room_of_plan(plan, height), camera, Pose.from_angles(position, yaw_deg=yaw_deg))


def plan_of(corners, width, height, camera_height):
    """(N, 2) right and ahead, metres: the formulas of HorizonNet's reader, written out."""
    floor = corners[1::2]
    theta = ((floor[:, 0] + 0.5) / width - 0.5) * 2 * np.pi
    down = ((floor[:, 1] + 0.5) / height - 0.5) * np.pi
    away = camera_height / np.tan(down)
    return np.column_stack([away * np.sin(theta), away * np.cos(theta)])


@pytest.mark.parametrize(("plan", "position"), PLACES)
@pytest.mark.parametrize("yaw_deg", [0, -140])
def test_corners_give_back_the_plan_clockwise_with_those_that_walls_hide(plan, position, yaw_deg):
    corners = seen_from(plan, position, yaw_deg=yaw_deg)
    assert np.array_equal(corners[0::2, 0], corners[1::2, 0])
    assert (corners[0::2, 1] < corners[1::2, 1]).all()
    assert corners[:, 0].argmin() < 2
    found = plan_of(corners, 1024, 512, position[2])
    assert not shapely.LinearRing(found).is_ccw
    turn = np.radians(yaw_deg)
    ahead = np.array([np.cos(turn), np.sin(turn)])
    left = np.array([-np.sin(turn), np.cos(turn)])
    world = np.array(position[:2]) + found[:, 1:] * ahead - found[:, :1] * left
    expected = np.array(plan, float)
    away = np.linalg.norm(world[:, None] - expected, axis=-1)
    assert away.min(axis=0).max() <= 1e-9
    assert len(world) == len(plan)
    assert shapely.Polygon(world).symmetric_difference(shapely.Polygon(expected)).area <= 1e-9


def test_the_room_that_corners_describe_is_scaled_to_the_usual_height_and_wrong_ones_are_refused():
    corners = seen_from(PLAIN, (0, 0, 1.5))
    room = room_seen(corners, 1024, 512)
    assert room.floor_z == -CAMERA_HEIGHT_M
    assert room.ceiling_z == pytest.approx(1.3 * CAMERA_HEIGHT_M / 1.5)
    assert sorted(np.abs(room.corners_w).ravel()) == pytest.approx([2 * 1.6 / 1.5] * 4 + [3 * 1.6 / 1.5] * 4)
    assert shapely.LinearRing(room.corners_w).is_ccw
    pairs = corners.reshape(-1, 2, 2)
    for wrong, says in (
        (corners[1:], "expected at least 3 pairs"),
        (pairs[:, ::-1], "ceilings above the horizon"),
        (pairs[[0, 2, 1, 3]], "does not cross itself"),
    ):
        with pytest.raises(ArgumentError, match=says):
            layout_scores(wrong.reshape(-1, 2), corners)


def test_scores_of_another_room_are_those_of_hand_calculation():
    """A room 4 m by 6 m taken for one of 4 m by 5 m and half a metre less high, the camera at 1.6 m."""
    truth = seen_from(PLAIN, (0, 0, 1.6), SMALL)
    found = seen_from([[-2, -2.5], [2, -2.5], [2, 2.5], [-2, 2.5]], (0, 0, 1.6), SMALL, height=2.3)
    scores = layout_scores(found, truth, 256, 128)
    assert scores.iou_2d == pytest.approx(20 / 24)
    assert scores.iou_3d == pytest.approx(20 * 2.3 / (24 * 2.8))
    error = 100 * np.linalg.norm(found - truth, axis=1).mean() / np.hypot(256, 128)
    assert scores.corner_error == pytest.approx(error)
    depths, kinds = zip(*(by_columns(corners, 256, 128) for corners in (found, truth)), strict=True)
    ratio = depths[0] / depths[1]
    assert scores.rmse_m == pytest.approx(np.sqrt(((depths[0] - depths[1]) ** 2).mean()), rel=1e-9)
    assert scores.delta_1 == pytest.approx((np.maximum(ratio, 1 / ratio) < 1.25).mean())
    assert scores.pixel_error == pytest.approx(100 * (kinds[0] != kinds[1]).mean())
    fewer = seen_from([[-2, -3], [2, -3], [-2, 3]], (-0.5, -0.5, 1.6), SMALL)
    assert layout_scores(fewer, truth, 256, 128).corner_error is None


def by_columns(corners, width, height):
    """Depth and kind of pixels from each column's wall, as HorizonNet's evaluation goes; convex rooms."""
    wall = shapely.Polygon(plan_of(corners, width, height, 1.6)).exterior
    columns, rows = np.arange(width), np.arange(height)
    theta = ((columns + 0.5) / width - 0.5) * 2 * np.pi
    v = ((rows + 0.5) / height - 0.5) * np.pi
    rays = [shapely.LineString([(0, 0), (99 * np.sin(t), 99 * np.cos(t))]) for t in theta]
    away = np.array([wall.intersection(ray) for ray in rays])
    away = shapely.length(shapely.shortest_line(away, shapely.Point(0, 0)))
    up = np.tan(((corners[0::2, 1] + 0.5) / height - 0.5) * np.pi)
    down = np.tan(((corners[1::2, 1] + 0.5) / height - 0.5) * np.pi)
    ceiling = -1.6 * (up / down).mean()
    floor_row = np.arctan(1.6 / away)
    ceiling_row = -np.arctan(ceiling / away)
    v = np.repeat(v[:, None], width, axis=1)
    kind = np.where(v > floor_row, 1, np.where(v < ceiling_row, 2, 0))
    depth = np.where(kind == 1, 1.6 / np.sin(v), np.where(kind == 2, -ceiling / np.sin(v), away / np.cos(v)))
    return depth, kind


def test_other_cameras_and_positions_are_refused():
    fisheye = cameras.model("fisheye-equidistant").example()
    inside = (0, 0, 1.5)
    for camera, pose, says in (
        (fisheye, (inside,), "expected an upright equirectangular panorama, got fisheye"),
        (SMALL, (inside, 0, 3, -2), "got pitch 3 and roll -2 degrees"),
        (SMALL, ((0, 0, 2.9),), "a camera within the room"),
        (SMALL, ((0, 3.1, 1.5),), "a camera within the room"),
    ):
        with pytest.raises(ArgumentError, match=says):
            cor_id(room_of_plan(PLAIN), camera, Pose.from_angles(*pose))


HALF = cameras.create("equirectangular", 512, 256)


def record_of(plan=PLAIN, camera=HALF, **angles):
    pose = Pose.from_angles((0, 0, 1.5), **angles)
    return project_layout(room_of_plan(plan), camera, pose), pose


def test_shares_of_the_known_room_are_those_of_the_reference():
    record, _ = record_of()
    edges, corners = exact_maps(record, HALF)
    for picture, shares in ((edges, (0.1585, 0.1134)), (corners, (0.0532, 0.0265))):
        assert picture.max() >= 250
        found = [(picture / 255 >= 0.01).mean(), (picture / 255 > 0.1).mean()]
        assert found == pytest.approx(shares, abs=0.002)
    with pytest.raises(ArgumentError, match="expected a record of a layout"):
        exact_maps({}, HALF)


def test_maps_turn_with_the_panorama():
    maps = exact_maps(record_of(L_SHAPE)[0], HALF)
    turned = exact_maps(record_of(L_SHAPE, yaw_deg=360 * 389 / 512)[0], HALF)
    for before, after in zip(maps, turned, strict=True):
        assert np.abs(np.roll(before, 389, axis=1).astype(int) - after).max() <= 1


def test_blobs_are_centred_on_the_corners_over_the_seam_too():
    """One corner is half a column from the seam, one is on it."""
    at_seam_deg = 180 - np.degrees(np.arctan2(3, 2))
    for yaw_deg in (at_seam_deg, at_seam_deg + 0.35):
        record, _ = record_of(yaw_deg=-yaw_deg)
        _, picture = exact_maps(record, HALF)
        for corner in record["corners"]:
            u, v = corner["pixel"]
            centred = np.roll(picture, 256 - int(u), axis=1)
            blob = ndimage.label(centred > 30)[0]
            mine = np.where(blob == blob[min(int(v), 255), 256], centred, 0)
            row, column = ndimage.center_of_mass(mine)
            assert (column + 0.5, row + 0.5) == pytest.approx((256 + u - int(u), v), abs=0.5)


@pytest.mark.parametrize("name", ["equirectangular", "pinhole", "noncentral-conical-mirror", "push-broom"])
def test_blobs_have_the_width_of_the_pixels_at_the_middle(name):
    """A share of the pixels of a full turn there, beside a cone's tip too: of rays a pixel apart."""
    camera = cameras.model(name).example(128)
    beside = camera.unproject(camera.center + np.array([[0.5, 0.0], [1.5, 0.0]]))
    between = np.arccos(np.clip(beside.directions[0] @ beside.directions[1], -1, 1))
    turn = 2 * np.pi / between if between else camera.width  # parallel rays have no turn
    corner = {"pixel": [40.5, camera.height * 0.5 + 0.5], "in_image": True, "visible_room": True}
    _, drawn = exact_maps({"edges": [], "corners": [corner]}, camera, corner_sigma=3 / turn)
    row = camera.height // 2
    expected = 255 * np.exp(-0.5 * (np.arange(4) / 3) ** 2)
    assert drawn[row, 40:44] == pytest.approx(expected, rel=0.03)


def test_the_original_recipe_has_no_seam():
    panorama = cameras.create("equirectangular", 256, 128)
    record, pose = record_of(L_SHAPE, panorama)
    original = original_maps(record, panorama, pose)
    record, pose = record_of(L_SHAPE, panorama, yaw_deg=90)
    turned = original_maps(record, panorama, pose)
    for before, after in zip(original, turned, strict=True):
        assert np.abs(np.roll(before, 64, axis=1).astype(int) - after).max() <= 1
    camera = cameras.model("fisheye-equidistant").example(64)
    record = project_layout(room_of_plan(PLAIN), camera, pose)
    with pytest.raises(ArgumentError, match="an image that fills its rectangle"):
        original_maps(record, camera, pose)
