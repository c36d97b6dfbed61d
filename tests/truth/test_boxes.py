"""Boxes in space, against the scene's own bounds; boxes on the sphere, in every camera."""

from dataclasses import replace

import numpy as np
import pytest
from support.observed import observed
from support.rooms import FAMILIES

import mock_server
import omniscv
from omniscv import cameras, truth
from omniscv.dataset import truths
from omniscv.errors import ArgumentError
from omniscv.geometry.scene_geometry import ObjectBox
from omniscv.truth import SphericalBox

POSE = omniscv.Pose.from_angles((0.2, -0.1, 1.5), yaw_deg=30, pitch_deg=-10, roll_deg=5)
SCENE = mock_server.load_scene("four-wall")
CORNERS = [(-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1), (-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)]
CAMERAS = {
    "equirectangular": cameras.create("equirectangular", width=512, height=256),
    "kannala-brandt": cameras.model("kannala-brandt").example(256),
    "panorama on a circle": cameras.create("noncentral-panorama", width=512, height=256, radius=0.3),
}


def records(camera, pose=POSE):
    with omniscv.open_source("scene://four-wall") as source:
        boxes = source.geometry().boxes
    return boxes, truth.boxes3d(boxes, camera, pose, {name: SCENE.label(name) for name in SCENE.objects})


def test_boxes_are_the_scenes_bounds():
    boxes, found = records(CAMERAS["equirectangular"])
    assert [record["name"] for record in found] == list(SCENE.objects)
    for record in found:
        low, high = SCENE.bounds(record["name"])
        R_w_b = np.array(record["R_world_box"])
        half = np.array(record["size"]) / 2
        if np.isin(np.abs(R_w_b), (0, 1)).all():  # along the world's axes
            assert record["center_world"] - np.abs(R_w_b @ half) == pytest.approx(low, abs=1e-6)
            assert record["center_world"] + np.abs(R_w_b @ half) == pytest.approx(high, abs=1e-6)
        else:
            assert record["name"] in ("Chair_1", "Chair_2")
        assert np.array_equal(boxes[record["name"]].R_w_b, R_w_b)
        away = np.array(record["center_world"]) - POSE.position
        assert record["distance"] == pytest.approx(np.linalg.norm(away))
        assert record["source"] == "scene"
        assert "partial" not in record
        assert record["truncated"] == 0.0  # a whole panorama


@pytest.mark.parametrize("name", CAMERAS)
def test_corners_in_the_cameras_frame_have_the_pixels_of_the_worlds(name):
    camera = CAMERAS[name]
    for record in records(camera)[1]:
        corner = np.array(CORNERS) * np.array(record["size"]) / 2
        world = np.array(record["center_world"]) + corner @ np.array(record["R_world_box"]).T
        own = np.array(record["center_camera"]) + corner @ np.array(record["R_camera_box"]).T
        (a, seen) = camera.project(POSE.to_camera(world))
        (b, again) = camera.project(own)
        assert np.array_equal(seen, again)
        assert np.abs(a - b)[seen].max(initial=0) <= 1e-6


def test_truncated_is_the_share_outside_the_image():
    camera = cameras.create("pinhole", width=80, height=60, fov_deg=70)
    rng = np.random.default_rng(3)
    for _ in range(8):
        center = rng.uniform([1.5, -2, -1.5], [4, 2, 1.5])
        box = ObjectBox(center, np.eye(3), rng.uniform(0.3, 2, 3), "scene")
        points = rng.uniform(-0.5, 0.5, (60_000, 3))
        sides = rng.integers(0, 3, len(points))
        points[np.arange(len(points)), sides] = rng.choice([-0.5, 0.5], len(points))
        area = np.prod(box.size) / box.size[sides]
        x, y, z = omniscv.Pose.from_angles((0, 0, 0)).to_camera(center + points * box.size).T
        u, v = camera.focal * x / z, camera.focal * y / z
        outside = (z <= 0) | (np.abs(u) > 40) | (np.abs(v) > 30)
        wanted = (outside * area).sum() / area.sum()
        (found,) = truth.boxes3d({"Box": box}, camera, omniscv.Pose.from_angles((0, 0, 0)), ["Box"])
        assert found["truncated"] == pytest.approx(wanted, abs=0.06)


@pytest.mark.parametrize("source", ["mock://four-wall?dialect=0.3.10&size=192x192", "mock://four-wall"])
def test_the_truth_of_a_frame_has_a_box_for_every_object_that_is_seen(source):
    """From vertices, or, where the plugin has none, around points that are seen, which are in the object."""
    camera = cameras.create("equirectangular", width=192, height=96)
    options = {} if "0.3.10" in source else {"face_size": 96}
    with omniscv.open_source(source) as opened:
        seen_frame = observed(opened, camera, omniscv.Pose.from_angles((0, 0, 1.5)), **options)
    found = truths.get("boxes3d").apply(seen_frame, {})
    seen = set(np.unique(seen_frame.image.labels)) - {0}
    by_points = "0.3.10" in source
    assert {record["instance_id"] for record in found} <= seen
    assert len(found) >= len(seen) - 1
    for record in found:
        assert record["source"] == ("points" if by_points else "vertices")
        assert record.get("partial", False) == by_points
        low, high = SCENE.bounds(record["name"])
        corner = np.array(CORNERS) * np.array(record["size"]) / 2
        world = np.array(record["center_world"]) + corner @ np.array(record["R_world_box"]).T
        if by_points:
            assert (world >= low - 0.03).all()
            assert (world <= high + 0.03).all()
        else:
            assert (world.min(axis=0) <= low + 0.01).all()
            assert (world.max(axis=0) >= high - 0.01).all()


