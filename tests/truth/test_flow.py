"""Optical flow and scene flow against traced scenes: what a pixel sees is traced, moved, and seen again."""

import numpy as np
import pytest
from cameras.examples import example_cameras
from scipy.ndimage import maximum_filter, minimum_filter
from support.rooms import FAMILIES
from support.traced_frames import traced

import mock_server
from omniscv import Pose, cameras, truth
from omniscv.errors import ArgumentError
from omniscv.geometry.instant import object_pose
from omniscv.truth.optical_flow import AT_INFINITY, INVALID, OCCLUDED, VALID

CAMERAS = example_cameras()
SCENE = mock_server.load_scene("six-wall")
BEFORE = Pose.from_angles((0.4, 0.3, 1.4), 20, 5, -3)
AFTER = Pose.from_angles((0.55, 0.2, 1.45), 28, 2, 1)


def world_rays(camera, pose, pixels=None):
    rays = camera.unproject(pixels)
    return pose.to_world(np.nan_to_num(rays.origins)), rays.directions @ pose.R_w_c.T


def seen_points(layers, camera, pose):
    origins_w, directions_w = world_rays(camera, pose)
    return origins_w + layers["depth"][..., None].astype(float) * directions_w


def off_ray(camera, pose, pixels, points_w):
    """Radians between the ray of a pixel and the direction from its origin to a point."""
    origins_w, directions_w = world_rays(camera, pose, pixels)
    toward = points_w - origins_w
    return np.linalg.norm(np.cross(toward, directions_w), axis=-1) / (toward * directions_w).sum(axis=-1)


@pytest.mark.parametrize("name", FAMILIES)
def test_flow_leads_to_the_pixel_that_sees_the_moved_point(name):
    camera = cameras.model(name).example(32 if name == "rolling-shutter" else 64)
    label, other = (SCENE.label(each) for each in SCENE.objects[:2])
    motions = {label: object_pose((0.1, -0.05, 0.02), 10), other: object_pose((0, 0.2, 0))}
    layers = traced(SCENE, camera, BEFORE)
    with np.errstate(invalid="ignore"):
        points_w = seen_points(layers, camera, BEFORE)
    moved = points_w.copy()
    for each, move in motions.items():
        mine = layers["labels"] == each
        moved[mine] = points_w[mine] @ move.rotation.T + move.position

    moving = {"labels": layers["labels"], "motions": motions}
    found = truth.flow(layers["depth"], camera.unproject(), BEFORE, camera, AFTER, **moving)
    surface = (layers["labels"] > 0) & np.isfinite(layers["depth"])
    expected = np.zeros_like(surface)
    expected[surface] = camera.project(AFTER.to_camera(moved[surface]))[1]
    known = found.mask != INVALID
    np.testing.assert_array_equal(known, expected)
    still = truth.flow(layers["depth"], camera.unproject(), BEFORE, camera, BEFORE, layers["depth"])
    np.testing.assert_array_equal(still.mask == VALID, camera.valid() & (layers["depth"] > 0))
    assert np.abs(still.pixels[still.mask == VALID]).max() < 1e-6
    assert not still.scene[still.mask == VALID].any()
    assert known.sum() > 0.2 * surface.sum()
    np.testing.assert_array_equal(np.isfinite(found.pixels).all(axis=-1), known)
    target = (camera.pixels() + found.pixels)[known]
    target[:, 0] = np.where(target[:, 0] < 0, target[:, 0] + camera.width, target[:, 0])
    target[:, 0] = np.where(target[:, 0] > camera.width, target[:, 0] - camera.width, target[:, 0])
    assert np.abs(off_ray(camera, AFTER, target, moved[known])).max() < 1e-6
    np.testing.assert_allclose(found.scene[surface], (moved - points_w)[surface], atol=1e-12)


def test_the_shortest_way_is_at_most_half_around():
    camera = cameras.create("equirectangular", 256, 128)
    level = Pose.from_angles((0, 0, 0))
    rays = camera.unproject()
    down = -1.5 / (rays.directions @ level.R_w_c.T)[..., 2]
    given = np.where(down > 0, down, np.inf), rays, level, camera, Pose.from_angles((3, 0.5, 0))
    found, classic = (truth.flow(*given, wrap=wrap).pixels[..., 0] for wrap in ("shortest", "classic"))
    below = found[np.isfinite(found)]
    assert -128 <= below.min() < below.max() < 128
    np.testing.assert_allclose((classic - found) / 256, np.rint((classic - found) / 256), atol=1e-9)
    assert np.nanmax(np.abs(classic)) > 128


