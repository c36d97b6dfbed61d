"""Each key of a lens acts as in the program that wrote it, or is refused by name, at every door."""

import json

import numpy as np
import pytest
from PIL import Image

import omniscv
from omniscv import calibration, cli
from omniscv.errors import ArgumentError
from omniscv.importing.posed_frames import Options
from omniscv.importing.sequences import find_sequence

W = 64
H = 48
FOCAL = W / 2 / np.tan(0.5)
UPRIGHT = np.eye(4).tolist()
SIZE = {"w": W, "h": H}
HERE = omniscv.Pose.from_angles((0.2, 0.1, 1.4))
PLAIN = {"fl_x": 60, "fl_y": 61, "cx": 33, "cy": 23, **SIZE}


@pytest.fixture
def folder(tmp_path):
    """A picture, its depth and a mask of its left half."""
    (tmp_path / "f" / "images").mkdir(parents=True)
    Image.new("RGB", (W, H), (90, 120, 30)).save(tmp_path / "f/images/a.png")
    Image.fromarray(np.full((H, W), 1500, np.uint16)).save(tmp_path / "f/images/a-depth.png")
    left = np.uint8(np.arange(W) >= W // 2)[None].repeat(H, 0) * 255
    Image.fromarray(left).save(tmp_path / "f/images/a-mask.png")
    return tmp_path / "f"


def nerfstudio(folder, text_or_shared, **of_frame):
    frame = {"file_path": "images/a.png", "transform_matrix": UPRIGHT, **of_frame}
    shared = text_or_shared
    text = shared if isinstance(shared, str) else json.dumps({**shared, "frames": [frame]})
    (folder / "transforms.json").write_text(text)
    return find_sequence(folder, "nerfstudio", Options()).frames[0]


ACTS = [
    ({**SIZE, "camera_angle_x": 1.0, "camera_angle_y": 0.5}, (FOCAL, H / 2 / np.tan(0.25), 32, 24)),
    ({**SIZE, "camera_angle_x": 1.0}, (FOCAL, FOCAL, 32, 24)),
    ({"camera_angle_x": 1.0}, (FOCAL, FOCAL, 32, 24)),
    (PLAIN, (60, 61, 33, 23)),
    ({**PLAIN, "k5": 0, "k6": 0, "sharpness": 3, "aabb_scale": 16}, (60, 61, 33, 23)),
]


@pytest.mark.parametrize("of_frame", [False, True])
@pytest.mark.parametrize(("keys", "lens"), ACTS)
def test_keys_of_transforms_act(keys, lens, of_frame, folder):
    frame = nerfstudio(folder, {}, **keys) if of_frame else nerfstudio(folder, keys)
    np.testing.assert_allclose(frame.lens[:4], lens)
    assert frame.lens[4:6] == (W, H)


def test_keys_that_do_not_act_are_refused_by_name(folder):
    for keys, says in (
        ({"k5": 0.1}, "k5: expected no such key"),
        ({"distortion_params": [0.1, 0, 0, 0]}, "distortion_params: expected no such key"),
        ({"w": 1e9}, "w: expected a whole number"),
        ({"fl_x": 1e308}, "fx: expected a finite number"),
        ('{"fl_x": 60, "fl_x": 61, "w": 64, "h": 48, "frames": []}', "fl_x: expected this key once"),
        ('{"fl_x": 60, "cx": , "w": 64, "h": 48, "frames": []}', "expected JSON, got a key without a value"),
        ('{"fl_x": 60, "w": 64, "h": 48}', "expected a list 'frames'"),
    ):
        cases = [(keys, {})] if isinstance(keys, str) else [(PLAIN | keys, {}), (PLAIN, keys)]
        for shared, of_frame in cases:
            with pytest.raises(ArgumentError, match=says) as refusal:
                nerfstudio(folder, shared, **of_frame)
            assert "\n" not in str(refusal.value)


def test_the_scale_of_whole_numbers_masks_and_backslashes_act(folder, tmp_path, capsys):
    depth = "images\\a-depth.png"
    mask = "images\\a-mask.png"
    shared = {**PLAIN, "integer_depth_scale": 0.002}
    nerfstudio(folder, shared, file_path="images\\a.png", depth_file_path=depth, mask_path=mask)
    assert cli.run(["recording", "import", str(folder), str(tmp_path / "a.sqlite")]) == 0
    assert "1 frames are black, without label or surface, where masks are 0" in capsys.readouterr().out
    with omniscv.open_source(tmp_path / "a.sqlite") as source:
        (view,) = source.recorded_views()
        lit, deep = source.capture([omniscv.sources.Request(view, mode) for mode in ("lit", "depth")])
    np.testing.assert_array_equal(lit.pixels[:, W // 2 :], np.broadcast_to((90, 120, 30), (H, W // 2, 3)))
    assert not lit.pixels[:, : W // 2].any()
    np.testing.assert_allclose(deep.pixels[:, W // 2 :], 3.0, rtol=1e-6)
    assert np.isinf(deep.pixels[:, : W // 2]).all()


LAYOUT = """
pictures: pinhole
place: 'images/(?P<i>a)\\.png'
lit: 'images/{{i}}.png'
position: [0, 0, 0]
intrinsics: {}
"""
FLAT = "{fx: 60, fy: 61, cx: 32, cy: 23}"


def test_intrinsics_of_a_layout_are_checked(folder, tmp_path):
    for keys, says in (
        ("{fx: 0, fy: 60, cx: 32, cy: 24}", "fx: expected a finite number"),
        ("{fx: 60, fy: 60, cx: 32, cy: 24, centers: 7}", "centers: expected 0.5 or 0, got 7"),
        ("{fx: 60, fy: 60, cx: 32, cy: 24, distortion: [0.1, 0, 0]}", "distortion: expected"),
        ("{fx: 60, fy: 60, cx: 32}", "missing key"),
        ("{fx: 60, fx: 61, fy: 60, cx: 32, cy: 24}", "twice|once|duplicate"),
        ("{fx: 60, fy: 60, cx: 32, cy: 24, k7: 0.1}", "k7: expected no such key"),
        ("3", "expected a mapping"),
        (f"{FLAT}\nfound: rgb.txt", "found: expected no key that acts on nothing"),
        (f"{FLAT}\nfaces: gl", "faces: expected no key that acts on nothing"),
    ):
        (tmp_path / "my.yaml").write_text(LAYOUT.format(keys))
        with pytest.raises(ArgumentError, match=says) as refusal:
            find_sequence(folder, str(tmp_path / "my.yaml"), Options())
        assert "\n" not in str(refusal.value)


def test_intrinsics_of_a_layout_act(folder, tmp_path):
    keys = "{fx: 60, fy: 61, cx: 32, cy: 23, centers: 0, distortion: [0.1, 0.01, 0, 0]}"
    (tmp_path / "my.yaml").write_text(LAYOUT.format(keys))
    (frame,) = find_sequence(folder, str(tmp_path / "my.yaml"), Options()).frames
    assert frame.lens == (60, 61, 32.5, 23.5, W, H, (0.1, 0.01, 0, 0, 0))


def test_one_picture_with_depth_and_a_lens_file_of_another_form(tmp_path, capsys):
    camera = omniscv.cameras.create("pinhole", W, H, fx=60, fy=61, cx=33, cy=23)
    (tmp_path / "rgbd").mkdir()
    Image.new("RGB", (W, H), (90, 120, 30)).save(tmp_path / "rgbd/rgb.png")
    Image.fromarray(np.full((H, W), 1500, np.uint16)).save(tmp_path / "rgbd/depth.png")
    lens = tmp_path / "rgbd" / "intrinsics.json"
    file = tmp_path / "x.sqlite"
    calibration.save(lens, {"1": camera}, "colmap")
    words = ["recording", "import", str(tmp_path / "rgbd"), str(file), "--depth", "planar-mm"]
    assert cli.run([*words, "--intrinsics", str(lens)]) == 0, capsys.readouterr().err
    with omniscv.open_source(file) as source:
        (view,) = source.recorded_views()
        (depth,) = source.capture([omniscv.sources.Request(view, "depth")])
    np.testing.assert_allclose(depth.pixels, 1.5, rtol=1e-6)
    assert view.fov_deg == pytest.approx(2 * np.degrees(np.arctan(W / 2 / 60)))
    np.testing.assert_allclose((view.lens.x, view.lens.y), (1 / W, -1 / H), atol=1e-12)


def test_pictures_of_a_fisheye_come_in_flat(tmp_path):
    """What is seen from there afterwards is what was seen there before, within bounds, or is not seen."""
    camera = omniscv.cameras.create("kannala-brandt", 160, 120, fx=70, fy=72)
    with omniscv.open_source("scene://workshop") as source:
        image = omniscv.render(camera, HERE, source, modes=("lit", "depth"))
        pinhole = omniscv.cameras.create("pinhole", 48, 32, fx=40, fy=40)
        due = omniscv.render(pinhole, HERE, source, modes=("depth",))
    (tmp_path / "f").mkdir()
    Image.fromarray(image.lit).save(tmp_path / "f/rgb.png")
    np.save(tmp_path / "f/depth.npy", np.where(image.valid, image.depth, 0))
    calibration.save(tmp_path / "lens.json", {"cam0": camera}, "json")
    words = ["recording", "import", str(tmp_path / "f"), str(tmp_path / "x.sqlite"), "--depth", "ray-m"]
    words += ["--position=0.2,0.1,1.4", "--intrinsics", str(tmp_path / "lens.json")]
    assert cli.run(words) == 0
    with omniscv.open_source(tmp_path / "x.sqlite") as source:
        (view,) = source.recorded_views()
        assert 60 < view.fov_deg <= 120.1
        got = omniscv.render(pinhole, HERE, source, modes=("depth",))
    known = np.isfinite(got.depth_error) & got.valid
    off = np.abs(got.depth - due.depth)[known]
    assert known.mean() > 0.7
    assert (off <= got.depth_error[known]).mean() > 0.998
    # On surfaces depth is interpolated: half a pixel of this lens changes it by 5 to 20 mm.
    assert np.median(off) < 1e-3


def test_a_lens_with_many_centres_is_refused(tmp_path):
    Image.new("RGB", (64, 48)).save(tmp_path / "rgb.png")
    camera = omniscv.cameras.model("push-broom").example(64)
    calibration.save(tmp_path / "lens.json", {"cam0": camera}, "json")
    with pytest.raises(ArgumentError, match="expected a lens with one centre, got push-broom"):
        find_sequence(tmp_path, "auto", Options(intrinsics=tmp_path / "lens.json"))


def test_a_lens_file_stands_in_place_of_what_a_folder_says(folder, tmp_path):
    camera = omniscv.cameras.create("pinhole", W, H, fx=70, fy=71, cx=31, cy=22)
    calibration.save(tmp_path / "lens.json", {"cam0": camera}, "json")
    nerfstudio(folder, PLAIN)
    (tmp_path / "my.yaml").write_text(LAYOUT.format(FLAT))
    for layout in ("nerfstudio", str(tmp_path / "my.yaml")):
        (frame,) = find_sequence(folder, layout, Options(intrinsics=tmp_path / "lens.json")).frames
        assert frame.lens == (70, 71, 31, 22, W, H, ())
