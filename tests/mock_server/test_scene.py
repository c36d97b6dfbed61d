"""Tracing is exact: compared with geometry that needs no intersection, and object by object."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import mock_server
from mock_server import solids, textures
from mock_server.pixels import pinhole_rays
from mock_server.scene import Scene

ROOMS = ("four-wall", "six-wall")
FIELDS = ("distance", "label", "normal", "color")
CENTER = np.array([0.3, -0.7, 1.1])
TURN_DEG = 25.0
TILT_DEG = 40.0
SKY = (0.25, 0.5, 0.75)
SOLIDS = {
    "sphere": {"sphere": 0.8},
    "box": {"box": [1.0, 0.6, 1.4], "turn_deg": TURN_DEG, "tilt_deg": TILT_DEG},
    "cylinder": {"cylinder": [0.5, 1.2]},
}
# The hit of a ray at grazing angle moves by the rounding over the cosine: 1e-15 m / 0.05, and some room.
LEAST_COSINE = 0.05
EXACT = 1e-13

unit = st.floats(-1, 1)
angle = st.floats(0, 2 * np.pi)


SCENES = {
    kind: Scene("it", {"sky": [*SKY], "objects": {"It": {"solids": [solid | {"at": CENTER.tolist()}]}}})
    for kind, solid in SOLIDS.items()
}
FOUR_WALL = mock_server.load_scene("four-wall")


def room_data(name):
    return yaml.safe_load((Path(mock_server.__file__).parent / "scenes" / f"{name}.yaml").read_text())


def random_rays(rng, count):
    origins = rng.uniform((-0.8, -0.8, 0.6), (0.8, 0.8, 2.0), (count, 3))
    directions = rng.normal(size=(count, 3))
    return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def surface_point(kind, a, b, turn, face):
    if kind == "sphere":
        z = a
        n = np.array([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z])
        return CENTER + 0.8 * n, n
    if kind == "cylinder":
        if face % 3 == 0:
            n = np.array([np.cos(turn), np.sin(turn), 0.0])
            return CENTER + 0.5 * n + (0, 0, 0.6 * a), n
        n = np.array([0, 0, 1.0 if face % 3 == 1 else -1.0])
        return CENTER + 0.5 * abs(a) * np.array([np.cos(turn), np.sin(turn), 0]) + 0.6 * n, n
    axes = Rotation.from_euler("ZY", [TURN_DEG, TILT_DEG], degrees=True).as_matrix().T
    half = np.array([0.5, 0.3, 0.7])
    k = face % 3
    sign = 1 if face < 3 else -1
    local = half * [a, b, a * b]
    local[k] = sign * half[k]
    return CENTER + local @ axes, sign * axes[k]


@pytest.mark.parametrize("kind", SOLIDS)
@given(
    st.tuples(unit, unit, angle, st.integers(0, 5)),
    st.tuples(st.floats(0, 1.5), angle, st.floats(1e-3, 50), st.floats(0.05, 1.0)),
)
def test_rays_to_a_surface_point_meet_it_and_one_that_leaves_it_meets_the_sky(kind, place, ray):
    """From both sides. The solids are convex: outside, nothing is before a point or behind it."""
    (a, b, turn, face) = place
    (tilt, spin, s, where) = ray
    q, n = surface_point(kind, a, b, turn, face)
    side = np.linalg.svd(n[None])[2][1:]
    away = np.cos(tilt) * n + np.sin(tilt) * (np.cos(spin) * side[0] + np.sin(spin) * side[1])
    assume(np.cos(tilt) > LEAST_COSINE)
    # On an edge rounding may take either face, or miss: one part in 1e9 within is enough to be on the face.
    assume(max(abs(a), abs(b)) < 1 - 1e-9)
    within = where * (CENTER - q)
    hits = SCENES[kind].trace([q + s * away, q + within, q + 1e-9 * n], [-away, -within, away])
    slack = (1 + s) * EXACT / LEAST_COSINE
    assert hits.distance[:2] == pytest.approx([s, np.linalg.norm(within)], rel=0, abs=slack)
    np.testing.assert_allclose(hits.normal[:2], [n, -n], atol=slack)
    assert hits.label.tolist() == [1, 1, 0]
    assert hits.distance[2] == np.inf
    assert not hits.normal[2].any()
    np.testing.assert_array_equal(hits.color[2], SKY)


def test_the_tree_of_boxes_loses_no_hit_of_3000_solids():
    """Against every solid on its own, whose tree is one leaf; of equal distances, the first solid counts."""
    scene = mock_server.load_scene("courtyard")
    o, d = random_rays(np.random.default_rng(8), 600)
    nearest = np.full(len(o), np.inf)
    which = np.full(len(o), -1)
    distance = np.empty(len(o))
    index = np.empty(len(o), np.int64)
    normal = np.empty((len(o), 3))
    for row in range(len(scene.solids)):
        alone = scene.solids[row : row + 1]
        solids.nearest_hits(o, d.copy(), alone, solids.tree(alone), np.ones(1, bool), distance, index, normal)
        which = np.where(distance < nearest, row, which)
        nearest = np.minimum(nearest, distance)
    hits = scene.trace(o, d)
    np.testing.assert_array_equal(hits.distance, nearest)
    np.testing.assert_array_equal(hits.label, scene._labels[which + 1])
    assert len(scene.solids) > 3000
    assert len(set(hits.label)) >= len(scene.objects) - 1  # of 17; cables of 12 mm are hit by few rays


def rays_of_a_picture(fov_deg, radius):
    """Neighbours side by side, as cameras send them: from one point, or from a circle about it."""
    azimuth = np.radians(np.linspace(-fov_deg / 2, fov_deg / 2, 80))[None, :]
    elevation = np.radians(np.linspace(-fov_deg / 4, fov_deg / 4, 40))[:, None]
    azimuth, elevation = np.broadcast_arrays(azimuth, elevation)
    level = np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=-1).reshape(-1, 3)
    d = level * np.cos(elevation).reshape(-1, 1) + (0, 0, 1) * np.sin(elevation).reshape(-1, 1)
    return radius * level + (-0.2, 0.1, 1.3), d


def test_neighbouring_rays_are_looked_at_together_but_meet_what_each_meets_alone():
    for name, fov_deg, radius in (("six-wall", 5, 0.0), ("four-wall", 90, 0.0), ("six-wall", 360, 0.5)):
        scene = mock_server.load_scene(name)
        o, d = rays_of_a_picture(fov_deg, radius)
        hits = scene.trace(o, d)
        order = np.random.default_rng(15).permutation(len(d))
        shuffled = scene.trace(o[order], d[order])
        for field in FIELDS:
            np.testing.assert_array_equal(getattr(shuffled, field), getattr(hits, field)[order])


def test_a_ray_with_nan_among_others_leaves_them_alone():
    o, d = rays_of_a_picture(60, 0.0)
    spoiled = d.copy()
    spoiled[::97] = np.nan
    clean = FOUR_WALL.trace(o, d)
    hits = FOUR_WALL.trace(o, spoiled)
    good = np.isfinite(spoiled).all(axis=1)
    np.testing.assert_array_equal(hits.distance[good], clean.distance[good])
    assert np.isinf(hits.distance[~good]).all()
    assert not hits.label[~good].any()


@pytest.mark.parametrize("name", ROOMS)
def test_objects_lie_in_their_bounds_and_fill_them(name):
    scene = mock_server.load_scene(name)
    data = room_data(name)["objects"]
    for each in scene.objects:
        low, high = scene.bounds(each)
        if each not in data:
            continue
        o = low + (high - low) * np.random.default_rng(10).uniform(-1, 2, (4000, 3))
        target = low + (high - low) * np.random.default_rng(11).uniform(0, 1, (4000, 3))
        only = set(scene.objects) - {each}
        hits = scene.trace(o, target - o, hidden=only)
        d = (target - o) / np.linalg.norm(target - o, axis=1, keepdims=True)
        points = (o + hits.distance[:, None] * d)[hits.label > 0]
        slack = 0.15 * (high - low)  # what 4000 random rays leave untouched
        assert (points >= low - 1e-9).all()
        assert (points <= high + 1e-9).all()
        assert (points.min(axis=0) <= low + slack).all()
        assert (points.max(axis=0) >= high - slack).all()


@given(st.integers(1, 40), st.integers(1, 40), st.floats(5, 170), st.tuples(angle, angle, angle))
def test_a_view_is_the_trace_of_its_own_rays(width, height, fov_deg, turns):
    scene = FOUR_WALL
    (c, s), (e, g), (h, k) = [(np.cos(t), np.sin(t)) for t in turns]
    about_z = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    about_x = [[1, 0, 0], [0, e, -g], [0, g, e]]
    R_w_c = about_z @ about_x @ [[h, -k, 0], [k, h, 0], [0, 0, 1]]
    view = scene.view((0.1, 0.2, 1.5), *pinhole_rays(R_w_c, fov_deg, (width, height)))
    focal = width / 2 / np.tan(np.radians(fov_deg) / 2)
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays_c = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(K).T
    hits = scene.trace((0.1, 0.2, 1.5), rays_c @ R_w_c.T)
    same = view.label == hits.label  # a pixel may sit on an edge, to the last digit
    assert same.mean() >= 0.99
    np.testing.assert_allclose(view.distance[same], hits.distance[same], rtol=1e-9)
    # Planar depth is the third coordinate in the camera; rays_c has it 1.
    far = view.depth * np.linalg.norm(rays_c, axis=-1)
    np.testing.assert_allclose(far[same], hits.distance[same], rtol=1e-9)
    assert view.codes.shape == (height, width, 3)
    assert view.codes.dtype == np.uint8
    assert np.abs(view.codes - 255 * hits.color)[same].max() <= 0.5 + 1e-6


def test_the_direction_scene_is_its_own_ray():
    d = np.random.default_rng(14).normal(size=(100, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    hits = mock_server.load_scene("direction").trace((3, 2, 1), d)
    np.testing.assert_allclose(2 * hits.color - 1, d, atol=1e-15)
    assert np.isinf(hits.distance).all()


def test_waves_repeat_after_their_period():
    scene = mock_server.load_scene("waves")
    period = room_data("waves")["pattern"]["period_rad"]
    z = np.linspace(0, 0.5, 200)
    rays = np.stack([np.sqrt(1 - z**2), np.zeros_like(z), z], axis=1)
    later = z + period
    shifted = np.stack([np.sqrt(1 - later**2), np.zeros_like(z), later], axis=1)
    blue = scene.trace((0, 0, 0), rays).color[:, 2]
    again = scene.trace((0, 0, 0), shifted).color[:, 2]
    np.testing.assert_allclose(blue, again, atol=1e-12)
    assert blue.max() - blue.min() > 0.9


def colors_of(texture, points, normal=(0, 0, 1)):
    """Colours without the shade of the surface's direction."""
    normals = np.tile(np.array(normal, float), (len(points), 1))
    white = textures.Texture("plain", (1.0,) * 3, (1.0,) * 3, 1.0, 0.0)
    dark = textures.paint(white, points, normals, normals)
    return textures.paint(texture, points, normals, normals) / dark