def test_the_sky_only_turns():
    """Outdoors: the pixel that a sky pixel flows to sees the same direction, however far the camera walks."""
    scene = mock_server.load_scene("open")
    camera = CAMERAS["equirectangular-0"]
    far = Pose.from_angles((30, -20, 12), 70, 10, 5)
    layers = traced(scene, camera, BEFORE)
    found = truth.flow(layers["depth"], camera.unproject(), BEFORE, camera, far, labels=layers["labels"])
    sky = np.isposinf(layers["depth"])
    assert sky.sum() > 100
    assert (found.mask[sky] == AT_INFINITY).all()
    assert not (found.mask[~sky] == AT_INFINITY).any()
    target = (camera.pixels() + found.pixels)[sky]
    target[:, 0] %= camera.width
    directions_w = camera.unproject(target).directions @ far.R_w_c.T
    np.testing.assert_allclose(directions_w, world_rays(camera, BEFORE)[1][sky], atol=1e-9)
    assert np.isnan(found.scene[sky]).all()


@pytest.mark.parametrize("name", ["equirectangular", "noncentral-spherical-mirror"])
def test_hidden_points_are_occluded(name):
    """The second camera's rays are traced towards the points; near edges of depth, pixels cannot decide."""
    camera = cameras.model(name).example(192)
    after = Pose.from_angles((1.1, -0.4, 1.5), 30)
    layers, other = (traced(SCENE, camera, pose) for pose in (BEFORE, after))
    found = truth.flow(layers["depth"], camera.unproject(), BEFORE, camera, after, other["depth"])
    decided = (found.mask == VALID) | (found.mask == OCCLUDED)
    points_w = seen_points(layers, camera, BEFORE)[decided]
    target = (camera.pixels() + found.pixels)[decided]
    target[:, 0] %= camera.width if camera.wraps else np.inf
    origins_w, _ = world_rays(camera, after, target)
    away = np.linalg.norm(points_w - origins_w, axis=-1)
    hits = SCENE.trace(origins_w, points_w - origins_w)
    hidden = hits.distance < away - np.maximum(0.02, 0.01 * away)

    column, row = np.minimum(target.astype(int), [camera.width - 1, camera.height - 1]).T
    lowest, highest = (edge(other["labels"], size=3) for edge in (minimum_filter, maximum_filter))
    inside = (lowest == highest)[row, column]
    wrong = (found.mask[decided] == OCCLUDED) != hidden
    assert hidden[inside].sum() > 20
    assert (wrong & hidden)[inside].sum() < 0.15 * hidden[inside].sum()  # objects thinner than a pixel
    assert wrong[inside].mean() < 0.002
    assert wrong.mean() < 0.02


def test_what_is_unknown_has_no_flow_and_wrong_arguments_are_refused():
    camera = CAMERAS["equirectangular-0"]
    layers = traced(SCENE, camera, BEFORE)
    labels = layers["labels"].copy()
    labels[:5] = 0
    label = int(labels[20, 20])
    unknown = {"labels": labels, "motions": {label: None}}
    found = truth.flow(layers["depth"], camera.unproject(), BEFORE, camera, AFTER, **unknown)
    np.testing.assert_array_equal(found.mask == INVALID, (labels == 0) | (labels == label))
    camera = CAMERAS["pinhole-0"]
    rays = camera.unproject()
    depth = np.ones((45, 80))
    for wrong, says in [
        ({"depth0": np.ones((45, 79))}, "rays0: expected the size of depth0"),
        ({"depth1": np.ones((45, 79))}, "depth1: expected the size of the camera"),
        ({"labels": np.ones((3, 3), int)}, "labels: expected the size"),
        ({"motions": {1: BEFORE}}, "motions: expected labels"),
        ({"wrap": "longest"}, "wrap: expected one of shortest, classic"),
        ({"tolerance_m": -1}, "tolerance_m: expected a finite number >= 0"),
    ]:
        given = {"depth0": depth, "rays0": rays, "pose0": BEFORE, "camera1": camera, "pose1": AFTER} | wrong
        with pytest.raises(ArgumentError, match=says):
            truth.flow(**given)
