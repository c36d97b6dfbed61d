"""Scenes that move, against scenes described where objects have gone; a world that moves, over the wire."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.expected_views import npy, seen_by_hand

import mock_server
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
    got = got.trace((0, 0, 0), RAYS)
    expected = expected.trace((0, 0, 0), RAYS)
    same = got.label == expected.label
    assert same.mean() > 0.98
    np.testing.assert_allclose(got.distance[same], expected.distance[same], rtol=1e-9)
    np.testing.assert_allclose(got.normal[same], expected.normal[same], atol=1e-6)
    np.testing.assert_allclose(got.color[same], expected.color[same], atol=1e-6)


@settings(max_examples=15)
@given(time=times, by=offsets, turn=degrees, period=st.floats(0.1, 20))
def test_steady_and_swinging(time, by, turn, period):
    steady = {"kind": "steady", "velocity": [each / 50 for each in by], "turn_deg": turn, "about": [1.8, 0.5]}
    assert_same(scene(steady).at(time), carried([time / 50 * each for each in by], turn * time, (1.8, 0.5)))
    swing = {"kind": "swing", "by": by, "turn_deg": turn, "period_s": period, "about": [2, 0]}
    share = np.exp(2j * np.pi * time / period).imag
    assert_same(scene(swing).at(time), carried([share * each for each in by], share * turn, (2, 0)))


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
    with pytest.raises(ValueError, match=r"object: expected one of Thing, Wall; got 'Thin'"):
        moving.at(0.0, {"Thin": (R, (0, 0, 0))})


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


GOOD = {"kind": "waypoints", "points": [[0, 0, 0, 0, 0], [1, 0, 0, 0, 0]]}


def test_wrong_motions_are_refused():
    for change, message in (
        ({"kind": "fly"}, "kind: expected one of steady, swing, waypoints; got 'fly'"),
        ({"period_s": 2}, "unknown key 'period_s'; known keys: about, kind, points, repeat"),
        ({"points": [[0, 0, 0, 0, 0]]}, "points: expected a list of at least 2, got"),
        ({"points": [[1, 0, 0, 0, 0]] * 2}, "points: expected [time, x, y, z, turn] with times that grow"),
        ({"repeat": 1}, "repeat: expected true or false, got 1"),
    ):
        with pytest.raises(ValueError) as refused:
            scene(GOOD | change)
        assert f"moving: Thing: moving: {message}" in str(refused.value)


SIZE = (20, 16)
STEP = 0.05
CENTER = (0, 0, 130)
MODERN = ("M", "N1", "N2", "N3")
SCENE = mock_server.load_scene("workshop")


@pytest.fixture
def world(start, open_raw):
    """Starts a server whose frames end with requests only, and a client with a camera over the origin."""

    def start_one(dialect, **options):
        settings = {"size": SIZE, "frames_per_s": 1e-3, "time_step_s": STEP, "depth": "float32"}
        server = start("workshop", dialect=dialect, **settings | options)
        client = open_raw(server)
        client.camera = 0 if dialect == "L" else 1
        if dialect != "L":
            client.ask("vset /cameras/spawn")
        client.ask(f"vset /camera/{client.camera}/location 0 0 130")
        return server, client

    return start_one


def next_time(server):
    """The time of the next frame: one has passed for each request that was answered."""
    return STEP * server.statistics.total("")


def look(client, rotation=(0, 0, 0)):
    client.ask("vset /camera/{}/rotation {} {} {}".format(client.camera, *rotation))
    if client.camera == 0:
        client.settle()


def depth(client):
    """Depth as it comes, in metres: along the ray of dialect L, planar of the others."""
    pixels = npy(client.ask(f"vget /camera/{client.camera}/depth npy"))
    return pixels if client.camera == 0 else pixels / 100


def shows(client, image, scene, rotation=(0, 0, 0)):
    """Whether an image is that of a scene, but for a pixel on an edge."""
    hits, planar = seen_by_hand(scene, CENTER, rotation, 90, *SIZE)
    return (np.abs(image - (hits.distance if client.camera == 0 else planar)) < 1e-4).mean() > 0.98


def crate(scene):
    """Where the protocol says that the crate is, cm: its box's middle, Y to the right."""
    (x0, y0, z0), (x1, y1, z1) = scene.bounds("Crate")
    return [50 * (x0 + x1), -50 * (y0 + y1), 50 * (z0 + z1)]