def lattice(count=100_000):
    """Directions, each for an equal part of the sphere: a Fibonacci lattice."""
    i = np.arange(count) + 0.5
    z = 1 - 2 * i / count
    turn = np.pi * (1 + np.sqrt(5)) * i
    r = np.sqrt(1 - z**2)
    return np.column_stack([r * np.cos(turn), r * np.sin(turn), z])


LATTICE = lattice()


def test_known_areas_and_overlaps_as_in_a_plane():
    for fov, steradians in (((60, 40), 0.6874190053), ((60, 60), 1.0107210206), ((90, 90), 4 * np.pi / 6)):
        assert SphericalBox(20, -35, *fov, 12).area == pytest.approx(steradians, abs=1e-9)
    beside = truth.fov_iou(SphericalBox(0, 40, 40, 40), SphericalBox(20, 40, 40, 40))
    assert beside == pytest.approx(0.4461083624, abs=1e-9)
    assert truth.fov_iou(SphericalBox(175, 0, 40, 40), SphericalBox(-175, 0, 40, 40)) == pytest.approx(0.6)
    assert truth.fov_iou(SphericalBox(0, 0, 40, 40), SphericalBox(90, 0, 40, 40)) == 0
    wide = SphericalBox(0, 0, 360, 90, kind="lonlat")
    for iou in (truth.spherical_iou, truth.fov_iou):
        with pytest.raises(ArgumentError, match="b2: expected a box of kind perspective"):
            iou(SphericalBox(0, 0, 40, 40), wide)


PAIRS = [
    (SphericalBox(0, 0, 60, 40), SphericalBox(0, 0, 60, 60)),
    (SphericalBox(0, 0, 40, 40), SphericalBox(180, 0, 40, 40)),
    (SphericalBox(0, 0, 40, 40), SphericalBox(45, 0, 40, 40)),
    (SphericalBox(0, 40, 40, 40), SphericalBox(20, 40, 40, 40)),
    (SphericalBox(175, 0, 40, 40), SphericalBox(-175, 0, 40, 40)),
    (SphericalBox(10, 70, 50, 30, 25), SphericalBox(30, 80, 60, 20, -10)),
    (SphericalBox(-60, -85, 150, 100, 40), SphericalBox(120, -70, 90, 140, -70)),
    (SphericalBox(0, 0, 20, 20), SphericalBox(0, 0, 90, 80, 45)),
]


@pytest.mark.parametrize(("a", "b"), PAIRS)
def test_areas_and_overlaps_agree_with_a_lattice(a, b):
    in_a, in_b = (box.contains(LATTICE) >= 0 for box in (a, b))
    assert 4 * np.pi * in_a.mean() == pytest.approx(a.area, rel=6e-3)
    wanted = (in_a & in_b).sum() / (in_a | in_b).sum()
    assert truth.spherical_iou(a, b) == pytest.approx(wanted, abs=3e-3)
    assert truth.spherical_iou(b, a) == pytest.approx(truth.spherical_iou(a, b), abs=1e-12)
    assert truth.spherical_iou(a.to_dict(), b) == truth.spherical_iou(a, b)
    assert truth.spherical_iou(a, a) == pytest.approx(1, abs=1e-12)
    east = [replace(each, lon=(each.lon + 137) % 360) for each in (a, b)]
    assert truth.spherical_iou(*east) == pytest.approx(truth.spherical_iou(a, b), abs=1e-12)


RADIUS = 0.5
DISTANCE = 2.4
BALL_DEG = 2 * np.degrees(np.arcsin(RADIUS / DISTANCE))


def ball_at(direction_w):
    place = (DISTANCE * np.asarray(direction_w)).tolist()
    return mock_server.Scene("ball", {"objects": {"Ball": {"solids": [{"sphere": RADIUS, "at": place}]}}})


def seen(camera, scene, pose):
    """The mask of what the pixels' rays meet, and these rays."""
    rays = camera.unproject()
    hits = scene.trace(pose.to_world(rays.origins), rays.directions @ pose.R_w_c.T)
    return (hits.label > 0) & rays.valid, rays


def inside_enough(record, mask, rays, pixel_deg):
    """Every pixel is within half a pixel of the box, and all but a thousandth of the mask in it."""
    margin = SphericalBox.of(record).contains(rays.directions[mask])
    assert margin.min() >= -0.5 * pixel_deg
    assert (margin >= 0).mean() >= 0.999


