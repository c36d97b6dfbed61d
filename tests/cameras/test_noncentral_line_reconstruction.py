"""A straight 3D line from a single image: what non-central cameras can do and central ones cannot.

Two lines with Plücker coordinates (d, m) and (l, n) meet when ``d . n + m . l = 0``. Points of a line
are projected, their pixels unprojected, and the line is what all these rays meet: linear in its six
coordinates, so a null vector of an SVD. All rays meet the camera's axis as well, which leaves the
line's component along the axis out of every equation; ``l . n = 0`` gives it back.
"""

import numpy as np
import pytest

from omniscv import cameras

PANORAMA = ("noncentral-panorama", {"radius": 1.0})
CONE = ("noncentral-conical-mirror", {"half_angle_deg": 60, "distance": 0.3})
BALL = ("noncentral-spherical-mirror", {"mirror_radius": 0.5, "distance": 0.3})
models = pytest.mark.parametrize("model", [PANORAMA, CONE, BALL], ids=["panorama", "cone", "ball"])


def create(model):
    name, parameters = model
    return cameras.create(name, width=1024, height=1024 if "mirror" in name else 512, **parameters)


def axis_of(camera):
    return 1 if camera.name == "noncentral-panorama" else 2


def line_through(rays, axis):
    """(direction, moment) of the line that rays (N >= 4) and the camera's axis leave over."""
    lines = rays.lines()
    equations = np.concatenate([lines[:, 3:], lines[:, :3]], axis=1)  # unknowns: l, then n
    *_, null = np.linalg.svd(np.delete(equations, axis, axis=1))[2]
    line = np.insert(null, axis, 0.0)
    line[axis] = -(line[:3] @ line[3:]) / line[3 + axis]
    return line[:3] / np.linalg.norm(line[:3]), line[3:] / np.linalg.norm(line[:3])


def errors(found, point, direction):
    """Angle to the true direction, rad; and metres between the true point and the found line."""
    d, m = found
    angle = np.arcsin(min(1, np.linalg.norm(np.cross(d, direction))))
    return angle, np.linalg.norm(np.cross(point, d) - m)


def random_edges(camera, count, rng):
    """``count`` times 40 points (40, 3) on lines of 4 m, 2 to 3 m off the axis and seen in full.

    None of them is near to a plane with the axis (there is no baseline: every camera is central in
    that plane), or, for the panorama, level: a level line is seen by the circle's rays in one pencil.
    """
    axis, edges = axis_of(camera), []
    while len(edges) < count:
        away, along = rng.normal(size=(2, 3))
        away[axis] = 0
        along /= np.linalg.norm(along)
        foot = rng.uniform(2, 3) * away / np.linalg.norm(away)
        baseline = abs(np.cross(foot, along)[axis])
        points = foot + np.linspace(-2, 2, 40)[:, None] * along
        if baseline > 1 and abs(along[axis]) > 0.3 and camera.project(points)[1].all():
            edges.append(points)
    return edges


@models
@pytest.mark.parametrize("rays_used", [4, 40])
def test_a_line_from_its_rays_alone(model, rays_used):
    """Exact pixels: the line comes back to 2e-12 m and 5e-13 rad at worst, 4 rays or 40."""
    camera = create(model)
    for points in random_edges(camera, 20, np.random.default_rng(1)):
        chosen = points[np.linspace(0, 39, rays_used).astype(int)]
        pixels, seen = camera.project(chosen)
        assert seen.all()
        rays = camera.unproject(pixels)
        direction = (points[-1] - points[0]) / np.linalg.norm(points[-1] - points[0])
        angle, metres = errors(line_through(rays, axis_of(camera)), points[0], direction)
        # Rays are known to 1e-15; baselines of 0.1 m (mirrors) and 1 m, over 3 m, magnify that.
        assert angle < 1e-11
        assert metres < 1e-11


@models
def test_rays_of_a_line_meet_it(model):
    """The incidence of each ray with its line, in metres: rounding only."""
    camera = create(model)
    for points in random_edges(camera, 20, np.random.default_rng(2)):
        lines = camera.unproject(camera.project(points)[0]).lines()
        direction = (points[-1] - points[0]) / np.linalg.norm(points[-1] - points[0])
        moment = np.cross(points[0], direction)
        np.testing.assert_allclose(lines[:, :3] @ moment + lines[:, 3:] @ direction, 0, atol=2e-14)


@pytest.mark.parametrize(
    ("model", "bound"), [(PANORAMA, 0.02), (CONE, 0.1), (BALL, 0.4)], ids=["panorama", "cone", "ball"]
)
def test_what_a_tenth_of_a_pixel_costs(model, bound):
    """400 places on an edge, each read with an error of 0.1 px: metres off the line, the median of 60.

    Measured 0.008 m in the panorama, 0.05 m in the cone, 0.2 m in the ball: as their baselines.
    """
    camera, rng, off = create(model), np.random.default_rng(5), []
    for points in random_edges(camera, 60, np.random.default_rng(1)):
        dense = points[0] + np.linspace(0, 1, 400)[:, None] * (points[-1] - points[0])
        pixels, _ = camera.project(dense)
        noisy = pixels + rng.normal(scale=0.1, size=pixels.shape)
        rays = camera.unproject(noisy[camera.valid(noisy)])
        direction = (points[-1] - points[0]) / np.linalg.norm(points[-1] - points[0])
        off.append(errors(line_through(rays, axis_of(camera)), points[20], direction)[1])
    assert bound / 20 < np.median(off) < bound


@models
def test_a_central_camera_could_not(model):
    """With the origins taken away the rays are a plane: two null vectors, no line."""
    camera = create(model)
    (points,) = random_edges(camera, 1, np.random.default_rng(1))
    pixels, _ = camera.project(points)
    lines = camera.unproject(pixels).lines()
    equations = np.delete(np.concatenate([lines[:, 3:], lines[:, :3]], axis=1), axis_of(camera), axis=1)
    values = np.linalg.svd(equations, compute_uv=False)
    assert values[-1] < 1e-12 * values[0]
    assert values[-2] > 1e-5 * values[0]  # the baseline at work
    central = cameras.create("equirectangular", width=1024, height=512)
    flat = central.unproject(central.project(points)[0]).lines()
    values = np.linalg.svd(np.concatenate([flat[:, 3:], flat[:, :3]], axis=1), compute_uv=False)
    assert (values[2:] < 1e-12 * values[0]).all()
