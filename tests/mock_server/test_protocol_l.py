"""Dialect L, plugin 0.3.10 (columns L of the protocol reference), on the wire and by the official client."""

import io
import itertools

import numpy as np
import pytest
from support.expected_views import npy, png, seen_by_hand

import mock_server
from mock_server.pixels import through_vertex_colors

SIZE = (40, 30)
WINDOW = (32, 20)
# Palette values that vertex colours change, as the reference lists them; all others from 127 up are exact.
BENT = {23: 21, 31: 28, 47: 46, 55: 53, 63: 61, 71: 70, 79: 78, 103: 102, 119: 118}
BENT |= {15: 0, 35: 34, 120: 119, 145: 144}
EXACT = [39, 87, 95, 111, 127, 143, 151, 159, 167, 175, 183, 191, 199, 207, 215, 223, 231, 239, 255]


@pytest.fixture
def server(start, tmp_path):
    return start(dialect="0.3.10", size=SIZE, window=WINDOW, folder=tmp_path)


@pytest.fixture
def raw(server, open_raw):
    return open_raw(server)


DISPLAYED = through_vertex_colors(np.arange(256, dtype=np.uint8))
FOUR_WALL = mock_server.load_scene("four-wall")


def same_depth(got, location_cm=(0, 0, 150), yaw_deg=0):
    """Metres along the ray, through half floats; pixels on an edge aside."""
    truth = seen_by_hand(FOUR_WALL, location_cm, (0, yaw_deg, 0), 90, *SIZE)[0].distance
    return (np.abs(got - truth) <= 2.0**-11 * truth).mean() > 0.99


def test_pictures_lag_behind_the_pose_and_the_rotation_lags_more(start, open_raw):
    raw = open_raw(start(dialect="L", size=SIZE, frames_per_s=1))  # no frame passes by itself
    old = npy(raw.ask("vget /camera/0/depth npy"))
    raw.ask("vset /camera/0/pose 50 0 150 0 90 0")
    frames = [npy(raw.ask("vget /camera/0/depth npy")) for _ in range(4)]
    np.testing.assert_array_equal(frames[0], old)
    assert same_depth(frames[1], (50, 0, 150), yaw_deg=0)
    assert same_depth(frames[2], (50, 0, 150), yaw_deg=90)
    np.testing.assert_array_equal(frames[3], frames[2])


def test_three_round_trips_or_a_file_command_settle_the_pose(raw):
    raw.ask("vset /camera/0/pose 50 0 150 0 90 0")
    raw.settle()
    assert same_depth(npy(raw.ask("vget /camera/0/depth npy")), (50, 0, 150), yaw_deg=90)
    raw.ask("vset /camera/0/pose 0 0 150 0 180 0")
    raw.ask("vget /camera/0/lit x.png")
    assert same_depth(npy(raw.ask("vget /camera/0/depth npy")), (0, 0, 150), yaw_deg=180)


def test_arrays_hold_the_pixels_of_pictures_and_three_come_in_one_reply(raw):
    parts = io.BytesIO(raw.ask("vget /camera/0/lit_depth_normal npy"))
    for mode, array in zip(("lit", "depth", "normal"), [np.load(parts) for _ in range(3)], strict=True):
        np.testing.assert_array_equal(array, npy(raw.ask(f"vget /camera/0/{mode} npy")))
        image = png(raw.ask(f"vget /camera/0/{mode} png"))
        assert image.shape == (*SIZE[::-1], 4)
        if mode == "depth":  # its picture is for the eye
            assert image[..., 0].max() == 255
        else:
            np.testing.assert_array_equal(image[..., :3], array[..., :3])
    assert parts.read() == b""


def test_an_impossible_field_of_view_gives_no_data(raw, tmp_path):
    """Which becomes the text ok where bytes are expected, and no file where a path is."""
    raw.ask("vset /camera/0/horizontal_fieldofview 0")
    assert raw.text("vget /camera/0/lit png") == raw.text("vget /camera/0/depth npy") == "ok"
    for name in ("x.png", "x.exr"):
        assert raw.text(f"vget /camera/0/depth {name}") == f"{tmp_path}/{name}"
    assert list(tmp_path.iterdir()) == []


def test_displayed_values_are_those_of_the_reference():
    from mock_server.objects import palette

    listed = BENT | {value: value for value in EXACT}
    assert {value: DISPLAYED[value] for value in listed} == listed
    assert len(set(DISPLAYED.tolist())) == 183
    assert not DISPLAYED[:21].any()
    assert DISPLAYED[21] > 0
    assert [v for v in range(122, 256) if DISPLAYED[v] != v] == [145]
    shown = [tuple(DISPLAYED[list(color)]) for color in itertools.islice(palette(), 1000)]
    first = next(i for i, color in enumerate(shown) if color in shown[:i])
    assert (first, len(shown) - len(set(shown))) == (729, 271)


def test_object_mask_leaves_the_window_in_its_view_mode_and_a_lit_file_resets_it(raw):
    raw.ask("vget /camera/0/object_mask png")
    assert raw.text("vget /viewmode") == "object_mask"
    raw.ask("vget /camera/0/lit png")
    assert raw.text("vget /viewmode") == "object_mask"
    raw.ask("vget /camera/0/lit x.png")
    assert raw.text("vget /viewmode") == "lit"


def test_files(raw, tmp_path):
    assert raw.text("vget /camera/0/lit") == f"{tmp_path}/00000001.png"
    assert raw.text("vget /camera/0/depth") == f"{tmp_path}/00000002.png"
    assert raw.text("vget /camera/0/screenshot") == f"{tmp_path}/00000003.png"
    assert raw.text("vget /camera/0/object_mask npy") == f"{tmp_path}/npy"
    assert raw.text("vget /camera/0/lit x.jpg") == f"{tmp_path}/x.jpg"
    written = {path.name for path in tmp_path.iterdir()}
    assert written == {"00000001.png", "00000002.png", "00000003.png", "npy"}
    assert (tmp_path / "00000001.png").read_bytes() == raw.ask("vget /camera/0/lit png")


def test_exr_files_are_half_floats(raw, tmp_path):
    import OpenImageIO

    raw.ask("vget /camera/0/depth d.exr")
    image = OpenImageIO.ImageBuf(str(tmp_path / "d.exr"))
    assert (image.spec().format, image.nchannels) == (OpenImageIO.HALF, 4)
    depth = npy(raw.ask("vget /camera/0/depth npy"))
    np.testing.assert_array_equal(image.get_pixels(OpenImageIO.FLOAT)[..., 0], depth)


def test_asynchronous_replies_come_after_later_synchronous_ones(start, open_raw):
    raw = open_raw(start(dialect="L", frames_per_s=10))
    raw.send(b"1:vget /camera/0/object_mask png", b"2:vget /unrealcv/echo late", b"3:vget /unrealcv/version")
    ids = [raw.frame().partition(b":")[0] for _ in range(3)]
    assert ids == [b"3", b"1", b"2"]
