"""Every fault that the server can inject, observed from the other end of a socket."""

import contextlib
import io
import itertools
import re
import socket
import time

import cv2
import numpy as np
import pytest

import mock_server
from mock_server import faults
from mock_server.__main__ import main

IMAGE = "vget /camera/0/lit png"
DEPTH = "vget /camera/0/depth npy"
MASK = "vget /camera/0/object_mask png"
UP = "vset /camera/1/rotation 90 0 0"


@pytest.fixture
def faulty(start, open_raw):
    """A raw client of a server with faults, small pictures and a spawned camera 1 as asked for."""

    def connect(*texts, scene="four-wall", **options):
        return open_raw(start(scene, faults=texts, size=(24, 24), **options))

    return connect


@pytest.fixture
def sound(faulty):
    """A raw client of the same server without faults."""
    return faulty()


def pixels(payload):
    return cv2.cvtColor(cv2.imdecode(np.frombuffer(payload, np.uint8), cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)


def array(payload):
    return np.load(io.BytesIO(payload), allow_pickle=False)


def squared_radius():
    """(24, 24) from the middle of a picture, 1 in its corners."""
    x = (np.arange(24) + 0.5) / 12 - 1
    return (x[None, :] ** 2 + x[:, None] ** 2) / 2


def test_the_help_lists_every_fault(capsys):
    assert main(["--help"]) == 0
    listed = re.findall(
        r"^  ([a-z-]+)  +\S", capsys.readouterr().out.partition("\nfaults:\n")[2], re.MULTILINE
    )
    assert listed == list(faults.KINDS)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("wrong", "expected one of delay, drip"),
        ("delay=soon", "fault delay: expected a number from 0 to 3600, got 'soon'"),
        ("delay@2", "probability: expected a number from 0 to 1, got '2'"),
        ("cut=1.5", "expected a number from 0 to 1"),
        ("missing=1", "expected no value"),
        ("vignette@0.5", "expected no probability"),
        ("object-missing=Elephant", "expected one of Ball"),
        ("glass=Elephant", "expected one of Ball"),
        ("gloss=Elephant", "expected one of Ball"),
        ("tone=sepia", "expected one of srgb, film, linear; got 'sepia'"),
    ],
)
def test_a_fault_that_is_none_is_refused_with_what_was_expected(text, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        mock_server.serve("four-wall", faults=[text])


def test_the_same_seed_draws_the_same_faults_whatever_else_is_on():
    def draws(texts, seed):
        drawn = faults.Faults(texts, seed)
        return [drawn.strike("missing") is not None for _ in range(200)]

    alone = draws(["missing@0.3"], 5)
    assert alone == draws(["delay@0.5", "missing@0.3"], 5)
    assert alone != draws(["missing@0.3"], 6)
    assert 40 <= sum(alone) <= 80  # 60 expected; the seed makes it the same every time


def test_a_server_without_faults_injects_none(sound, start):
    assert sound.ask(IMAGE)[:4] == b"\x89PNG"
    assert not start().faults


def test_strikes_are_counted(start, open_raw):
    server = start(faults=["clicked@0.5"], seed=1)
    client = open_raw(server)
    frames = []
    for number in range(20):
        client.send(b"%d:vget /viewmode" % number)
    while frames.count(b"clicked") + 20 > len(frames):
        frames.append(client.frame())
    assert frames.count(b"clicked") == server.faults.struck["clicked"] > 0


def test_faults_come_and_go_while_the_server_runs(start, open_raw):
    server = start()
    client = open_raw(server)
    for change, reply in (
        (lambda: None, b"7:lit"),
        (lambda: server.faults.start("no-id"), b"lit"),
        (lambda: server.faults.stop("no-id"), b"7:lit"),
    ):
        change()
        client.send(b"7:vget /viewmode")
        assert client.frame() == reply
    with pytest.raises(ValueError, match="expected when the server starts"):
        server.faults.start("vignette")


# Faults of the line: requests are sent, and bytes read, as they are. Times are lower bounds.

VIEWMODE, LIT = b"7:vget /viewmode", b"7:lit"
MAGIC = b"\xc1\x83\x2b\x9e"


@pytest.mark.parametrize(
    ("fault", "received"),
    [
        ("wrong-id", MAGIC + b"\x05\0\0\x008:lit"),
        ("no-id", MAGIC + b"\x03\0\0\0lit"),
        ("clicked", MAGIC + b"\x07\0\0\0clicked" + MAGIC + b"\x05\0\0\0" + LIT),
        ("bad-magic", b"\xc0\x83\x2b\x9e\x05\0\0\0"),
        ("zero-size", MAGIC + b"\0\0\0\0"),
        ("huge", MAGIC + b"\xff\xff\xff\xff"),
    ],
)
def test_bytes_of_a_reply(faulty, fault, received):
    client = faulty(fault)
    client.send(VIEWMODE)
    assert client.bytes(len(received)) == received


@pytest.mark.parametrize(("fault", "least_s"), [("delay=0.3", 0.3), ("drip=0.3", 0.25)])
def test_all_bytes_come_late(faulty, sound, fault, least_s):
    """The first of 50 pieces of a drip needs no wait before others."""
    client = faulty(fault)
    began = time.monotonic()
    assert client.ask(IMAGE) == sound.ask(IMAGE)
    assert time.monotonic() - began >= least_s


def test_missing_leaves_the_others_in_order(faulty):
    client = faulty("missing@0.5", seed=4)
    for number in range(20):
        client.send(b"%d:vget /viewmode" % number)
    came = []
    client.socket.settimeout(0.5)
    with contextlib.suppress(TimeoutError):
        while True:
            came.append(int(client.frame().partition(b":")[0]))
    assert 0 < len(came) < 20
    assert came == sorted(came)


def test_cut_lets_the_next_frame_follow_in_its_midst(faulty, sound):
    client = faulty("cut=0.6")
    whole = b"7:" + sound.ask(DEPTH)
    client.send(b"7:" + DEPTH.encode(), b"7:" + DEPTH.encode())
    payload = client.frame()
    assert len(payload) == len(whole)
    kept = int(0.6 * len(whole))
    assert payload[:kept] == whole[:kept]
    assert payload[kept : kept + 4] == MAGIC
    assert payload[kept + 8 :] == whole[: len(whole) - kept - 8]


def test_a_reset_comes_in_the_middle_of_a_reply_and_the_next_client_is_served(start, open_raw):
    server = start(faults=["reset"])
    for _ in range(3):
        client = open_raw(server)
        assert client.greeting == b"connected to four-wall"
        client.send(VIEWMODE)
        with pytest.raises(ConnectionResetError):
            client.frame()


def test_no_greeting_but_answers(start):
    server = start(faults=["no-greeting"])
    with socket.create_connection((server.host, server.port), timeout=0.3) as client:
        with pytest.raises(TimeoutError):
            client.recv(1)
        client.settimeout(20)
        client.sendall(MAGIC + b"\x10\0\0\0" + VIEWMODE)
        assert client.recv(100) == MAGIC + b"\x05\0\0\0" + LIT


def test_second_client_is_greeted_when_the_first_has_left(start, open_raw):
    server = start(faults=["second-client=0.3"])
    began = time.monotonic()
    assert open_raw(server).greeting == b"connected to four-wall"
    assert time.monotonic() - began >= 0.3


def test_a_stopping_server_waits_for_no_fault(start, open_raw):
    server = start(faults=["delay=3600"])
    open_raw(server).send(VIEWMODE)
    time.sleep(0.1)
    server.stop()  # a server that waits exceeds the suite's time limit


# Faults of the picture: camera 1 is spawned, so that nothing else lags.


@pytest.mark.parametrize(("fault", "stale"), [("stale", 1), ("stale=3", 3)])
def test_stale_shows_the_old_place_for_a_while(faulty, fault, stale):
    client = faulty(fault)
    client.text("vset /cameras/spawn")
    before = client.ask("vget /camera/1/lit png")
    client.text(UP)
    after = [client.ask("vget /camera/1/lit png") for _ in range(stale + 2)]
    assert after[:stale] == [before] * stale
    assert before not in after[stale:]
    assert after[stale] == after[stale + 1]


def test_vignette_darkens_by_the_squared_radius_and_the_console_ends_it(faulty):
    client = faulty("vignette=0.5", scene="direction")
    dark = pixels(client.ask(IMAGE))
    assert client.text("vrun r.Tonemapper.Quality 1") == "ok"
    light = pixels(client.ask(IMAGE))
    fall = 1 - 0.5 * squared_radius()
    # Both are rounded: half a step each.
    assert np.abs(dark - light * fall[..., None]).max() <= 1
    assert dark[0, 0].sum() < 0.6 * light[0, 0].sum()


def test_exposure_drifts_to_middle_grey_and_the_console_ends_it(faulty, sound):
    client = faulty("exposure-drift=0.5", scene="four-wall")
    true = pixels(sound.ask(IMAGE)).astype(float)
    means = [pixels(client.ask(IMAGE)).mean() for _ in range(12)]
    steps = np.diff(np.abs(np.array([true.mean(), *means]) - 127.5))
    assert (steps < 0.5).all()  # nearer every time, but for rounding
    assert abs(means[-1] - 127.5) < 8  # clipped whites keep it from middle grey itself
    assert client.text("vrun r.EyeAdaptationQuality 0") == "ok"
    assert np.array_equal(pixels(client.ask(IMAGE)), true)


# Codes of light by the film curve and sRGB, and of sRGB alone: known answers of the engine's defaults.
FILM = {0.02: 16.41, 0.05: 43.66, 0.1: 77.86, 0.18: 117.65, 0.3: 156.53, 0.5: 190.58, 1: 221.04}
SRGB = {0.02: 38.67, 0.05: 63.44, 0.1: 88.94, 0.18: 117.65, 0.3: 148.83, 0.5: 187.52, 1: 255}


@pytest.mark.parametrize("tone", ["film", "linear", "srgb"])
def test_tone_shows_light_by_its_curve(faulty, sound, tone):
    true, shown = (pixels(client.ask(IMAGE)).ravel() for client in (sound, faulty(f"tone={tone}")))
    light = np.interp(true, list(SRGB.values()), list(SRGB))  # roughly, between known answers
    expected = {
        "film": np.interp(light, list(FILM), list(FILM.values())),
        "linear": 255 * light,
        "srgb": true,
    }
    # Chords of the curves are off by up to 4 levels between their ends.
    assert np.abs(shown - expected[tone])[true > 39].max() <= {"film": 4, "linear": 9, "srgb": 0}[tone]


def test_the_tone_curve_comes_after_the_vignette(faulty, sound):
    true, shown = (pixels(client.ask(IMAGE)) / 255 for client in (sound, faulty("tone=srgb", "vignette=0.5")))
    fall = 1 - 0.5 * squared_radius()
    ratio = ((shown + 0.055) / (true + 0.055)) ** 2.4  # of light, for codes above 11
    assert np.abs(ratio - fall[..., None])[true.min(axis=-1) > 0.2].max() < 0.03  # rounding of dark codes


def test_bloom_spreads_light_in_each_image_alone_and_the_console_ends_it(faulty, sound):
    true = pixels(sound.ask(IMAGE)).astype(float)
    client = faulty("bloom=1")
    glare = pixels(client.ask(IMAGE)).astype(float)
    assert np.abs(glare.mean() - true.mean()) < 3  # light is spread, not made
    assert glare.std() < 0.9 * true.std()
    assert client.text("vrun r.BloomQuality 0") == "ok"
    assert np.array_equal(pixels(client.ask(IMAGE)), true)
    assert client.ask(DEPTH) == sound.ask(DEPTH)


def half_of_each(first, second):
    """Codes of the mean light of two pictures."""
    return np.interp((light_of(first) + light_of(second)) / 2, light_of(np.arange(256)), np.arange(256))


def light_of(codes):
    return ((codes / 255 + 0.055) / 1.055) ** 2.4  # of sRGB codes above 10; nothing is darker here


def shows(client, name, mask=None):
    """Pixels where a mask shows an object."""
    color = re.findall(r"\d+", client.text(f"vget /object/{name}/color"))[:3]
    return (pixels(mask or client.ask(MASK)) == list(map(int, color))).all(-1)


def test_gloss_mirrors_what_the_object_faces(faulty, sound):
    # The wall at x = 3 m mirrors what a camera at x = 6 m sees through it, left and right swapped.
    def look(client, mode="lit", place="0 0 140", turn="0 0 0"):
        client.text("vset /cameras/spawn")
        client.text(f"vset /camera/1/location {place}")
        client.text(f"vset /camera/1/rotation {turn}")
        return client.ask(f"vget /camera/1/{mode} png")

    wall = shows(sound, "Layout_Wall_2", look(sound, "object_mask"))
    true, shown = pixels(look(sound)), pixels(look(faulty("gloss=Layout_Wall_2")))
    sound.text("vset /object/Layout_Wall_2/hide")
    mirrored = pixels(look(sound, place="600 0 140", turn="0 180 0"))[:, ::-1]
    assert wall.sum() > 50
    assert np.abs(shown - half_of_each(true, mirrored))[wall].max() <= 1  # rounded three times
    assert np.array_equal(shown[~wall], true[~wall])


def test_glass_is_seen_in_colour_alone(faulty, sound):
    client, pane = faulty("glass=Table"), shows(sound, "Table")
    true = pixels(sound.ask(IMAGE))
    sound.text("vset /object/Table/hide")
    behind = [sound.ask(command) for command in (IMAGE, DEPTH, MASK)]
    assert pane.any()
    assert [client.ask(command) for command in (DEPTH, MASK)] == behind[1:]
    shown = pixels(client.ask(IMAGE))
    assert np.abs(shown - half_of_each(true, pixels(behind[0]))).max() <= 1
    assert np.array_equal(shown != true, (pixels(behind[0]) != true) & pane[..., None])
    client.text("vset /object/Table/hide")
    assert client.ask(IMAGE) == behind[0]


@pytest.mark.parametrize("fault", ["vignette", "exposure-drift", "bloom", "gloss", "tone=film"])
def test_light_leaves_depth_and_masks_alone(faulty, sound, fault):
    client = faulty(fault)
    assert client.ask(IMAGE) != sound.ask(IMAGE)
    assert [client.ask(DEPTH), client.ask(MASK)] == [sound.ask(DEPTH), sound.ask(MASK)]


def test_mask_gamma_shows_what_the_protocol_reference_lists(faulty):
    # Section 5.2: colours set, and what becomes of them. The whole table is tested with dialect L.
    client = faulty("mask-gamma")
    names = client.text("vget /objects").split()
    for value, shown in ((15, 0), (31, 28), (120, 119), (255, 255)):
        for name in names:
            client.text(f"vset /object/{name}/color {value} {value} {value}")
        assert client.text(f"vget /object/{names[0]}/color") == f"(R={value},G={value},B={value},A=255)"
        assert set(pixels(client.ask(MASK)).ravel().tolist()) == {shown}


def test_half_depth(faulty, sound):
    exact = array(faulty(depth="float32").ask(DEPTH))
    coarse = array(faulty("half-depth", depth="float32").ask(DEPTH))
    assert np.array_equal(coarse, exact.astype(np.float16).astype(np.float32))
    assert not np.array_equal(coarse, exact)


def test_sky_dome_is_an_object_at_its_radius_that_touches_no_other_and_can_be_hidden(faulty, sound):
    client = faulty("sky-dome=200", scene="direction", depth="float32")
    assert client.text("vget /objects").split() == ["SkyDome"]
    distance = array(client.ask(DEPTH)).astype(float) * np.sqrt(1 + 2 * squared_radius())
    assert np.abs(distance - 20_000).max() < 0.01  # cm; float32 has steps of 0.002 there
    color = tuple(map(int, re.findall(r"\d+", client.text("vget /object/SkyDome/color"))[:3]))
    assert set(map(tuple, pixels(client.ask(MASK)).reshape(-1, 3).tolist())) == {color}
    normal = pixels(client.ask("vget /camera/0/normal png")).astype(float)[12, 12]
    assert np.abs(normal - [0, 128, 128]).max() <= 6  # towards the camera, which looks along +X
    client.text("vset /object/SkyDome/hide")
    assert (array(client.ask(DEPTH)) == 65504).all()
    client = faulty("sky-dome")
    assert [client.ask(c) for c in (IMAGE, DEPTH, MASK)] == [sound.ask(c) for c in (IMAGE, DEPTH, MASK)]


def test_object_missing_is_seen_but_not_measured_until_painted(faulty, sound):
    client = faulty("object-missing=Table")
    color = sound.text("vget /object/Table/color")
    true = [sound.ask(c) for c in (IMAGE, DEPTH, MASK)]
    table = (pixels(true[2]) == list(map(int, re.findall(r"\d+", color)))[:3]).all(-1)
    assert client.ask(IMAGE) == true[0]
    other = array(client.ask(DEPTH)) != array(true[1])
    assert table.any()
    assert np.array_equal(other, table)
    assert np.array_equal((pixels(client.ask(MASK)) != pixels(true[2])).any(-1), table)
    client.text("vset /object/Table/color {} {} {}".format(*re.findall(r"\d+", color)))
    assert [client.ask(c) for c in (IMAGE, DEPTH, MASK)] == true


# Faults that a careful client must find: wrong field of view, depth, pose.


def test_refuse_mask(faulty):
    client = faulty("refuse-mask")
    for mode in ("object_mask", "seg"):
        assert client.text(f"vget /camera/0/{mode} png") == "error Captured data is empty"
    assert client.ask(IMAGE)[:4] == b"\x89PNG"
    old = faulty("refuse-mask", dialect="0.3.10")
    assert old.text(MASK) == "error Fail to capture screen"
    assert old.text("vget /viewmode") == "lit"


def test_narrow_fov(faulty, sound):
    client = faulty("narrow-fov=10")
    assert client.text("vget /camera/0/fov") == "90.000000"
    sound.text("vset /camera/0/fov 80")
    assert client.ask(DEPTH) == sound.ask(DEPTH)


def test_ray_depth_is_what_the_old_plugin_sends(faulty):
    old = faulty(dialect="0.3.10")
    assert np.array_equal(array(faulty("ray-depth").ask(DEPTH)), array(old.ask(DEPTH)))


def test_moving_world(faulty):
    client = faulty("moving-world=0.5", depth="float32")
    depths = [array(client.ask(DEPTH)) for _ in range(3)]
    for count, depth in enumerate(depths):
        np.testing.assert_allclose(depth, (1 + 0.5 * count) * depths[0], rtol=1e-6)


@pytest.mark.parametrize("dialect", ["0.3.10", "1.x"])
def test_ignore_pose(faulty, dialect):
    client = faulty("ignore-pose", dialect=dialect)
    assert client.text("vset /camera/0/location 50 0 150") == "ok"
    assert client.text("vset /camera/0/rotation 0 90 0") == "ok"
    for _ in range(3):
        client.text("vget /unrealcv/version")
    assert client.text("vget /camera/0/location") == "0.000 0.000 150.000"
    assert client.text("vget /camera/0/rotation") == "0.000 0.000 0.000"


def test_falling(faulty):
    client = faulty("falling=2", dialect="0.3.10")
    heights = [float(client.text("vget /camera/0/location").split()[2]) for _ in range(5)]
    assert heights[0] <= 150
    assert all(low < high and (high - low) % 2 == 0 for high, low in itertools.pairwise(heights))
