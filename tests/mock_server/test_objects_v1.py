"""The objects of dialect 1.x: names, colours, places."""

import numpy as np
import pytest
from support.expected_views import png

import mock_server


def test_objects_are_listed_each_with_a_space(raw):
    names = mock_server.load_scene("four-wall").objects
    assert raw.text("vget /objects") == "".join(name + " " for name in names)


def test_a_scene_without_objects_answers_ok(start, open_raw):
    assert open_raw(start("direction")).text("vget /objects") == "ok"


def test_default_colours_are_the_plugins_in_order(raw):
    first = ["(0,0,0)", "(0,0,255)", "(0,255,0)", "(0,255,255)", "(255,0,0)", "(255,0,255)", "(255,255,0)"]
    first += ["(255,255,255)", "(0,0,127)", "(0,255,127)", "(255,0,127)", "(255,255,127)", "(0,127,0)"]
    for name, color in zip(raw.text("vget /objects").split(), first, strict=False):
        r, g, b = color.strip("()").split(",")
        assert raw.text(f"vget /object/{name}/color") == f"(R={r},G={g},B={b},A=255)"


def test_the_palette_has_32768_distinct_colours():
    from mock_server.objects import palette

    colors = list(palette())
    assert len(colors) == len(set(colors)) == 32768
    assert colors[27] == (0, 0, 63)


def test_hidden_objects_vanish_from_every_mode(camera, truth):
    scene, hits, _ = truth
    name = scene.objects[np.bincount(hits.label.ravel()).argmax() - 1]
    before = {f: camera.ask(f"vget /camera/1/{f}") for f in ("lit png", "object_mask png", "depth npy")}
    assert camera.text(f"vset /object/{name}/hide") == "ok"
    for form, data in before.items():
        assert camera.ask(f"vget /camera/1/{form}") != data
    assert camera.text(f"vset /object/{name}/show") == "ok"
    for form, data in before.items():
        assert camera.ask(f"vget /camera/1/{form}") == data


def test_objects_move_and_turn(camera):
    """A ball seen after a move is where it was sent: its mask's middle lies in that direction."""
    camera.ask("vset /camera/1/size 200 200")
    camera.ask("vset /camera/1/location 0 0 150")
    camera.ask("vset /camera/1/rotation 0 0 0")
    assert camera.text("vset /object/Ball/location 100.0 25.0 160.0") == "ok"
    assert camera.text("vget /object/Ball/location") == "100.000 25.000 160.000"
    assert camera.text("vset /object/Ball/color 1 2 3") == "ok"
    mask = png(camera.ask("vget /camera/1/object_mask png"))
    v, u = np.nonzero((mask[..., :3] == (1, 2, 3)).all(axis=-1))
    f = 100 / np.tan(np.radians(75.5) / 2)
    # A sphere's picture is nearly centred on its centre's: 22 cm at 1 m shift it by a pixel or two.
    assert u.mean() == pytest.approx(100 + f * 25 / 100, abs=3)
    assert v.mean() == pytest.approx(100 - f * 10 / 100, abs=3)
    before = camera.text("vget /object/Picture/bounds")
    assert camera.text("vset /object/Picture/rotation 0 90 0") == "ok"
    assert camera.text("vget /object/Picture/rotation") == "0.000 90.000 0.000"
    old, new = (np.array(t.split(), float) for t in (before, camera.text("vget /object/Picture/bounds")))
    np.testing.assert_allclose((new[3:] - new[:3])[[1, 0, 2]], old[3:] - old[:3], atol=0.03)
