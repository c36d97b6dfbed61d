"""A world that moves, over the wire: the clock, its pause in each dialect, and what captures show of it."""

import itertools
import time

import numpy as np
import pytest
from support.expected_views import npy, seen_by_hand

import mock_server

SIZE, STEP = (20, 16), 0.05
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


# The clock


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


def test_frames_end_by_themselves(start, open_raw):
    server = start("workshop", frames_per_s=1000, time_step_s=0.25, size=(8, 8))
    open_raw(server)
    while server.world.time_s < 1:  # else the suite's time limit is over
        time.sleep(0.001)


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


# Pause


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


# Objects that move


@pytest.mark.parametrize("dialect", ["L", *MODERN])
def test_a_moving_object_stays_where_it_is_put_until_the_clock_goes_on(world, dialect):
    server, client = world(dialect)
    client.ask("vset /action/game/pause")
    assert client.text("vset /object/Crate/location 150.0 -20.0 130.0") == "ok"
    assert client.text("vset /object/Crate/rotation 0 30.0 0") == "ok"
    look(client)
    c, s = np.cos(np.radians(-30)), np.sin(np.radians(-30))
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


# Faults


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
