"""The edges of a room from one non-central image, and lines in space from the rays of one image."""

from functools import cache

import numpy as np
import pytest
from scipy.optimize import minimize
from support.rooms import room_of_scene
from support.traced_frames import traced

import mock_server
import omniscv
from omniscv.errors import ArgumentError
from omniscv.evaluate import Settings, run
from omniscv.evaluate import lines as lines
from omniscv.evaluate.lines import boundary, reconstruction, room_edges, seen_edges
from omniscv.evaluate.lines.reconstruction import ObservedLine, effective_baseline, free_line


def test_boundaries_lie_between_the_pixels_of_two_labels():
    labels = np.array([[1, 1, 2, 2], [1, 3, 3, 2], [1, 1, 1, 2]], np.uint16)
    assert sorted(map(tuple, boundary(labels, 1, 2))) == [(2.0, 0.5), (3.0, 2.5)]
    assert sorted(map(tuple, boundary(labels, 3, 1))) == [(1.0, 1.5), (1.5, 1.0), (1.5, 2.0), (2.5, 2.0)]
    assert len(boundary(labels, 1, 4)) == 0


def test_edges_of_sufficient_baseline_are_near_the_truth():
    """Of the paper's panorama, half as fine, by its exact labels: vertical ones within 3 cm, unless free;
    horizontal ones within 2 degrees and 10 cm. Every edge is seen, and priors reduce the errors."""
    camera = omniscv.cameras.create("noncentral-panorama", width=1024, height=512, radius=1.0)
    shot = lines.Setup("panorama-1", camera, omniscv.Pose.from_angles((0, 0, 1.5), 20, 10, 0))
    with omniscv.open_source("scene://four-wall") as source:
        room = source.geometry().room
        names = source.objects().names()
    labels = traced(mock_server.load_scene("four-wall"), shot.camera, shot.pose)["labels"]
    seen = seen_edges(room, shot.camera, labels, names)
    for edge, observed in seen:
        assert observed.rms_px(edge.line_c(shot.pose)) <= 0.75, edge
    rows = list(lines.score(seen, lines.reconstruct(seen, shot), shot))
    median = {}
    for prior in ("free", "gravity", "Manhattan"):
        own = [row for row in rows if row["prior"] == prior]
        kinds = {kind: [row for row in own if row["kind"] == kind] for kind in ("vertical", "horizontal")}
        assert {kind: len(mine) for kind, mine in kinds.items()} == {"vertical": 4, "horizontal": 8}
        vertical = [row for row in kinds["vertical"] if row["baseline_m"] >= 0.05]
        assert len(vertical) == 2
        assert prior == "free" or max(row["distance_m"] for row in vertical) <= 0.03
        horizontal = [row for row in kinds["horizontal"] if row["baseline_m"] >= 0.4]
        assert len(horizontal) >= 2
        assert max(row["distance_m"] for row in horizontal) <= 0.1
        assert max(row["direction_deg"] for row in horizontal) <= 2
        median[prior] = np.median([row["distance_m"] for row in own])
    assert median["Manhattan"] <= median["gravity"] < 0.5 * median["free"]


@pytest.mark.parametrize("scene", ["four-wall", "six-wall"])
def test_exact_points_of_the_rooms_edges_give_them_exactly(scene):
    room = room_of_scene(scene)
    panorama = omniscv.cameras.create("noncentral-panorama", 2048, 1024, radius=1.0)
    cone = omniscv.cameras.create("noncentral-conical-mirror", 1024, 1024, half_angle_deg=55, distance=0.5)
    for camera, *angles in ((panorama, 20, 10, 0), (panorama, 130, 8, -6), (cone, 20, 80, 0)):
        shot = lines.Setup("", camera, omniscv.Pose.from_angles((0, 0, 1.2), *angles))
        distances = [off for baseline, off in lines.exact_errors(room, shot) if baseline >= 0.05]
        assert len(distances) >= 2
        assert max(distances) <= 1e-9


def test_edges_of_an_l_shaped_room_go_once_around():
    edges = list(room_edges(room_of_scene("six-wall")))
    assert [edge.kind for edge in edges].count("vertical") == 6
    assert len({edge.surfaces for edge in edges}) == len(edges) == 18
    ends = np.array([edge.ends_w for edge in edges]).reshape(-1, 3)
    corners, times = np.unique(np.round(ends, 9), axis=0, return_counts=True)
    assert len(corners) == 12
    assert set(times.tolist()) == {3}


