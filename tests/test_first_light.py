"""The whole road, over a real socket, judged by exact ray tracing of the scene."""

import numpy as np
import pytest

import mock_server
import omniscv

POSE = omniscv.Pose.from_angles((0.1, -0.2, 1.5), yaw_deg=25, pitch_deg=10, roll_deg=-5)
MODES = ("lit", "object_mask", "depth")
CAMERAS = {
    "equirectangular": {"width": 256, "height": 128},
    "fisheye-equidistant": {"width": 192, "height": 192, "fov_deg": 185},
    "noncentral-panorama": {"width": 32, "height": 128, "radius": 1.0},
}


@pytest.fixture(scope="module")
def room():
    return mock_server.load_scene("four-wall")


@pytest.fixture(scope="module")
def images(room, tmp_path_factory):
    """Each camera's image, captured over TCP, and the same from the record, with the server gone."""
    path = tmp_path_factory.mktemp("record") / "room.sqlite"
    cameras = {name: omniscv.cameras.create(name, **given) for name, given in CAMERAS.items()}
    with (
        mock_server.serve(room, dialect="1.x") as server,
        omniscv.open_source(server.uri) as live,
        omniscv.record(live, path) as source,
    ):
        captured = {
            name: omniscv.render(camera, POSE, source, MODES, face_size=224)
            for name, camera in cameras.items()
        }
    return captured, path


def traced(room, image):
    """What each pixel's own ray meets."""
    rays = image.camera.unproject()
    valid = rays.valid
    return valid, room.trace(POSE.to_world(rays.origins[valid]), rays.directions[valid] @ POSE.R_w_c.T)


@pytest.mark.parametrize("name", CAMERAS)
def test_depth_is_the_traced_distance(room, images, name):
    image = images[0][name]
    valid, hits = traced(room, image)
    np.testing.assert_array_equal(valid, image.valid)
    error = np.abs(image.depth[valid] - hits.distance) / hits.distance
    # The server sends half floats: half a step of 2^-11 relative at most, 2^-12 in the middle.
    assert np.median(error) <= 1e-3
    assert (image.depth[~valid] == 0).all()


@pytest.mark.parametrize("name", CAMERAS)
def test_labels_are_the_traced_ones(room, images, name):
    image = images[0][name]
    valid, hits = traced(room, image)
    assert (image.labels[valid] == hits.label).mean() >= 0.995
    assert (image.labels[~valid] == 0).all()


@pytest.mark.parametrize("name", CAMERAS)
def test_points_lie_on_traced_surfaces(room, images, name):
    image = images[0][name]
    points = image.points()
    assert len(points) == np.count_nonzero(np.isfinite(image.depth) & (image.depth > 0))
    center = POSE.t_w_c
    directions = points - center
    far = room.trace(np.broadcast_to(center, points.shape), directions)
    # From the middle of a central camera the same surface is met again, at the point itself.
    if image.camera.central:
        off = np.abs(far.distance - np.linalg.norm(directions, axis=-1))
        assert np.quantile(off, 0.99) < 0.01  # a centimetre: half floats at the far walls step by 2 mm


@pytest.mark.block_network
@pytest.mark.parametrize("name", CAMERAS)
def test_the_replay_is_the_same_and_touches_no_socket(images, name):
    captured, path = images
    with omniscv.open_source(str(path)) as replay:
        again = omniscv.render(captured[name].camera, POSE, replay, MODES, face_size=224)
    for layer in ("lit", "object_mask", "labels", "depth", "valid"):
        np.testing.assert_array_equal(getattr(again, layer), getattr(captured[name], layer), err_msg=layer)
