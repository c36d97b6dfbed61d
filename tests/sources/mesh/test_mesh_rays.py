"""Rays through meshes meet what float64 says of every triangle, one by one."""

import numpy as np
import pytest
import trimesh
from support.meshes import Truth, directions, write_room

import omniscv
from omniscv.sources.mesh.tracing import JoinedTracers, Tracer

ROUNDED_M = 1e-6
"""GLB files hold float32: half a digit of 3 m is 1.2e-7 m, and more along grazing rays."""


def tracer(corners, one_sided=False):
    faces = np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3)
    return Tracer(corners.reshape(-1, 3), faces, np.full(len(corners), one_sided))


def dented_ball(radius_m=2.0):
    ball = trimesh.creation.icosphere(subdivisions=4, radius=radius_m)
    ball.vertices *= (1 + 0.05 * np.sin(7 * ball.vertices).sum(axis=1))[:, None]
    return ball


def test_a_room_is_traced_as_by_all_its_triangles(tmp_path):
    truth = write_room(tmp_path / "room.glb")
    rays = directions(20000)
    center_w = np.array([0.1, 0.2, 1.5])
    with omniscv.open_source(f"mesh://{tmp_path / 'room.glb'}") as source:
        hits = source.trace(center_w, rays)
    distance, label, first = truth.trace(center_w, rays)
    a, b, c = truth.corners[first].swapaxes(0, 1)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    normal *= -np.sign((normal * rays).sum(axis=1, keepdims=True))
    np.testing.assert_array_equal(hits.label, label)
    np.testing.assert_allclose(hits.distance, distance, atol=ROUNDED_M)
    np.testing.assert_allclose(hits.normal, normal, atol=1e-5)  # of facets of the ball in float32


@pytest.mark.parametrize("offset_m", [0.0, 500000.0], ids=["at the origin", "at coordinates of a map"])
def test_no_ray_leaves_a_closed_surface(offset_m):
    """At its corners and the middles of its edges, neither: rounding decides which face, not whether."""
    ball = dented_ball()
    shift = np.array([offset_m, 9 * offset_m, 0.0])
    corners = ball.triangles + shift
    ends = np.concatenate([ball.vertices, ball.vertices[ball.edges_unique].mean(axis=1)])
    for center in ([0.0, 0.0, 0.0], [0.3, -0.2, 0.1]):
        rays = np.concatenate([ends - center, directions(200000)])
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        hits = tracer(corners).trace(np.array(center) + shift, rays)
        assert np.isfinite(hits.distance).all()


def test_far_away_the_same_faces_are_met_as_at_the_origin():
    """Coordinates of a map have 1e-9 m digits in float64: so far are distances off, no more."""
    ball = dented_ball()
    shift = np.array([500000.0, 4500000.0, 0.0])
    rays = directions(5000)
    near = tracer(ball.triangles).trace(np.zeros(3), rays)
    far = tracer(ball.triangles + shift).trace(shift, rays)
    np.testing.assert_allclose(far.distance, near.distance, atol=1e-8)
    assert (far.face != near.face).mean() < 1e-3  # at edges


@pytest.mark.parametrize("away_m", [0.0, 1.5, 50.0, 1e5], ids=str)
def test_rays_from_anywhere_meet_what_all_triangles_say(away_m):
    """Random triangles of all sizes, slivers among them, across each other."""
    rng = np.random.default_rng(5)
    corners = rng.normal(size=(400, 1, 3)) + rng.normal(size=(400, 3, 3)) * rng.choice(
        [0.02, 0.3, 2], (400, 1, 1)
    )
    corners[:40, 2] = corners[:40, 1] + 1e-4 * rng.normal(size=(40, 3))
    origins = away_m * directions(30000, 1)
    rays = rng.normal(size=(30000, 3)) - origins
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    hits = tracer(corners).trace(origins, rays)
    distance, label, _ = Truth(corners, 1 + np.arange(400)).trace(origins, rays)
    np.testing.assert_array_equal(hits.face, label - 1)
    seen = np.isfinite(distance)
    # Rounding of the distance itself, and of the plane that a sliver spans:
    np.testing.assert_allclose(hits.distance[seen], distance[seen], rtol=1e-13, atol=1e-9)


def test_one_sided_faces_are_passed_from_behind_even_where_another_lies_on_them():
    """Two sheets in one place, back to back and cut along other diagonals: each side shows its own."""
    p, q, r, s = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]])
    upper = [[p, q, r], [p, r, s]]
    lower = [[q, p, s], [q, s, r]]
    sheets = tracer(np.array([*upper, *lower]), one_sided=True)
    rng = np.random.default_rng(0)
    places = np.column_stack([rng.uniform(-0.9, 0.9, (5000, 2)), np.zeros(5000)])
    for height, faces in ((3.0, (0, 1)), (-3.0, (2, 3))):
        origin = np.array([0.1, 0.2, height])
        rays = places - origin
        lengths = np.linalg.norm(rays, axis=1)
        hits = sheets.trace(origin, rays / lengths[:, None])
        assert np.isin(hits.face, faces).all()
        np.testing.assert_allclose(hits.distance, lengths, rtol=1e-14)


def test_what_lies_behind_follows_in_order_equal_distances_included():
    """Of two tracers that are joined: what lies at one distance is of both."""
    corners = np.array([[[-1, -1, z], [1, -1, z], [0, 1, z]] for z in (1.0, 1.0, 2.0, 3.0, 3.0)])
    even = np.array([0, 2, 4], np.int32)
    odd = np.array([1, 3], np.int32)
    pile = JoinedTracers([tracer(corners[even]), tracer(corners[odd])], [even, odd], 5)
    rays = np.array([[0.0, 0.0, 1.0]])
    met = [pile.trace(np.zeros(3), rays)]
    for _ in range(5):
        met.append(pile.beyond(np.zeros((1, 3)), rays, met[-1]))
    assert [hits.distance[0] for hits in met] == [1, 1, 2, 3, 3, np.inf]
    assert {hits.face[0] for hits in met[:5]} == {0, 1, 2, 3, 4}
