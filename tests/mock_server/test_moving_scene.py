"""Scenes that move: ``scene.at`` against scenes that are described where the objects have gone."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mock_server import Scene

RED = {"kind": "plain", "colors": [[0.8, 0.2, 0.1]]}
BOX = {"box": [0.6, 0.2, 0.4], "at": [2.0, 0.3, 0.1], "turn_deg": 15.0}
BALL = {"sphere": 0.25, "at": [2.1, 0.9, -0.2]}
WALL = {"solids": [{"box": [0.1, 8, 8], "at": [4, 0, 0]}]}
RAYS = np.random.default_rng(5).normal((4, 1, 0), (0.3, 2, 1), (500, 3))
times = st.floats(-50, 50)
offsets = st.tuples(*[st.floats(-1, 1)] * 3)
degrees = st.floats(-200, 200)


def scene(moving, *solids):
    thing = {"texture": RED, "solids": list(solids or (BOX, BALL))}
    thing |= {"moving": moving} if moving else {}
    return Scene("moving", {"objects": {"Thing": thing, "Wall": WALL}})


def carried(offset, turn_deg, about):
    """The scene of which the solids are described at another place, by complex numbers."""
    turn = np.exp(1j * np.radians(turn_deg))
    placed = []
    for solid in (BOX, BALL):
        x, y, z = solid["at"]
        place = (complex(x, y) - complex(*about)) * turn + complex(*about)
        at = [place.real + offset[0], place.imag + offset[1], z + offset[2]]
        turned = {"turn_deg": solid["turn_deg"] + turn_deg} if "box" in solid else {}
        placed.append(solid | {"at": at} | turned)
    return scene(None, *placed)


def assert_same(got, expected):
    """All but rays that graze an edge, which the last digit decides."""
    got, expected = got.trace((0, 0, 0), RAYS), expected.trace((0, 0, 0), RAYS)
    same = got.label == expected.label
    assert same.mean() > 0.98
    np.testing.assert_allclose(got.distance[same], expected.distance[same], rtol=1e-9)
    np.testing.assert_allclose(got.normal[same], expected.normal[same], atol=1e-6)
    np.testing.assert_allclose(got.color[same], expected.color[same], atol=1e-6)


@settings(max_examples=15)
@given(time=times, velocity=offsets, turn=degrees)
def test_steady(time, velocity, turn):
    moving = {"kind": "steady", "velocity": velocity, "turn_deg": turn, "about": [1.8, 0.5]}
    offset = [time * each / 50 for each in velocity]
    moving["velocity"] = [each / 50 for each in velocity]
    assert_same(scene(moving).at(time), carried(offset, turn * time, (1.8, 0.5)))


@settings(max_examples=15)
@given(time=times, by=offsets, turn=degrees, period=st.floats(0.1, 20))
def test_swing(time, by, turn, period):
    moving = {"kind": "swing", "by": by, "turn_deg": turn, "period_s": period, "about": [2, 0]}
    share = np.exp(2j * np.pi * time / period).imag
    assert_same(scene(moving).at(time), carried([share * each for each in by], share * turn, (2, 0)))


@pytest.mark.parametrize(
    ("time", "expected"),
    [(-7, (0.1, 0, 0, 10)), (1, (0.1, 0, 0, 10)), (1.5, (0.3, 0.25, -0.1, 55)), (2, (0.5, 0.5, -0.2, 100)),
     (3, (0.5, 0.0, 0.0, 50)), (4, (0.5, -0.5, 0.2, 0)), (90, (0.5, -0.5, 0.2, 0))],
)  # fmt: skip
def test_waypoints(time, expected):
    """The places by hand. The turn is about the middle of the object's box."""
    points = [[1, 0.1, 0, 0, 10], [2, 0.5, 0.5, -0.2, 100], [4, 0.5, -0.5, 0.2, 0]]
    moved = scene({"kind": "waypoints", "points": points})
    low, high = scene(None).bounds("Thing")
    middle = (low + high)[:2] / 2
    assert_same(moved.at(time), carried(expected[:3], expected[3], middle))
    place = moved.at(time).pose("Thing")[1]
    assert place == pytest.approx((low + high) / 2 + expected[:3], abs=1e-12)


