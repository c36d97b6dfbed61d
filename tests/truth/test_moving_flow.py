"""Flow of a world in which objects move by themselves, judged by tracing it at both times."""

import numpy as np
import pytest
from scipy.ndimage import maximum_filter, minimum_filter
from support.traced_frames import traced

import mock_server
from mock_server.scene_file import turned
from omniscv import Pose, cameras, truth
from omniscv.truth.optical_flow import OCCLUDED, VALID, motion

SCENE = mock_server.load_scene("workshop")
BEFORE_THE_CRATE = {"Cabinet": (turned(30), (0.6, -0.85, 0.85))}
WORLDS = [SCENE.at(0.4), SCENE.at(0.75, BEFORE_THE_CRATE)]
MOVED = (*SCENE.moving, "Cabinet")
BEFORE = Pose.from_angles((0.1, 0.2, 1.1), 20, 5, -3)
AFTER = Pose.from_angles((0.25, 0.1, 1.2), 27, 3, 1)
MODELS = ("equirectangular", "noncentral-panorama")


def poses(world):
    """Of all that moves, as the scene has them."""
    return {name: Pose(place, R_w_o) for name, (R_w_o, place) in ((n, world.pose(n)) for n in MOVED)}


def motions():
    was, is_now = map(poses, WORLDS)
    return {SCENE.label(name): motion(was[name], is_now[name]) for name in MOVED}


def moved_points(points_w, labels):
    """Where points of objects at the first time are at the second: by rotations and places, written out."""
    moved = points_w.copy()
    for name in MOVED:
        (R0, place0), (R1, place1) = (world.pose(name) for world in WORLDS)
        mine = labels == SCENE.label(name)
        moved[mine] = (points_w[mine] - place0) @ (R1 @ R0.T).T + place1
    return moved


def rays_w(camera, pose, pixels=None):
    rays = camera.unproject(pixels)
    return pose.to_world(np.nan_to_num(rays.origins)), rays.directions @ pose.rotation.T


@pytest.mark.parametrize("name", MODELS)
def test_flow_is_exact_where_both_frames_see_the_point(name):
    """The pixel that flow leads to sees, in the scene at the second time, the same point of that object."""
    camera = cameras.model(name).example(160)
    layers, other = (traced(world, camera, pose) for world, pose in zip(WORLDS, (BEFORE, AFTER), strict=True))
    found = truth.flow(
        layers["depth"], camera.unproject(), BEFORE, camera, AFTER, other["depth"],
        layers["labels"], motions(),
    )  # fmt: skip
    known = (found.mask == VALID) | (found.mask == OCCLUDED)
    origins_w, directions_w = rays_w(camera, BEFORE)
    labels = layers["labels"][known]
    points_w = (origins_w + layers["depth"][..., None].astype(float) * directions_w)[known]
    moved_w = moved_points(points_w, labels)
    target = (camera.pixels() + found.pixels)[known]
    target[:, 0] %= camera.width if camera.wraps else np.inf
    origins_w, directions_w = rays_w(camera, AFTER, target)
    hits = WORLDS[1].trace(origins_w, directions_w)
    away = np.linalg.norm(moved_w - origins_w, axis=-1)
    both = (hits.label == labels) & (np.abs(hits.distance - away) < 1e-4)
    moved = np.isin(labels, list(motions()))
    assert (both & moved).sum() > 60

    right = rays_w(camera, AFTER, np.minimum(target + np.array([1e-3, 0]), camera.width))[1]
    step = np.linalg.norm(right - directions_w, axis=-1)[both]  # of a thousandth of a pixel
    off = np.linalg.norm(np.cross(moved_w - origins_w, directions_w), axis=-1)[both] / away[both]
    assert (off <= np.maximum(step, 1e-7)).all()
    np.testing.assert_allclose(found.scene[known], moved_w - points_w, atol=1e-5)

    hidden = hits.distance < away - np.maximum(0.02, 0.01 * away)
    column, row = np.minimum(target.astype(int), [camera.width - 1, camera.height - 1]).T
    inside = np.equal(
        *(edge(other["labels"], size=3)[row, column] for edge in (minimum_filter, maximum_filter))
    )
    wrong = (found.mask[known] == OCCLUDED) != hidden
    assert (hidden & moved)[inside].sum() > 20
    assert wrong[inside].mean() < 0.003


def test_an_object_that_moves_with_the_camera_has_no_flow():
    """A rigid motion of camera and object together gives no flow, whatever the frame of the object."""
    camera = cameras.create("equirectangular", width=96, height=48)
    layers = traced(WORLDS[0], camera, BEFORE)
    label = SCENE.label("Crate")
    for rest in (Pose.from_angles((0, 0, 0)), Pose.from_angles((3, -1, 0.5), 77, 20, 5)):
        together = {label: motion(BEFORE @ rest, AFTER @ rest)}
        found = truth.flow(
            layers["depth"], camera.unproject(), BEFORE, camera, AFTER, None, layers["labels"], together
        )
        mine = layers["labels"] == label
        assert mine.sum() > 10
        assert np.abs(found.pixels[mine]).max() < 1e-9
        still = truth.flow(layers["depth"], camera.unproject(), BEFORE, camera, AFTER)
        np.testing.assert_array_equal(found.pixels[~mine], still.pixels[~mine])
