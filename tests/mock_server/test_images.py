"""Images and objects of dialect 1.x, compared with rays made from the reference's formulas."""

import struct

import numpy as np
import pytest
from support.expected_views import nearly_all_equal, npy, png, seen_by_hand

import mock_server
from mock_server.objects import palette


def test_png_is_rgba_and_bmp_repeats_its_byte_count_before_the_same_pixels(camera, truth):
    _, hits, _ = truth
    image = png(camera.ask("vget /camera/1/lit png"))
    assert image.shape == (30, 40, 4)
    assert image.dtype == np.uint8
    nearly_all_equal(image[..., :3], 255 * hits.color, tolerance=0.51)
    data = camera.ask("vget /camera/1/lit bmp")
    count = 4 * 40 * 30
    assert len(data) == 58 + count
    fields = struct.unpack("<2sIHHIIiiHHIIii", data[:46])
    assert fields == (b"BM", 54 + count, 0, 0, 54, 40, 40, -30, 1, 32, 0, 0, 1024, 1024)
    assert data[54:58] == struct.pack("<i", count)
    pixels = np.frombuffer(data[58:], np.uint8).reshape(30, 40, 4)
    np.testing.assert_array_equal(pixels[..., 2::-1], image[..., :3])


def test_depth_is_planar_centimetres_through_half_floats(camera, truth):
    _, _, planar = truth
    data = camera.ask("vget /camera/1/depth npy")
    assert data[:8] == b"\x93NUMPY\x01\x00"
    length = struct.unpack("<H", data[8:10])[0]
    assert (10 + length) % 16 == 0
    header = data[10 : 10 + length]
    assert header.rstrip() == b"{'descr': '<f4', 'fortran_order': False, 'shape': (30, 40), }"
    assert header.endswith(b" \n")
    depth = npy(data)
    np.testing.assert_array_equal(depth, depth.astype(np.float16).astype(np.float32))
    # Half floats have 11 bits: at most half a step, 2^-11 relative.
    nearly_all_equal(depth[..., None], 100 * planar[..., None], tolerance=2.0**-11 * 100 * planar.max())


def test_npy_headers_get_another_block_when_they_fit(raw):
    """The header of (480, 640) takes 80 bytes; one that fits exactly grows by 16 all the same."""
    lengths = {}
    for width in (1, 10, 100, 1000):
        for height in (1, 10, 100):
            raw.ask(f"vset /camera/0/size {width} {height}")
            data = raw.ask("vget /camera/0/depth npy")
            text = len(f"{{'descr': '<f4', 'fortran_order': False, 'shape': ({height}, {width}), }}")
            lengths[text] = 10 + struct.unpack("<H", data[8:10])[0]
            assert npy(data).shape == (height, width)
    assert all(total == (10 + text) // 16 * 16 + 16 for text, total in lengths.items())


def test_field_of_view_is_of_the_longer_side(camera):
    camera.ask("vset /camera/1/size 20 60")
    depth = npy(camera.ask("vget /camera/1/depth npy"))
    scene = mock_server.load_scene("four-wall")
    across = np.degrees(2 * np.arctan(np.tan(np.radians(75.5) / 2) * 20 / 60))
    _, planar = seen_by_hand(scene, (10, -20, 150), (10, 30, 5), across, 20, 60)
    nearly_all_equal(depth[..., None], 100 * planar[..., None], tolerance=2.0**-11 * 100 * planar.max())


def test_captures_without_pixels_are_refused(camera):
    for command in ("size 0 10", "size 100000 100000", "size 4 4", "fov 0", "fov 180"):
        assert camera.text(f"vset /camera/1/{command}") == "ok"
        for mode in ("lit png", "depth npy"):
            refused = camera.ask(f"vget /camera/1/{mode}") == b"error Captured data is empty"
            assert refused == (command != "size 4 4")


def test_the_view_mode_contaminates_captures(camera):
    """A depth or normal view mode puts a post-process into the world, which capture cameras obey."""
    clean = camera.ask("vget /camera/1/lit png")
    assert camera.text("vset /viewmode Normal") == "ok"
    assert camera.text("vget /viewmode") == "normal"
    assert camera.ask("vget /camera/1/lit png") != clean
    assert camera.text("vset /viewmode lit") == "ok"
    assert camera.ask("vget /camera/1/lit png") == clean


def test_default_colours_are_the_plugins_in_order(raw):
    """The first ones and one behind them as the reference lists them."""
    colors = list(palette())
    assert colors[:6] == [(0, 0, 0), (0, 0, 255), (0, 255, 0), (0, 255, 255), (255, 0, 0), (255, 0, 255)]
    assert colors[27] == (0, 0, 63)
    assert len(colors) == len(set(colors)) == 32768
    for name, (r, g, b) in zip(raw.text("vget /objects").split(), colors, strict=False):
        assert raw.text(f"vget /object/{name}/color") == f"(R={r},G={g},B={b},A=255)"


def test_a_spawned_box_is_in_lit_at_once_and_in_depth_and_masks_once_it_has_a_colour(start, open_raw):
    client = open_raw(start("workshop", dialect="N1", size=(20, 16), frames_per_s=1e-3, depth="float32"))
    for command in ("/action/game/pause", "/cameras/spawn", "/camera/1/location 0 0 130"):
        client.ask(f"vset {command}")
    lit, depth = (lambda mode=mode: client.ask(f"vget /camera/1/{mode}") for mode in ("lit png", "depth npy"))
    client.ask("vset /objects/spawn CubeActor Box")
    before = lit(), depth()
    client.ask("vset /object/Box/location 200 0 130")
    assert (lit() == before[0], depth() == before[1]) == (False, True)
    client.ask("vset /object/Box/color 7 8 9")
    seen = (png(client.ask("vget /camera/1/object_mask png"))[..., :3] == (7, 8, 9)).all(axis=-1)
    # The cube's front is 1.5 m away and 1 m wide, of 3 m that the view spans there.
    assert seen.sum() == pytest.approx((20 / 3) ** 2, rel=0.3)
    assert npy(depth())[seen] == pytest.approx(150, abs=1e-3)
    assert (np.abs(npy(depth()) - npy(before[1]))[~seen] < 1e-3).all()