@given(time=times, rounds=st.integers(-5, 5))
def test_waypoints_repeat_their_round(time, rounds):
    points = [[0.5, 0, 0, 0, 0], [1.5, 0.5, 0.5, -0.2, 90], [3, 0, 0, 0, 0]]
    once, again = (scene({"kind": "waypoints", "points": points, "repeat": r}) for r in (False, True))
    within = 0.5 + (time % 2.5)
    place = again.at(within + 2.5 * rounds).pose("Thing")
    for got, expected in zip(place, once.at(within).pose("Thing"), strict=True):
        assert got == pytest.approx(expected, abs=1e-9)


def test_poses_place_objects_whatever_the_time():
    """A quarter turn about Y, which no motion makes: the box's length stands upright."""
    R = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    moving = scene({"kind": "steady", "velocity": [1, 0, 0]}, BOX | {"turn_deg": 0.0})
    placed = moving.at(3.0, {"Thing": (R, (1.0, 0.5, 0.2))})
    low, high = placed.bounds("Thing")
    assert low == pytest.approx((0.8, 0.4, -0.1))
    assert high == pytest.approx((1.2, 0.6, 0.5))
    assert [each.tolist() for each in placed.pose("Thing")] == [R.tolist(), [1.0, 0.5, 0.2]]
    assert moving.at(3.0).pose("Thing")[1] == pytest.approx((5.0, 0.3, 0.1))
    assert placed.at(0.0).bounds("Thing")[0] == pytest.approx((1.7, 0.2, -0.1))


def test_textures_move_with_their_objects():
    """Rays that are moved as the object is meet the same black and white, which no shading changes."""
    checker = {"kind": "checker", "colors": [[0, 0, 0], [1, 1, 1]], "scale": 0.07}
    solids = [{"box": [0.6, 0.8, 0.4], "at": [2, 0, 0.2]}, {"sphere": 0.3, "at": [2.2, 0.5, 0.4]}]
    moving = {"kind": "steady", "velocity": [0.1, -0.2, 0.3], "turn_deg": 70, "about": [1, 2]}
    world = Scene("checker", {"objects": {"Thing": {"texture": checker, "solids": solids, "moving": moving}}})
    R, place = world.at(1.3).pose("Thing")
    middle = world.pose("Thing")[1]
    still = world.trace((0.1, 0, 0), RAYS)
    moved = world.at(1.3).trace(R @ (np.array([0.1, 0, 0]) - middle) + place, RAYS @ R.T)
    seen = still.label == 1
    white = still.color[seen, 0] > 0
    assert 0.2 < white.mean() < 0.8
    assert np.array_equal(white, moved.color[seen, 0] > 0)


def test_a_pose_of_no_object_is_refused():
    with pytest.raises(ValueError, match=r"object: expected one of Thing, Wall; got 'Thin'"):
        scene(None).at(0.0, {"Thin": (np.eye(3), (0, 0, 0))})


GOOD = {"kind": "waypoints", "points": [[0, 0, 0, 0, 0], [1, 0, 0, 0, 0]]}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "fly"}, "kind: expected one of steady, swing, waypoints; got 'fly'"),
        ({"period_s": 2}, "unknown key 'period_s'; known keys: about, kind, points, repeat"),
        ({"points": [[0, 0, 0, 0, 0]]}, "points: expected a list of at least 2, got"),
        ({"points": [[1, 0, 0, 0, 0]] * 2}, "points: expected [time, x, y, z, turn] with times that grow"),
        ({"repeat": 1}, "repeat: expected true or false, got 1"),
    ],
)
def test_wrong_motions_are_refused(change, message):
    with pytest.raises(ValueError) as refused:
        scene(GOOD | change)
    assert f"moving: Thing: moving: {message}" in str(refused.value)
