"""Every fault that the server can inject, observed from the other end of a socket."""

import io
import re

import cv2
import numpy as np
import pytest

import mock_server
from mock_server import faults
from mock_server.__main__ import main
from mock_server.flaws import distorted

IMAGE = "vget /camera/0/lit png"
DEPTH = "vget /camera/0/depth npy"
MASK = "vget /camera/0/object_mask png"


@pytest.fixture
def faulty(start, open_raw):
    return lambda *texts, **options: open_raw(start(faults=texts, size=(24, 24), **options))


@pytest.fixture
def sound(faulty):
    return faulty()


def pixels(payload):
    return cv2.cvtColor(cv2.imdecode(np.frombuffer(payload, np.uint8), cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)


def test_the_help_lists_every_fault(capsys):
    assert main(["--help"]) == 0
    text = capsys.readouterr().out.partition("\nfaults:\n")[2]
    listed = re.findall(r"^  ([a-z-]+)  +\S", text, re.MULTILINE)
    assert listed == list(faults.KINDS)


def test_a_fault_that_is_none_is_refused_with_what_was_expected():
    for text, message in (
        ("wrong", "expected one of delay, drip"),
        ("delay=soon", "fault delay: expected a number from 0 to 3600, got 'soon'"),
        ("delay@2", "probability: expected a number from 0 to 1, got '2'"),
        ("cut=1.5", "expected a number from 0 to 1"),
        ("missing=1", "expected no value"),
        ("vignette@0.5", "expected no probability"),
        ("object-missing=Elephant", "expected one of Ball"),
        ("tone=sepia", "expected one of srgb, film, linear; got 'sepia'"),
    ):
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


def test_what_is_drawn_into_pictures_begins_with_the_server(start):
    with pytest.raises(ValueError, match="expected when the server starts"):
        start().faults.start("vignette")


# Faults of the line: requests are sent, and bytes read, as they are. Times are lower bounds.

VIEWMODE = b"7:vget /viewmode"
LIT = b"7:lit"
MAGIC = b"\xc1\x83\x2b\x9e"


def test_a_distorted_picture_shows_what_its_radius_says():
    """A picture of its own coordinates: a tenth further out in the corners, in the middle as before."""
    height, width = 60, 80
    v, u = np.mgrid[:height, :width].astype(np.float32) + 0.5
    shown_u, shown_v = np.moveaxis(distorted(np.dstack([u, v]), 0.1), -1, 0)
    x = 2 * u / width - 1
    y = 2 * v / height - 1
    longer = 1 + 0.05 * (x**2 + y**2)
    for shown, at, size in ((shown_u, x, width), (shown_v, y, height)):
        expected = np.clip((at * longer + 1) * size / 2, 0.5, size - 0.5)
        assert np.abs(shown - expected).max() <= 0.501, "the nearest pixel"


def test_bytes_of_a_reply(faulty):
    for fault, received in (
        ("wrong-id", MAGIC + b"\x05\0\0\x008:lit"),
        ("no-id", MAGIC + b"\x03\0\0\0lit"),
        ("clicked", MAGIC + b"\x07\0\0\0clicked" + MAGIC + b"\x05\0\0\0" + LIT),
        ("bad-magic", b"\xc0\x83\x2b\x9e\x05\0\0\0"),
        ("zero-size", MAGIC + b"\0\0\0\0"),
        ("huge", MAGIC + b"\xff\xff\xff\xff"),
    ):
        client = faulty(fault)
        client.send(VIEWMODE)
        assert client.bytes(len(received)) == received


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


@pytest.mark.parametrize(
    ("fault", "ends"),
    [("vignette", "r.Tonemapper.Quality 1"), ("exposure-drift", "r.EyeAdaptationQuality 0"),
     ("bloom", "r.BloomQuality 0"), ("gloss", None), ("tone=film", None)],
)  # fmt: skip
def test_light_leaves_depth_and_masks_alone_and_the_console_ends_what_the_help_says(
    faulty, sound, fault, ends
):
    client = faulty(fault)
    assert client.ask(IMAGE) != sound.ask(IMAGE)
    assert [client.ask(DEPTH), client.ask(MASK)] == [sound.ask(DEPTH), sound.ask(MASK)]
    if ends:
        assert client.text(f"vrun {ends}") == "ok"
        assert client.ask(IMAGE) == sound.ask(IMAGE)


# Depth in cm as the fault says that it comes, by the true one. The doctor's tests meet every other fault.
CHANGES = {
    "far-plane=2": lambda depth: np.minimum(depth, 200),
    "radial-depth=0.5": lambda depth: depth * (1 + LENGTHS) / 2,
    "depth-bits=8": lambda depth: np.round(depth / 1e4 * 256) * 1e4 / 256,
    "depth-mantissa=10": lambda depth: 100 * (depth / 100).astype(np.float16).astype(float),
    "depth-scale=0.1": lambda depth: 1.1 * depth,
}
SLOPES = (np.arange(24) + 0.5) / 12 - 1
LENGTHS = np.sqrt(1 + SLOPES[:, None] ** 2 + SLOPES**2)


@pytest.mark.parametrize("fault", CHANGES)
def test_depth_is_changed_as_the_fault_says(faulty, fault):
    true, changed = (
        np.load(io.BytesIO(client.ask(DEPTH)))
        for client in (faulty(depth="float32"), faulty(fault, depth="float32"))
    )
    np.testing.assert_allclose(changed, CHANGES[fault](true), rtol=1e-5)
    assert (changed != true).any()
