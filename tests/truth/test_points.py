"""Points of images: on the surfaces of the scene, and thinned to the ones seen from nearest."""

import numpy as np
import pytest
from cameras.examples import example_cameras
from support.exact import distance_to_surfaces
from support.rooms import FAMILIES
from support.traced_frames import traced

import mock_server
import omniscv
from omniscv import Pose, truth
from omniscv.errors import ArgumentError
from omniscv.geometry import R_LEVEL
from omniscv.truth import Points, point_cloud

CAMERAS = example_cameras()
SCENE = mock_server.load_scene("six-wall")
POSE = Pose.from_angles((0.4, 0.3, 1.4), 20, 5, -3)


@pytest.mark.parametrize("name", FAMILIES)
def test_points_lie_on_the_surfaces(name):
    camera = CAMERAS[f"{name}-example"]
    layers = traced(SCENE, camera, POSE)
    depth = layers.pop("depth")
    normals = layers["normals"]
    found = truth.points(depth, camera.unproject(), POSE, layers)
    seen = np.isfinite(depth) & (depth > 0)
    assert len(found) == seen.sum() > 0
    assert distance_to_surfaces(SCENE, found.positions_w).max() < 1e-5  # depth has float32's 24 bits
    np.testing.assert_array_equal(found.values["labels"], layers["labels"][seen])
    np.testing.assert_allclose(found.values["normals"], normals[seen] @ POSE.rotation.T, atol=1e-6)


@pytest.mark.parametrize(
    ("preset", "degrees", "turned"),
    [("vlp-16", -15 + 2 * np.arange(16), 0.0), ("os1-64", 21.2 - 42.4 / 63 * np.arange(64), 4.2)],
)
def test_points_of_a_lidar_by_ring_and_time(preset, degrees, turned):
    """The elevation follows from the ring, and the azimuth from the time after the first firing: at 10 Hz, to
    the right, from behind; an OS1's four columns of lasers are 4.2 or 1.4 degrees aside."""
    camera = omniscv.cameras.create("lidar", preset=preset, width=200)
    with omniscv.open_source("scene://six-wall") as source:
        image = omniscv.render(camera, POSE, source, modes=("depth",))
    assert np.isfinite(image.depth).all()
    off = distance_to_surfaces(SCENE, image.points())
    assert (off <= np.maximum(image.depth_error.ravel(), 1e-6)).mean() > 0.999  # float32, and beside edges
    x, y, z = R_LEVEL @ (POSE.to_camera(image.points()) - camera.unproject().origins.reshape(-1, 3)).T
    ring = np.repeat(camera.rings, camera.width)
    np.testing.assert_allclose(np.degrees(np.arctan2(z, np.hypot(x, y))), degrees[ring], atol=1e-9)
    off = np.degrees(np.arctan2(y, x)) - (180 - 3600 * camera.seconds().ravel())
    off = np.abs((off + 180) % 360 - 180)
    aside = np.where(np.isin(ring % 4, (0, 3)), turned, turned / 3)
    np.testing.assert_allclose(off, aside, atol=1e-9)


def test_pixels_without_surface_or_unsure_have_no_point():
    camera = CAMERAS["equirectangular-0"]
    depth = np.full((48, 96), 2.0, np.float32)
    unsure = np.zeros((48, 96), bool)
    depth[0] = 0
    depth[1] = np.inf
    depth[2] = np.nan
    unsure[3] = True
    found = truth.points(depth, camera.unproject(), POSE, {"row": np.indices((48, 96))[0]}, unsure)
    assert set(found.values["row"]) == set(range(4, 48))


@pytest.mark.parametrize("intensity", [False, True])
def test_a_lidar_under_an_open_sky_has_points_of_what_it_meets_alone(intensity, tmp_path):
    lidar = omniscv.cameras.create("lidar", preset="vlp-16", width=90)
    with omniscv.open_source("scene://open") as source, omniscv.dataset.Writer(tmp_path / "sky") as writer:
        image = omniscv.render(lidar, Pose.from_angles((0, 0, 1.5)), source, ("lit", "depth", "normals"))
        writer.add("scan", image)
    (frame,) = omniscv.dataset.open(tmp_path / "sky")
    scan = point_cloud.sweep(frame, intensity=intensity)
    met = np.isfinite(image.depth) & ~image.unsure
    assert 0.1 < met.mean() < 0.9
    assert (np.isfinite(scan["x"]) == met).all()
    away = np.sqrt(scan["x"] ** 2 + scan["y"] ** 2 + scan["z"] ** 2)[met]
    origins = np.linalg.norm(lidar.unproject().origins, axis=-1).max()  # the lasers are beside the middle
    np.testing.assert_allclose(away, image.depth[met], atol=1.01 * origins + 1e-3)


def test_of_points_in_a_cube_the_one_seen_from_nearest_stays():
    draw = np.random.default_rng(3)
    whole = Points(draw.normal(size=(3000, 3)), draw.uniform(1, 9, 3000), {"id": np.arange(3000)})
    nearest: dict[tuple, int] = {}
    for i, place in enumerate(whole.positions_w):
        cube = tuple(np.floor(place / 0.3 + 0.5))
        if cube not in nearest or whole.distances[i] < whole.distances[nearest[cube]]:
            nearest[cube] = i
    clouds = [whole.select(np.arange(start, start + 500)) for start in range(0, 3000, 500)]
    found = truth.merged(clouds, 0.3)
    assert found.values["id"].tolist() == sorted(nearest.values())
    np.testing.assert_array_equal(found.positions_w, whole.positions_w[found.values["id"]])
    np.testing.assert_array_equal(found.distances, whole.distances[found.values["id"]])
    more = Points(np.zeros((1, 3)), np.ones(1), {"lit": np.zeros((1, 3)), "id": np.ones(1)})
    assert set(truth.merged([more, whole], 0.3).values) == {"id"}  # what some clouds lack is left out
    assert len(truth.merged([more.select(np.zeros(1, bool)), more], 0.1)) == 1


def test_wrong_arguments_are_refused():
    camera = CAMERAS["pinhole-0"]
    with pytest.raises(ArgumentError, match="rays: expected the size of depth"):
        truth.points(np.ones((2, 2)), camera.unproject(), POSE)
    far = Points(np.array([[0.0] * 3, [2000.0] * 3]), np.ones(2))
    with pytest.raises(ArgumentError, match=r"voxel: expected at least 0\.0019"):
        truth.merged([far], 1e-3)
    utm = Points(far.positions_w / 1000 + (5e5, 5e6, 0), np.ones(2))  # the grid is counted from there
    np.testing.assert_array_equal(truth.merged([utm], 1e-3).positions_w, utm.positions_w)
    with pytest.raises(ArgumentError, match="at least one"):
        truth.merged([], 0.1)