def test_a_source_without_a_room_is_refused(tmp_path):
    with pytest.raises(ArgumentError, match="source: expected one with a known room, got none"):
        run("lines", Settings(tmp_path, quick=True, source="scene://direction"))


PANORAMA = omniscv.cameras.create("noncentral-panorama", width=2048, height=1024, radius=1.0)
MIRROR = {"width": 1024, "height": 1024, "distance": 0.5}
CONE = omniscv.cameras.create("noncentral-conical-mirror", **MIRROR, half_angle_deg=55)
BALL = omniscv.cameras.create("noncentral-spherical-mirror", **MIRROR, mirror_radius=0.5)
CAMERAS = {"panorama": (PANORAMA, (0, 1.0, 0)), "cone": (CONE, (0, 0, 1.0)), "ball": (BALL, (0, 0, 1.0))}
GRAVITY = np.array([0.0, np.cos(0.17), np.sin(0.17)])  # a panorama tilted by 10 degrees


@cache
def seen_lines(name, count, wanted=3):
    """Lines (6,), their points (N, 3) and their pixels in an image, of 5 cm of baseline or more."""
    camera, _ = CAMERAS[name]
    rng = np.random.default_rng(3)
    lines = []
    while len(lines) < wanted:
        rays = camera.unproject(rng.uniform(0, (camera.width, camera.height), (2, 2)))
        a, b = rays.origins + rng.uniform(1, 4, (2, 1)) * rays.directions
        points = a + np.linspace(0, 1, count)[:, None] * (b - a)
        pixels, valid = camera.project(points)
        observed = ObservedLine(camera, pixels) if valid.all() else None
        if observed and len(observed.pixels) == count:
            normal = np.cross(observed.directions[0], b - a) / np.linalg.norm(b - a)
            many = effective_baseline(observed.origins, observed.directions)
            if (many if count > 2 else abs(np.diff(observed.origins @ normal)[0])) >= 0.05:
                lines.append((reconstruction.through(a, b - a), points, observed))
    return lines


def off(line, points):
    """The greatest distance of points from a line, as a search along it finds it."""
    middle = np.cross(line[:3], line[3:])
    away = points - middle
    return np.linalg.norm(away - np.outer(away @ line[:3], line[:3]), axis=1).max()


@pytest.mark.parametrize("name", CAMERAS)
def test_exact_rays_give_the_exact_line(name):
    """Four rays or forty, two of a known direction; the axis, which all rays meet, is never the answer."""
    axis = np.array(CAMERAS[name][1])
    for line, points, observed in seen_lines(name, 4) + seen_lines(name, 40):
        assert np.abs(observed.rows[:, :3] @ axis).max() <= 1e-12
        free = free_line(observed.rows, axis)
        assert off(free, points) <= 1e-9
        assert reconstruction.angle_deg(free[:3], line[:3]) <= 1e-7
        assert off(observed.refine(free, np.linalg.svd(free[None, :3])[2][1:]), points) <= 1e-9
    for line, points, observed in seen_lines(name, 2):
        assert off(reconstruction.line_along(observed.rows, line[:3]), points) <= 1e-9
    for i, (line, points, observed) in enumerate(seen_lines(name, 40)):
        gravity = np.cross(line[:3], np.random.default_rng(i).normal(size=3))
        gravity /= np.linalg.norm(gravity)
        level = reconstruction.level_line(observed.rows, gravity)
        assert off(level, points) <= 1e-9
        assert abs(level[:3] @ gravity) <= 1e-9


