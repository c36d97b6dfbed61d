"""Six faces as other tools name, turn and pack them: imported, composed, and judged by exact tracing."""

import numpy as np
import pytest
from PIL import Image

import omniscv
from mock_server import load_scene
from omniscv import cli
from omniscv.chart import traced
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.sources import View
from omniscv.sources.base import Request
from omniscv.sources.recording.importing import import_pictures
from omniscv.sources.recording.layouts import LAYOUTS
from omniscv.sources.scene import open_scene

CENTER = (0.3, -0.2, 1.45)
EDGE = 96
CAMERA = omniscv.cameras.create("equirectangular", 128, 64)


def pictures(arrangement, mode="lit", scene="four-wall"):
    with open_scene(f"scene://{scene}") as source:
        views = [View(Pose(CENTER, face.R_w_c), 90, EDGE, EDGE) for face in arrangement]
        return [capture.pixels for capture in source.capture(Request(view, mode) for view in views)]


def written(folder, layout, words, mode="lit", before="", after=""):
    folder.mkdir(exist_ok=True, parents=True)
    for word, pixels in zip(words.split(), pictures(layout.arrangement, mode), strict=True):
        Image.fromarray(pixels).save(folder / f"{before}{word}{after}.png")
    return folder


def seen(path, yaw_deg=0.0):
    """The error of a panorama of the imported faces, against the colours that its rays meet."""
    pose = Pose.from_angles(CENTER, yaw_deg=yaw_deg)
    with omniscv.open_source(path) as source:
        image = omniscv.render(CAMERA, pose, source, ("lit",), filter="nearest")
    truth = 255 * traced(load_scene("four-wall"), CAMERA, Pose.from_angles(CENTER)).color
    return np.abs(image.lit - truth)[2:-2].mean()  # a plain ceiling may be turned


NAMED = [
    ("faces", "front right back left up down", "", ""),
    ("faces", "0 1 2 3 4 5", "lit_", ""),
    ("top-bottom", "front right back left top bottom", "room_", "_0001"),
    ("gl", "posx negx posy negy posz negz", "", ""),
    ("gl", "0 1 2 3 4 5", "cube", ""),
    ("unity", "FrontTex BackTex LeftTex RightTex UpTex DownTex", "sky_", ""),
    ("matterport", "skybox0 skybox1 skybox2 skybox3 skybox4 skybox5", "d2_", "_sami"),
    ("blender-addon", "NORTH SOUTH WEST EAST ZENITH NADIR", "", "_0001"),
]


@pytest.mark.parametrize(("name", "words", "before", "after"), NAMED)
def test_six_files_by_their_names_and_seams(name, words, before, after, tmp_path):
    folder = written(tmp_path / "sky", LAYOUTS[name], words, before=before, after=after)
    found = import_pictures(folder, tmp_path / "room.sqlite", position=CENTER)
    assert found.captures == 6
    assert found.lines[0].startswith(f"layout {name}: step across edges ")
    assert seen(tmp_path / "room.sqlite") < 6  # 50 where two faces are exchanged


@pytest.mark.parametrize("name", [name for name, each in LAYOUTS.items() if each.cells and name != "openexr"])
def test_six_faces_in_one_picture(name, tmp_path):
    layout = LAYOUTS[name]
    rows = layout.cells.split("/")
    whole = np.zeros((EDGE * len(rows), EDGE * len(rows[0]), 3), np.uint8)
    cells = [(r, c) for r, row in enumerate(rows) for c, cell in enumerate(row) if cell == "#"]
    for (r, c), pixels in zip(cells, pictures(layout.arrangement), strict=True):
        whole[r * EDGE : (r + 1) * EDGE, c * EDGE : (c + 1) * EDGE] = pixels
    Image.fromarray(whole).save(tmp_path / "sky.png")
    found = import_pictures(tmp_path / "sky.png", tmp_path / "room.sqlite", position=CENTER)
    assert found.lines[0].startswith(f"layout {name}: ")
    assert seen(tmp_path / "room.sqlite") < 6


def test_a_named_layout_is_taken_at_its_word(tmp_path):
    """Names of both axes of OpenGL and of Unreal: the same cube, turned."""
    folder = written(tmp_path / "sky", LAYOUTS["unreal"], "posx negx posy negy posz negz")
    import_pictures(folder, tmp_path / "room.sqlite", "unreal", position=CENTER)
    assert seen(tmp_path / "room.sqlite") < 6


@pytest.mark.parametrize("swapped", [("front", "back"), ("back", "down")])
def test_exchanged_faces_are_put_right(swapped, tmp_path):
    folder = written(tmp_path / "sky", LAYOUTS["faces"], "front right back left up down")
    one, other = (folder / f"{word}.png" for word in swapped)
    one.rename(folder / "x.png")
    other.rename(one)
    (folder / "x.png").rename(other)
    found = import_pictures(folder, tmp_path / "room.sqlite", position=CENTER)
    assert {f"{one.stem} shows {other.stem}, not {one.stem}: put right"} <= {*found.lines}
    assert seen(tmp_path / "room.sqlite") < 6