FULL = cameras.create("equirectangular", width=360, height=180)
FISHEYE = cameras.create("fisheye-equidistant", width=200, height=200, fov_deg=200)
PIXEL_DEG = 1.0  # of both
TURNS = {
    FULL: [(171, 0, 0), (-95, 38, 10), (30, 89.9, 0), (180, 0, 45)],
    FISHEYE: [(0, 0, 0), (60, -77, 150)],
}
FINE = cameras.create("equirectangular", width=720, height=360)


@pytest.mark.parametrize(("camera", "turn"), [(camera, turn) for camera in TURNS for turn in TURNS[camera]])
def test_a_ball_has_its_angle_whatever_the_camera_looks_at(camera, turn):
    yaw, pitch, roll = turn
    pose = omniscv.Pose.from_angles((0, 0, 0), yaw_deg=yaw, pitch_deg=pitch, roll_deg=roll)
    mask, rays = seen(camera, ball_at((1, 0, 0)), pose)
    record = truth.bfov(mask, rays)
    assert record["kind"] == "perspective"
    assert record["fov_h"] == pytest.approx(BALL_DEG, abs=PIXEL_DEG)
    assert record["fov_v"] == pytest.approx(BALL_DEG, abs=PIXEL_DEG)
    x, y, z = pose.to_camera([1.0, 0.0, 0.0])
    assert np.sin(np.radians(record["lat"])) == pytest.approx(-y, abs=0.01)
    across = np.radians(record["lon"]) - np.arctan2(x, z)
    assert np.hypot(x, z) * np.sin(across) == pytest.approx(0, abs=0.01)
    inside_enough(record, mask, rays, PIXEL_DEG)
    rotated = truth.bfov(mask, rays, rotated=True)
    inside_enough(rotated, mask, rays, PIXEL_DEG)
    assert SphericalBox.of(rotated).area <= SphericalBox.of(record).area


@pytest.mark.parametrize("name", FAMILIES)
def test_every_camera_has_boxes_around_its_pixels(name):
    """A ball that a pixel a third across sees; of mirrors too, whose rays start all over."""
    camera = cameras.model(name).example(96)
    rays = camera.unproject([camera.width * 0.37, camera.height * 0.4])
    place = (rays.origins + DISTANCE * rays.directions).tolist()
    scene = mock_server.Scene("ball", {"objects": {"Ball": {"solids": [{"sphere": 0.4, "at": place}]}}})
    mask, rays = seen(camera, scene, omniscv.Pose((0, 0, 0), np.eye(3)))
    assert mask.any()
    across = np.degrees(np.linalg.norm(np.diff(rays.directions, axis=1), axis=-1))
    for rotated in (False, True):
        inside_enough(truth.bfov(mask, rays, rotated=rotated), mask, rays, np.nanmax(across))


TILTED = [(20, 10, 50, 20, 30), (-170, 35, 60, 15, -40), (80, -70, 40, 25, 10), (0, 0, 80, 8, 44)]


@pytest.mark.parametrize("box", TILTED)
def test_a_rotated_box_is_found_again(box):
    rays = FINE.unproject()
    box = SphericalBox(*box)
    mask = box.contains(rays.directions) >= 0
    found = SphericalBox.of(truth.bfov(mask, rays, rotated=True))
    assert truth.spherical_iou(found, box) >= 0.95
    assert found.area < 0.8 * SphericalBox.of(truth.bfov(mask, rays)).area
    quarter = (found.rot - box.rot + 45) % 90 - 45  # by a quarter turn, the two angles are exchanged
    assert quarter == pytest.approx(0, abs=1.5)


def test_wide_objects_have_ranges_of_longitude_and_latitude():
    rays = FINE.unproject()
    x, y, z = np.moveaxis(rays.directions, -1, 0)
    lon, lat = np.arctan2(x, z), -np.arcsin(y)
    south = lat < np.radians(20)
    ring = (np.abs(lat) < 0.1) & ((lon > 2) | (lon < -1))
    below = truth.bfov(south, rays)
    band = truth.bfov(ring, rays)
    assert (below["kind"], below["fov_h"], below["lat"]) == ("lonlat", 360, pytest.approx(-35, abs=0.5))
    assert below["fov_v"] == pytest.approx(110, abs=0.5)
    assert band["kind"] == "lonlat"
    assert band["fov_h"] == pytest.approx(np.degrees(2 * np.pi - 3), abs=0.6)
    assert (band["lon"] + 180) % 360 == pytest.approx(np.degrees((2 + 2 * np.pi - 1) / 2) - 180, abs=0.6)
    for record, where in ((below, south), (band, ring)):
        assert SphericalBox.of(record).contains(rays.directions[where]).min() > -0.3


def test_a_mask_without_a_pixel_is_refused():
    rays = FISHEYE.unproject()
    for mask in (np.zeros(rays.valid.shape, bool), ~rays.valid, np.ones((3, 3), bool)):
        with pytest.raises(ArgumentError, match="mask: expected pixels set within the rays'"):
            truth.bfov(mask, rays)
