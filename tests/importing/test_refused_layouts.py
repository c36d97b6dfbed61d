"""What a layout cannot be is refused with what to write instead; lists of objects by frame name masks."""

import json

import numpy as np
import pytest
from PIL import Image
from support.pictured import AT, SCENE, THERE, face, put, run, seen
from support.published import views

import omniscv
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.importing.folders import import_folder
from omniscv.importing.posed_frames import Options
from omniscv.importing.sequences import find_sequence

FRAME = {"file_path": "a.png", "transform_matrix": np.eye(4).tolist()}
SHARED = {"fl_x": 4, "w": 8, "h": 8}


def scaled(by):
    matrix = np.eye(4)
    matrix[:3, :3] *= by
    return {**SHARED, "frames": [{**FRAME, "transform_matrix": matrix.tolist()}]}


def mirrored():
    matrix = np.diag([1.0, -1, 1, 1]).tolist()
    return {**SHARED, "frames": [{**FRAME, "transform_matrix": matrix}]}


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ({**SHARED, "frames": []}, r"transforms\.json: expected frames, got"),
        ([FRAME], "expected a mapping with .* 'frames', got a list; write"),
        ([], "expected a list 'frames', got none"),
        ({**SHARED, "frames": [3]}, "frames: expected mappings with file_path"),
        (scaled(0.01), r"it is a rotation times 0\.01, as MatrixCity's .*: divide its nine numbers by that"),
        (mirrored(), "its axes are mirrored: say those of the file"),
    ],
    ids=["no frames", "a list", "an empty list", "numbers", "scaled", "mirrored"],
)
def test_transforms_that_are_none(content, says, tmp_path):
    Image.new("RGB", (8, 8)).save(tmp_path / "a.png")
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    with pytest.raises(ArgumentError, match=says) as refusal:
        find_sequence(tmp_path, "nerfstudio", Options())
    assert "\n" not in str(refusal.value)
    assert "Error" not in str(refusal.value)


MINE = """
pictures: pinhole
place: 'rgb_(?P<i>\\d+)\\.png'
lit: 'rgb_{{i}}.png'
intrinsics: {{fx: 32, fy: 32, cx: 32, cy: 32}}
{}
"""


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        (
            "poses: {file: p.txt, row: i, rotation: rotation}",
            r"poses\.rotation: expected it beside position",
        ),
        ("poses: {file: p.txt, matrix: m}", r"poses\.matrix: expected it beside position only"),
        ("poses: {file: p.json, row: i, position: p}", r"poses\.row: expected none beside position"),
    ],
)
def test_keys_of_poses_that_do_not_fit_each_other(keys, says, tmp_path):
    Image.new("RGB", (64, 64)).save(tmp_path / "rgb_0.png")
    (tmp_path / "p.txt").write_text("1 2 3 0 0 0 1\n")
    (tmp_path / "my.yaml").write_text(MINE.format(keys))
    with pytest.raises(ArgumentError, match=says):
        find_sequence(tmp_path, str(tmp_path / "my.yaml"), Options())


@pytest.mark.parametrize("form", ["colours", "ids"])
def test_lists_of_objects_by_frame(form, tmp_path):
    """As Isaac's: a list beside each mask, in which one object has another colour, or id, in each frame."""
    draw = np.random.default_rng(5)
    views = [face(Pose.from_angles(AT), word, 64) for word in ("front", "left")]
    names = sorted(SCENE.objects)
    rows = []
    for i, view in enumerate(views):
        lit, _, labels = seen(view)
        codes = draw.permutation(np.arange(1, 200))[: len(names) + 1]
        codes[0] = 0
        put(tmp_path / f"f/rgb_{i}.png", lit)
        if form == "ids":
            put(tmp_path / f"f/ids_{i}.png", np.uint8(codes[labels]))
            listed = {str(codes[k]): name for k, name in enumerate(names, start=1)}
        else:
            put(tmp_path / f"f/ids_{i}.png", np.uint8(np.dstack([codes[labels], labels * 0, labels * 0])))
            listed = {f"({codes[k]}, 0, 0, 255)": {"class": name} for k, name in enumerate(names, start=1)}
            listed["(0, 0, 0, 0)"] = {"class": "BACKGROUND"}
        (tmp_path / f"f/ids_{i}.json").write_text(json.dumps(listed))
        rows.append(" ".join(map(str, [*AT, *view.pose.quaternion()])))
    (tmp_path / "f/p.txt").write_text("\n".join(rows))
    masks = "object_mask: {file: 'ids_{i}.png', names: 'ids_{i}.json'}\nposes: {file: p.txt, row: i}"
    (tmp_path / "my.yaml").write_text(MINE.format(masks))
    assert run(tmp_path / "f", tmp_path / "a.sqlite", "--layout", tmp_path / "my.yaml") == 0
    with omniscv.open_source(tmp_path / "a.sqlite") as source:
        known = source.objects()
        for view in views:
            (own,) = (v for v in source.recorded_views() if np.allclose(v.pose.R_w_c, view.pose.R_w_c))
            (mask,) = source.capture([omniscv.sources.Request(own, "object_mask")])
            expected = np.array([0, *(known.ids[name] for name in names)])[seen(view)[2]]
            np.testing.assert_array_equal(mask.pixels, expected)


