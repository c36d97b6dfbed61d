"""Depth: exact on surfaces, and never a point between two of them."""

import numpy as np
import pytest
from support.computed import Computed
from support.exact import by_rays, cameras_at, distance_to_surfaces, float_source, plain_room

import omniscv
from mock_server import load_scene
from omniscv.cameras import create
from omniscv.depth.surfaces import surface_point
from omniscv.geometry import Pose
from omniscv.geometry.precision import Precision

POSE = Pose.from_angles((0.1, -0.2, 1.45), yaw_deg=27.0, pitch_deg=8.0, roll_deg=-5.0)
ROOMS = {name: float_source(load_scene(name)) for name in ("four-wall", "six-wall")}
CENTRAL = {name: camera for name, camera in cameras_at(128).items() if camera.central}

HALF_FLOATS_CM = Precision(0.01, 11, along_ray=False, largest_m=655.04)


@pytest.mark.parametrize(
    ("room", "name"),
    [pytest.param("four-wall", *each.values, marks=each.marks) for each in by_rays(CENTRAL)]
    + [("six-wall", "fisheye-equidistant")],
)
def test_depth_of_every_central_model(room, name):
    """Faces of 512 px, images of 128, float32 depth. Of ten thousand points and more none is in the air."""
    source = ROOMS[room]
    camera = CENTRAL[name]
    image = omniscv.render(camera, POSE, source, ("depth",), face_size=512)
    every = 4  # of the rows, one in so many is traced
    rays = camera.unproject(camera.pixels()[::every])
    truth = source.scene.trace(POSE.t_w_c, rays.directions @ POSE.R_w_c.T).distance
    depth = image.depth[::every]
    valid = image.valid[::every]
    off = np.abs(depth[valid] - truth[valid]) / truth[valid]
    assert np.median(off) <= 1e-5
    assert np.quantile(off, 0.99) <= 1e-3
    points = image.points()
    assert len(points) == np.count_nonzero(image.valid)
    assert np.count_nonzero(distance_to_surfaces(source.scene, points) > 0.02) == 0


def sky_m(view):
    """Depth of a floor one metre below, and of nothing above the horizon."""
    y, x = np.indices((view.height, view.width)) + 0.5
    rays = np.stack([x - view.width / 2, y - view.height / 2, np.full(x.shape, view.focal_px)], axis=-1)
    up = (rays / view.focal_px) @ view.pose.R_w_c[2]
    with np.errstate(divide="ignore"):
        return np.where(up < 0, -1 / up, np.inf).astype(np.float32)


@pytest.mark.parametrize("filter", ["auto", "nearest", "bicubic"])
def test_the_sky_stays_infinite_and_is_never_blended(filter):
    camera = create("equirectangular", width=256, height=128)
    pose = Pose.from_angles((0, 0, 1.0))
    image = omniscv.render(camera, pose, Computed(sky_m), ("depth",), filter=filter, face_size=128)
    assert np.isinf(image.depth[:62]).all()
    assert np.isfinite(image.depth[66:]).all()
    rays = camera.unproject().directions
    assert np.abs(image.depth[70:] * rays[70:, :, 1] - 1).max() < (1e-5 if filter != "nearest" else 0.2)


def test_a_thin_pole_keeps_its_depth():
    scene = plain_room({"Pole": {"solids": [{"cylinder": [0.01, 3], "at": [1.5, 0, 1.5]}]}})
    source = float_source(scene)
    camera = create("equirectangular", width=1024, height=512)
    image = omniscv.render(camera, Pose.from_angles((0, 0, 1.5)), source, ("depth", "object_mask"))
    pole = image.labels == scene.label("Pole")
    assert pole.sum() > 200
    points = image.points().reshape(512, 1024, 3)
    assert distance_to_surfaces(scene, points[pole]).max() < 0.01
    assert (np.abs(points[pole][:, 0] - 1.5) < 0.02).all()


@pytest.mark.parametrize("normals", ["captured", "from-depth"])
def test_a_depth_of_zero_is_no_fault(normals):
    """As a server may send where a surface touches the camera."""
    near = Computed(lambda view: np.zeros((view.height, view.width), np.float32))
    camera = create("noncentral-panorama", width=16, height=8, radius=0.5)
    modes = ("depth",) if normals == "captured" else ("depth", "normals")
    for strategy in ("exact", "auto"):
        image = omniscv.render(camera, POSE, near, modes, strategy=strategy, face_size=32, normals=normals)
        assert (image.depth[image.valid] < 1).all()


def test_a_curve_that_rounding_hides_is_within_its_bound():
    """Upright pillars in half floats of centimetres, against their exact depth between the pixels.

    Where a step of the half floats is as large as what a curve bends in a pixel, the pixels look flat.
    """
    pytest.importorskip("numba")  # Python calls a kernel that others call
    rng = np.random.default_rng(4)
    focal = 196.0
    for radius, away in rng.uniform((0.08, 0.9), (0.15, 1.6), (20, 2)):
        inside = int(0.6 * radius / away * focal)

        def planar(x, radius=radius, away=away):
            """Planar depth z at x px from the middle: z^2 u^2 + (z - away)^2 = radius^2."""
            square = 1 + (x / focal) ** 2
            return (away - np.sqrt(away**2 - square * (away**2 - radius**2))) / square

        columns = np.arange(-inside, inside) + 0.5
        stored = (np.float16(100 * planar(columns)) / np.float32(100)).astype(np.float32)
        face = np.broadcast_to(stored, (8, len(stored))).copy()
        for x in rng.uniform(3, 2 * inside - 3, 25):
            point = surface_point(face.ravel(), 0, face.shape, x, 4.2, focal, HALF_FLOATS_CM)
            true = 1 / planar(x - inside)
            assert abs(point.inverse - true) <= point.error, (radius, away, x)