def test_a_line_meets_its_rays_and_points_are_nearest():
    rng = np.random.default_rng(5)
    line = reconstruction.through(rng.normal(size=3), rng.normal(size=3))
    origins, directions = rng.normal(size=(2, 6, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = reconstruction.nearest_to_rays(line, origins, directions)
    assert reconstruction.distance_to(line, points) == pytest.approx(0, abs=1e-12)
    base = np.cross(line[:3], line[3:])
    assert reconstruction.distance_to(line, base[None]) == pytest.approx(0, abs=1e-12)
    for point, origin, direction in zip(points, origins, directions, strict=True):

        def gap(x, o=origin, d=direction):
            return ((base + x[0] * line[:3] - o - x[1] * d) ** 2).sum()

        best = minimize(gap, (0, 0), tol=1e-14).x[0]
        assert point == pytest.approx(base + best * line[:3], abs=1e-5)
        row = reconstruction.incidence(point - 2 * direction, direction)
        assert row @ line == pytest.approx(0, abs=1e-12)


def test_a_central_camera_has_no_effective_baseline():
    camera = omniscv.cameras.create("equirectangular", width=512, height=256)
    points = np.array([1.0, 2, 3]) + np.linspace(0, 1, 30)[:, None] * [2, -1, 0.5]
    rays = camera.unproject(camera.project(points)[0])
    assert effective_baseline(rays.origins, rays.directions) == 0
    shifted = rays.origins + np.cross(*points[:2])[None] / np.linalg.norm(np.cross(*points[:2])) * 0.3
    shifted[::2] = 0
    assert effective_baseline(shifted, rays.directions) == pytest.approx(0.3, abs=1e-9)


def noisy(start, end, seed, px=0.5, count=300):
    pixels, valid = PANORAMA.project(np.linspace(start, end, count))
    assert valid.all()
    return ObservedLine(PANORAMA, pixels + np.random.default_rng(seed).normal(scale=px, size=(count, 2)))


WIDE = np.array([-2.0, 0.9, 2.5]), np.array([2.2, 0.4, 2.4])


def test_refinement_and_priors_each_bring_the_line_nearer():
    """Of a wide edge and half a pixel of noise; the bounds are those of the published figures for it."""
    gravity = np.cross(WIDE[1] - WIDE[0], [0, 0, 1.0])
    gravity /= np.linalg.norm(gravity)
    direction = (WIDE[1] - WIDE[0]) / np.linalg.norm(WIDE[1] - WIDE[0])
    errors = []
    for seed in range(5):
        observed = noisy(*WIDE, seed)
        algebraic = free_line(observed.rows, np.array([0, 1.0, 0]))
        free = reconstruction.free(observed, np.array([0, 1.0, 0]))
        level = reconstruction.with_gravity(observed, gravity)
        known = reconstruction.along(observed, direction)
        errors.append([off(line, np.array(WIDE)) for line in (algebraic, free, level, known)])
    algebraic, free, level, known = np.median(errors, axis=0)
    assert free < algebraic
    assert free <= 0.12
    assert level <= 0.05
    assert known <= 0.03


def test_distances_in_pixels_are_those_from_the_projected_line():
    observed = noisy(*WIDE, 7)
    line = reconstruction.through(WIDE[0], WIDE[1] - WIDE[0])
    along = 0.02 * (WIDE[1] - WIDE[0])
    curve, _ = PANORAMA.project(np.linspace(WIDE[0] - along, WIDE[1] + along, 8_000))
    gaps = np.linalg.norm(observed.pixels[:, None] - curve, axis=-1).min(axis=1)
    assert np.abs(observed.distances_px(line)) == pytest.approx(gaps, abs=0.03)
    assert observed.rms_px(line) == pytest.approx(0.5, rel=0.1)


def test_a_rooms_directions_come_from_its_level_lines():
    foot = np.array([1.5, 1.0, 2.6])
    upright = reconstruction.with_gravity(noisy(foot, foot - 1.8 * GRAVITY, 1, px=0.2), GRAVITY)
    assert reconstruction.angle_deg(upright[:3], -GRAVITY) <= 1e-9
    x = np.cross(GRAVITY, [0.2, 0.1, 1.0])
    x /= np.linalg.norm(x)
    y = np.cross(GRAVITY, x)
    corner = -1.0 * GRAVITY - 2.0 * x - 2.0 * y
    ends = [(corner, corner + 4 * x), (corner, corner + 4 * y), (corner + 4 * y, corner + 4 * x + 4 * y)]
    observed = [noisy(*segment, seed, px=0.3) for seed, segment in enumerate(ends)]
    level = [reconstruction.with_gravity(line, GRAVITY) for line in observed]
    assert [reconstruction.angle_deg(line[:3], GRAVITY) for line in level] == pytest.approx([90] * 3)
    aligned = reconstruction.manhattan(observed, level, GRAVITY)
    assert reconstruction.angle_deg(aligned[0][:3], aligned[1][:3]) == pytest.approx(90)
    assert reconstruction.angle_deg(aligned[0][:3], aligned[2][:3]) == pytest.approx(0, abs=1e-5)
    for line, direction, points in zip(aligned, (x, y, x), ends, strict=True):
        assert reconstruction.angle_deg(line[:3], direction) <= 0.1
        assert off(line, np.array(points)) <= 0.03