def test_a_turned_face_is_put_right(tmp_path):
    folder = written(tmp_path / "sky", LAYOUTS["faces"], "front right back left up down")
    with Image.open(folder / "left.png") as picture:
        picture.transpose(Image.Transpose.ROTATE_270).save(folder / "left.png")  # clockwise
    found = import_pictures(folder, tmp_path / "room.sqlite", position=CENTER)
    assert found.lines[1:] == ("left shows left turned by 90 degrees, not left: put right",)
    assert seen(tmp_path / "room.sqlite") < 6


def test_faces_that_do_not_fit_are_refused(tmp_path):
    folder = tmp_path / "sky"
    folder.mkdir()
    draw = np.random.default_rng(1)
    for word in ["front", "right", "back", "left", "up", "down"]:
        Image.fromarray(draw.integers(0, 256, (32, 32, 3), np.uint8)).save(folder / f"{word}.png")
    with pytest.raises(ArgumentError, match="expected six faces that fit together, got none that do clearly"):
        import_pictures(folder, tmp_path / "room.sqlite")
    assert not (tmp_path / "room.sqlite").exists()


@pytest.mark.parametrize("depth", ["planar-m", "ray-mm"])
def test_colour_depth_and_masks_by_the_words_in_names(depth, tmp_path):
    layout, words = LAYOUTS["faces"], "front right back left up down"
    folder = written(tmp_path / "room", layout, words, before="lit_")
    written(folder / "masks", layout, words, "object_mask")
    for word, face, planar in zip(
        words.split(), layout.arrangement, pictures(layout.arrangement, "depth"), strict=True
    ):
        view = View(Pose(CENTER, face.R_w_c), 90, EDGE, EDGE)
        along = planar * view.ray_lengths() * 1000 if depth == "ray-mm" else planar
        np.save(folder / f"{word}_depth.npy", along.astype(np.float32))
    at = ",".join(map(str, CENTER))
    words = f"recording import {folder} {tmp_path}/a.sqlite --depth {depth} --position {at}"
    assert cli.run(words.split()) == 0
    with omniscv.open_source(tmp_path / "a.sqlite") as source:
        image = omniscv.render(CAMERA, Pose.from_angles(CENTER), source, ("lit", "object_mask", "depth"))
    truth = traced(load_scene("four-wall"), CAMERA, Pose.from_angles(CENTER)).distance
    sure = np.isfinite(image.depth_error)
    off = np.abs(image.depth - truth)
    assert (off <= 2 * image.depth_error + 1e-4)[sure].mean() > 0.998
    assert seen(tmp_path / "a.sqlite") < 6


def test_a_panorama_becomes_six_faces(tmp_path):
    wide = omniscv.cameras.create("equirectangular", 512, 256)
    color = traced(load_scene("four-wall"), wide, Pose.from_angles(CENTER)).color
    Image.fromarray(np.uint8(255 * color + 0.5)).save(tmp_path / "pano.png")
    found = import_pictures(tmp_path / "pano.png", tmp_path / "room.sqlite", position=CENTER, yaw_deg=40)
    assert found.lines == ("layout latlong: 1 place, 1 of lit", "resampled to six faces")
    assert seen(tmp_path / "room.sqlite", yaw_deg=40) < 6


def test_what_is_no_cube_is_refused_with_what_is_expected(tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    Image.new("RGB", (70, 33)).save(tmp_path / "odd.png")
    five = written(tmp_path / "five", LAYOUTS["faces"], "front right back left up down")
    (five / "up.png").unlink()
    for given, says in (
        ("empty", "expected six pictures of faces, in colour, depth or masks, got none"),
        ("odd.png", "expected a picture of six faces as in strip, c6x1, c1x6"),
        ("five", "got 5 of lit: back, down, front, left, right"),
    ):
        assert cli.run(["recording", "import", str(tmp_path / given), str(tmp_path / "no.sqlite")]) == 2
        assert says in capsys.readouterr().err
    assert not (tmp_path / "no.sqlite").exists()


def test_faces_in_memory_are_a_source():
    layout, words = LAYOUTS["faces"], ["front", "right", "back", "left", "up", "down"]
    by_mode = {
        mode: dict(zip(words, pictures(layout.arrangement, mode), strict=True)) for mode in ("lit", "depth")
    }
    source = omniscv.sources.from_faces(by_mode["lit"], depth=by_mode["depth"], position=CENTER)
    image = omniscv.render(CAMERA, Pose.from_angles(CENTER), source, ("lit", "depth"), filter="nearest")
    truth = traced(load_scene("four-wall"), CAMERA, Pose.from_angles(CENTER))
    assert np.abs(image.lit - 255 * truth.color).mean() < 6
    assert np.median(np.abs(image.depth - truth.distance)) < 0.01
    for wrong, says in (
        (
            {**by_mode["lit"], "top": by_mode["lit"]["up"]},
            "expected faces front, right, back, left, up, down",
        ),
        ({**by_mode["lit"], "up": by_mode["lit"]["up"][:64]}, "expected six square faces of one size"),
    ):
        with pytest.raises(ArgumentError, match=says):
            omniscv.sources.from_faces(wrong)
