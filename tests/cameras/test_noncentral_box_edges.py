"""Edges of a box, projected, against the box traced exactly along each pixel's own ray.

``project`` says where an edge of known position must appear; the tracer, which knows no camera model,
says what the rays on either side of that place hit. On a silhouette one of them must miss.
"""

from itertools import combinations, product

import numpy as np
import pytest

from mock_server.scene import Scene
from omniscv import Pose, cameras

SIZE = np.array([0.8, 1.2, 0.6])
MIDDLE = np.array([2.2, 0.7, 1.1])
BOX = Scene(
    "box",
    {
        "objects": {
            "Box": {
                "texture": {"kind": "plain", "colors": [[1, 1, 1]]},
                "solids": [{"box": SIZE.tolist(), "at": MIDDLE.tolist()}],
            }
        }
    },
)

SETUPS = {
    "panorama": ("noncentral-panorama", {"width": 1024, "height": 512, "radius": 1.0}),
    "cone": (
        "noncentral-conical-mirror",
        {"width": 512, "height": 512, "half_angle_deg": 60, "distance": 0.3},
    ),
    "ball": (
        "noncentral-spherical-mirror",
        {"width": 512, "height": 512, "mirror_radius": 0.5, "distance": 0.3},
    ),
}
UPRIGHT = {"panorama": 0.0, "cone": 90.0, "ball": 90.0}  # pitch: mirrors hang above their camera
setups = pytest.mark.parametrize("setup", SETUPS)


def pose_of(setup, tilt_deg):
    return Pose.from_angles((0.1, -0.2, 1.3), 20.0, UPRIGHT[setup] - tilt_deg, tilt_deg / 2)


def silhouette(origins_w, faces):
    """Which rays see exactly one of the two faces (axis, sign) that meet in the edge."""
    ahead = []
    for axis, sign in faces:
        plane = MIDDLE[axis] + sign * SIZE[axis] / 2
        ahead.append(sign * (origins_w[..., axis] - plane) > 0)
    return ahead[0] != ahead[1]


def edges():
    """Each edge: 41 points on it, without its ends, and its two faces."""
    for a, b in combinations(range(3), 2):
        (along,) = {0, 1, 2} - {a, b}
        for sign_a, sign_b in product((-1, 1), repeat=2):
            points = np.tile(MIDDLE, (41, 1))
            points[:, a] += sign_a * SIZE[a] / 2
            points[:, b] += sign_b * SIZE[b] / 2
            points[:, along] += np.linspace(-0.48, 0.48, 41) * SIZE[along]
            yield points, ((a, sign_a), (b, sign_b))


def hits_box(camera, pose, pixels):
    rays = camera.unproject(pixels)
    hits = BOX.trace(pose.to_world(rays.origins), rays.directions @ pose.R_w_c.T)
    return hits.label == 1, rays.valid


@setups
@pytest.mark.parametrize("tilt_deg", [0.0, 15.0])
def test_labels_change_at_projected_silhouettes(setup, tilt_deg):
    """Within a thousandth of a pixel; the composed image may add its sampling, no more."""
    name, parameters = SETUPS[setup]
    camera, pose, checked = cameras.create(name, **parameters), pose_of(setup, tilt_deg), 0
    for points_w, faces in edges():
        pixels, seen = camera.project(pose.to_camera(points_w))
        rays = camera.unproject(pixels)
        on_silhouette = silhouette(pose.to_world(rays.origins), faces)
        tangent = np.gradient(pixels, axis=0)
        smooth = np.linalg.norm(tangent, axis=1) < 100  # not across the seam
        normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=-1)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        left, left_valid = hits_box(camera, pose, pixels + 1e-3 * normal)
        right, right_valid = hits_box(camera, pose, pixels - 1e-3 * normal)
        use = seen & smooth & on_silhouette & left_valid & right_valid
        np.testing.assert_array_equal(left[use], ~right[use])
        # Edges within the outline have the box on both sides; hidden ones, too.
        inner = seen & smooth & ~on_silhouette & left_valid & right_valid
        assert (left & right)[inner].all()
        checked += use.sum()
    assert checked > 100


@setups
def test_a_point_of_the_box_is_hit_by_the_ray_that_sees_it(setup):
    """At the point's own distance; before it if the point is on a far side of the box."""
    name, parameters = SETUPS[setup]
    camera, pose = cameras.create(name, **parameters), pose_of(setup, 15.0)
    rng = np.random.default_rng(0)
    points_w, face = MIDDLE + rng.uniform(-0.5, 0.5, (500, 3)) * SIZE, rng.integers(3, size=500)
    points_w[np.arange(500), face] = (MIDDLE - SIZE / 2)[face]
    pixels, seen = camera.project(pose.to_camera(points_w))
    rays = camera.unproject(pixels[seen])
    origins_w = pose.to_world(rays.origins)
    hits = BOX.trace(origins_w, rays.directions @ pose.R_w_c.T)
    distance = np.linalg.norm(points_w[seen] - origins_w, axis=1)
    in_front = ((MIDDLE - SIZE / 2) - origins_w)[np.arange(len(distance)), face[seen]] > 0
    assert 50 < in_front.sum() < len(in_front)
    assert (hits.label == 1).all()
    np.testing.assert_allclose(hits.distance[in_front], distance[in_front], rtol=0, atol=1e-12)
    assert (hits.distance[~in_front] < distance[~in_front]).all()