def test_noise_repeats_nowhere():
    """Its autocorrelation over 200 m has no second peak; it has no steps, both colours, and a seed."""
    noise = textures.Noise("noise", (0.0,) * 3, (1.0,) * 3, 0.5, 0.0, 3, 5)
    points = np.tile([0.3, 0.7, 0.1], (1 << 15, 1))
    points[:, 0] += np.arange(1 << 15) * 200 / (1 << 15)
    along = colors_of(noise, points)[:, 0]
    assert np.abs(np.diff(along)).max() < 0.25
    assert along.min() < 0.1 < 0.9 < along.max()
    centred = along - along.mean()
    spectrum = np.abs(np.fft.rfft(centred, 1 << 16)) ** 2
    correlation = np.fft.irfft(spectrum)[: 1 << 14] / (centred @ centred)
    assert correlation[200] < 0.35
    assert np.abs(correlation[400:]).max() < 0.35  # from 2.4 m on; a period would give about 1
    other = textures.Noise("noise", (0.0,) * 3, (1.0,) * 3, 0.5, 0.0, 4, 5)
    assert abs(np.corrcoef(along, colors_of(other, points)[:, 0])[0, 1]) < 0.2


@pytest.mark.parametrize("yaw_deg", [0, 90, 180, -90])
def test_a_picture_hangs_upright_and_is_not_mirrored(tmp_path, yaw_deg):
    """Seen from inside a room of pictures, each wall shows the file as it is, as wide as it says."""
    picture = np.random.default_rng(1).integers(0, 255, (30, 40, 3), np.uint8)
    cv2.imwrite(str(tmp_path / "wall.png"), picture[..., ::-1])
    walls = "{kind: image, file: wall.png, scale: 4}"
    room = f"room: {{floor: [[-2, -2], [2, -2], [2, 2], [-2, 2]], height: 3, walls: [{walls}]}}"
    (tmp_path / "room.yaml").write_text(room)
    a = np.radians(yaw_deg)
    ahead = np.array([np.cos(a), np.sin(a), 0])
    right = np.array([np.sin(a), -np.cos(a), 0])
    x, z = np.meshgrid((np.arange(40) + 0.5) / 10 - 2, 3 - (np.arange(30) + 0.5) / 10)
    directions = 2 * ahead + x[..., None] * right + (z[..., None] - 1.5) * (0, 0, 1)
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    hits = mock_server.load_scene(tmp_path / "room.yaml").trace((0, 0, 1.5), directions)
    picture = np.roll(picture, 20, axis=1)  # its lower left corner is at the origin, below the wall's middle
    shade = (hits.color / (picture / 255.0 + 1e-9))[picture > 50]
    np.testing.assert_allclose(shade, np.median(shade), rtol=1e-6)


def test_floor_and_ceiling_fill_an_angled_room_away_from_the_origin():
    """Rays down and up from its corners meet them at its heights; outside there is nothing."""
    corners = [[4, 5], [9, 5], [9, 7], [6, 7], [6, 11], [4, 11]]
    scene = Scene("it", {"sky": [*SKY], "room": {"floor": corners, "height": 2.5}})
    inside = np.array([[4.1, 5.1, 1], [8.9, 6.9, 1], [5.9, 10.9, 1], [4.1, 10.9, 1], [6.5, 6.9, 1]])
    down = scene.trace(inside, np.tile([0.0, 0, -1], (5, 1)))
    up = scene.trace(inside, np.tile([0.0, 0, 1], (5, 1)))
    np.testing.assert_allclose(down.distance, 1, rtol=EXACT)
    np.testing.assert_allclose(up.distance, 1.5, rtol=EXACT)
    assert len({*down.label} | {*up.label}) == 2
    outside = np.array([[7.0, 9, 1], [3.9, 6, 1], [0, 0, 1]])
    assert np.isinf(scene.trace(outside, np.tile([0.0, 0, -1], (3, 1))).distance).all()