def place_of(client, name="Crate"):
    return [float(each) for each in client.text(f"vget /object/{name}/location").split()]


@pytest.mark.parametrize("dialect", ["L", *MODERN])
def test_the_clock_advances_by_a_step_in_each_frame_and_captures_show_its_time(world, dialect):
    """Images of L show the last frame that was finished while the next is being rendered."""
    server, client = world(dialect)
    look(client, (0, 60, 0))
    late = STEP if dialect == "L" else 0
    for _ in range(4):
        now = next_time(server) - late
        image = depth(client)
        assert shows(client, image, SCENE.at(now), (0, 60, 0))
        assert not shows(client, image, SCENE.at(now + 4 * STEP), (0, 60, 0))


@pytest.mark.parametrize("dialect", ["L", "N3"])
def test_slow_motion(world, dialect):
    """The engine's slowest is a ten-thousandth. The tick after a reply may not have come yet."""
    server, client = world(dialect)
    for factor, slowed in (("0.1", 0.1), ("0", 1e-4), ("1.0", 1.0)):
        client.ask(f"vrun slomo {factor}")
        client.settle()
        before = server.world.time_s
        client.settle()
        assert round((server.world.time_s - before) / (slowed * STEP), 6) in (2, 3, 4)


def test_the_camera_of_l_follows_its_pawn_while_paused_and_its_rotation_is_not_limited(world):
    _, client = world("L")
    client.ask("vset /action/game/pause")
    look(client, (-90, 0, 0))
    assert client.text("vget /camera/0/rotation") == "-90.000 0.000 0.000"
    floor = depth(client)[SIZE[1] // 2 - 1 : SIZE[1] // 2 + 1]
    assert np.ptp(floor, axis=0).max() < 1e-4
    client.ask("vset /action/game/pause")
    client.settle()
    assert client.text("vget /camera/0/rotation") == "270.100 0.000 0.000"


@pytest.mark.parametrize("dialect", ["L", *MODERN])
def test_a_moving_object_stays_where_it_is_put_until_the_clock_goes_on(world, dialect):
    server, client = world(dialect)
    client.ask("vset /action/game/pause")
    assert client.text("vset /object/Crate/location 150.0 -20.0 130.0") == "ok"
    assert client.text("vset /object/Crate/rotation 0 30.0 0") == "ok"
    look(client)
    c = np.cos(np.radians(-30))
    s = np.sin(np.radians(-30))
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    placed = SCENE.at(server.world.time_s, {"Crate": (R, (1.5, 0.2, 1.3))})
    assert shows(client, depth(client), placed)
    assert place_of(client) == [150, -20, 130]
    client.ask("vset /action/game/pause" if dialect == "L" else "vset /action/game/resume")
    client.settle()
    before = server.world.time_s
    x = place_of(client)[0]
    assert crate(SCENE.at(before + STEP))[0] - 0.01 <= x <= crate(SCENE.at(before - STEP))[0] + 0.01


def batch(client, count):
    """Images of one camera in one frame, after a frame for the announcement."""
    client.send(b"1:vbatch %d" % count)
    assert client.frame() == b"1:ok"
    client.send(*(b"%d:vget /camera/1/depth npy" % (2 + k) for k in range(count)))
    return [npy(client.frame().partition(b":")[2]) for _ in range(count)]


def test_a_tick_in_the_middle_of_a_batch(world):
    server, client = world("N2", time_step_s=0.5, faults=["torn@0.5"], seed=2)
    client.ask("vset /camera/1/rotation 0 60 0")
    images = batch(client, 8)
    changes = [not np.array_equal(a, b) for a, b in itertools.pairwise(images)]
    assert 0 < sum(changes) < 7
    assert server.faults.struck["torn"] == pytest.approx(sum(changes), abs=1)
    client.ask("vset /action/game/pause")
    first, *others = batch(client, 8)
    assert all(np.array_equal(first, each) for each in others)