WALK = [Pose.from_angles(at, 20 + 9 * i, 4 * (i % 3), 3 * (i % 2)) for at in (AT, THERE) for i in range(4)]


@pytest.mark.parametrize(
    ("turned", "says"),
    [
        ({"depth"}, "write depth with left and right exchanged, as numpy.fliplr does (colours are as"),
        ({"depth", "lit"}, "write --mirrored; or"),
        ({"lit"}, "write colours with left and right exchanged, as numpy.fliplr does (depth is as"),
    ],
    ids=["depth alone", "both", "colours alone"],
)
def test_mirrored_pictures_are_refused_with_what_puts_them_right(turned, says, tmp_path, capsys):
    poses = {}
    for i, view in enumerate(views(WALK, size=(128, 96))):
        lit, depth, _ = seen(view)
        put(tmp_path / f"f/rgb_{i}.png", lit[:, ::-1] if "lit" in turned else lit)
        np.save(tmp_path / f"f/depth_{i}.npy", depth[:, ::-1] if "depth" in turned else depth)
        poses[f"rgb_{i}.png"] = {
            "position": view.pose.position.tolist(),
            "rotation": view.pose.R_w_c.tolist(),
        }
    (tmp_path / "p.json").write_text(json.dumps(poses))
    fx, fy, cx, cy = view.projection
    camera = omniscv.cameras.create("pinhole", 128, 96, fx=fx, fy=fy, cx=cx, cy=cy)
    (tmp_path / "lens.json").write_text(json.dumps({"omniscv": 1, **camera.to_dict()}))
    words = ["--intrinsics", tmp_path / "lens.json", "--poses", tmp_path / "p.json", "--frame", "camera"]
    assert run(tmp_path / "f", tmp_path / "a.sqlite", *words) == 2
    assert says in capsys.readouterr().err
    if turned == {"depth", "lit"}:
        assert run(tmp_path / "f", tmp_path / "a.sqlite", *words, "--mirrored") == 0
    elif turned == {"lit"}:
        assert run(tmp_path / "f", tmp_path / "a.sqlite", *words, "--trust-words") == 0
        for file in (tmp_path / "f").glob("*.png"):
            put(file, np.asarray(Image.open(file))[:, ::-1])
        assert run(tmp_path / "f", tmp_path / "b.sqlite", *words) == 0


def test_a_panorama_with_depth_that_leans_needs_the_word_too(tmp_path, capsys):
    (tmp_path / "f").mkdir()
    Image.new("RGB", (16, 8)).save(tmp_path / "f/a_rgb.png")
    np.save(tmp_path / "f/a_depth.npy", np.full((8, 16), 2, np.float32))
    (tmp_path / "p.csv").write_text("name,x,y,z,yaw,pitch\na_rgb.png,1,2,3,30,10\n")
    words = [tmp_path / "f", tmp_path / "a.sqlite", "--poses", tmp_path / "p.csv"]
    assert run(*words) == 2
    assert (
        "expected --frame, because the pose of 'a_rgb.png' turns by more than yaw" in capsys.readouterr().err
    )
    assert run(*words, "--trust-words") == 2
    assert run(*words, "--frame", "body") == 0


@pytest.mark.parametrize(
    ("masks", "ids", "says"),
    [
        (
            np.full((4, 4, 3), 9, np.uint8),
            {"Sofa": 7},
            r"captures\.json\[0\]: expected ids, as masks\.json lists",
        ),
        (np.full((4, 4), 7, np.uint16), {}, r"captures\.json\[0\]: expected colours, as objects\.json lists"),
    ],
    ids=["colours beside ids", "ids beside colours"],
)
def test_captures_whose_masks_a_list_cannot_name_are_refused(masks, ids, says, tmp_path):
    np.save(tmp_path / "m.npy", masks)
    view = {"position": [0, 0, 1], "fov_deg": 90, "width": 4, "height": 4}
    entry = {"file": "m.npy", "mode": "object_mask", "view": view}
    (tmp_path / "captures.json").write_text(json.dumps([entry]))
    if not ids:
        (tmp_path / "objects.json").write_text(json.dumps({"Sofa": [9, 9, 9]}))
    (tmp_path / "masks.json").write_text(json.dumps({"ids": ids}))
    with pytest.raises(ArgumentError, match=says):
        import_folder(tmp_path, tmp_path / "a.sqlite")
