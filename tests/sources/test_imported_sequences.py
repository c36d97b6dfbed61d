"""Folders of frames with poses, written from an exact room by each convention, and judged by tracing.

The writers go from the camera's axes in the world to each convention, and share no formula with the importer.
"""

import json
from contextlib import closing

import cv2
import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

import omniscv
from mock_server import load_scene
from omniscv import cli
from omniscv.chart import traced
from omniscv.errors import ArgumentError, BadReplyError
from omniscv.geometry import Pose
from omniscv.pictures import png
from omniscv.sources import View, codecs
from omniscv.sources.recording.importing import import_pictures
from omniscv.sources.recording.store import Store

EDGE = 64
RIGS = [
    Pose.from_angles((0.3, -0.2, 1.45), yaw_deg=30, pitch_deg=10, roll_deg=5),
    Pose.from_angles((-0.4, 0.5, 1.2), yaw_deg=-100),
]
CAMERA = omniscv.cameras.create("equirectangular", 96, 48)
SCENE = load_scene("four-wall")
NED = np.array([1.0, -1.0, -1.0])


def axes(rig):
    """By face, the axes (right, down, ahead) of its camera, from those of the rig.

    The upper edge of bottom and the lower edge of top touch front.
    """
    r, d, f = rig.R_w_c.T
    return {
        "front": (r, d, f), "right": (-f, d, r), "back": (-r, d, -f), "left": (f, d, -r),
        "top": (r, f, -d), "bottom": (r, -f, d),
    }  # fmt: skip


def pictures(rig, of_axes):
    """What a camera of 90 degrees sees: colours (E, E, 3) uint8, planar depth (E, E), labels."""
    x = (np.arange(EDGE) + 0.5) * 2 / EDGE - 1
    rays = x[None, :, None] * of_axes[0] + x[:, None, None] * of_axes[1] + of_axes[2]
    hits = SCENE.trace(rig.position, rays)
    planar = hits.distance / np.linalg.norm(rays, axis=-1)
    return np.uint8(255 * hits.color + 0.5), planar.astype(np.float32), hits.label


def ned_line(rig, of_axes):
    """x y z qx qy qz qw of a camera, whose body is (ahead, right, down)."""
    right, down, ahead = of_axes
    turn = Rotation.from_matrix(NED[:, None] * np.stack([ahead, right, down], axis=1))
    return " ".join(f"{v:.6f}" for v in (*rig.position * NED, *turn.as_quat()))


def tartanair(folder):
    """TartanAir V2: depth is a float in the bytes of a PNG, masks are ids of classes."""
    for word in axes(RIGS[0]):
        camera = f"lcam_{word}"
        for kind in ("image", "depth", "seg"):
            (folder / f"{kind}_{camera}").mkdir(parents=True)
        lines = []
        for i, rig in enumerate(RIGS):
            lit, planar, labels = pictures(rig, axes(rig)[word])
            Image.fromarray(lit).save(folder / f"image_{camera}/{i:06}_{camera}.png")
            depth = folder / f"depth_{camera}/{i:06}_{camera}_depth.png"
            assert cv2.imwrite(str(depth), planar.view(np.uint8).reshape(EDGE, EDGE, 4))
            Image.fromarray((labels + 40).astype(np.uint8)).save(
                folder / f"seg_{camera}/{i:06}_{camera}_seg.png"
            )
            lines.append(ned_line(rig, axes(rig)[word]))
        (folder / f"pose_{camera}.txt").write_text("\n".join(lines) + "\n")
    names = {name: 41 + i for i, name in enumerate(SCENE.objects)}
    (folder.parent / "seg_label_map.json").write_text(json.dumps({"name_map": names}))


def ob3d(folder):
    """Panoramas with depth along the ray; poses are world to camera."""
    wide = omniscv.cameras.create("equirectangular", 512, 256)
    for kind in ("cameras", "images", "depths"):
        (folder / kind).mkdir(parents=True)
    for i, rig in enumerate(RIGS):
        hits = traced(SCENE, wide, rig)
        Image.fromarray(np.uint8(255 * hits.color + 0.5)).save(folder / f"images/{i:05}_rgb.png")
        depth = hits.distance.astype(np.float32)
        omniscv_exr(folder / f"depths/{i:05}_depth.exr", depth)
        outer = {"rotation": rig.R_w_c.T.tolist(), "translation": (-rig.R_w_c.T @ rig.position).tolist()}
        (folder / f"cameras/{i:05}_cam.json").write_text(json.dumps([{"extrinsics": outer}]))


def omniscv_exr(path, depth):
    import OpenImageIO

    buffer = OpenImageIO.ImageBuf(np.repeat(depth[..., None], 3, axis=-1))
    assert buffer.write(str(path), "float")


def tartanground(folder):
    """As TartanAir V2, and a file of metadata."""
    tartanair(folder)
    (folder / "P0000_metadata.json").write_text("{}")


@pytest.mark.parametrize("write", [tartanair, tartanground, ob3d])
def test_frames_with_poses_compose_to_what_is_there(write, tmp_path, capsys):
    folder = tmp_path / "ENV" / "P000"
    write(folder)
    assert cli.run(["recording", "import", str(folder), str(tmp_path / "a.sqlite")]) == 0
    assert f"layout {write.__name__}: 2 places" in capsys.readouterr().out
    with omniscv.open_source(tmp_path / "a.sqlite") as source:
        modes = tuple(sorted(source.capabilities.modes))
        for rig in RIGS:
            image = omniscv.render(CAMERA, rig, source, modes, filter="nearest")
            truth = traced(SCENE, CAMERA, rig)
            assert np.abs(image.lit - 255 * truth.color).mean() < 6  # 50 where two faces are exchanged
            if "depth" in modes:
                off = np.abs(image.depth - truth.distance) / truth.distance
                assert np.quantile(off, 0.9) < 0.02  # a panorama's depth is the nearest pixel's
            if "object_mask" in modes:
                assert (image["labels"] == truth.label).mean() > 0.97
    assert modes == (("depth", "lit") if write is ob3d else ("depth", "lit", "object_mask"))


def test_a_named_layout_of_frames_is_taken_at_its_word(tmp_path):
    tartanair(tmp_path / "P000")
    report = import_pictures(tmp_path / "P000", tmp_path / "a.sqlite", "tartanground")
    assert report.lines[0].startswith("layout tartanground: 2 places")
    with closing(Store(tmp_path / "a.sqlite")) as store:  # pictures stay as received
        rows = [*store.rows()]
    assert {row.encoding for row in rows} == {"png", "png float32", "png ids"}
    assert {row.payload for row in rows} == {file.read_bytes() for file in tmp_path.rglob("*.png")}
    with pytest.raises(ArgumentError, match="expected pictures of layout ob3d, got none"):
        import_pictures(tmp_path / "P000", tmp_path / "b.sqlite", "ob3d")


def test_poses_that_contradict_each_other_are_named(tmp_path):
    folder = tmp_path / "P000"
    tartanair(folder)
    top = folder / "pose_lcam_top.txt"
    lines = top.read_text().splitlines()
    lines[1] = (folder / "pose_lcam_left.txt").read_text().splitlines()[1]
    top.write_text("\n".join(lines))
    with pytest.raises(ArgumentError, match=r"top\.txt line 2: expected the front's turned up, off by 120"):
        import_pictures(folder, tmp_path / "a.sqlite")
    (folder / "pose_lcam_front.txt").unlink()
    with pytest.raises(ArgumentError, match=r"front\.txt: expected a file of poses, got none"):
        import_pictures(folder, tmp_path / "a.sqlite")
    assert not (tmp_path / "a.sqlite").exists()


@pytest.mark.parametrize(
    ("write", "file", "text", "says"),
    [
        (ob3d, "cameras/00001_cam.json", "[{}]", "expected a folder of layout ob3d, got KeyError"),
        (tartanair, "pose_lcam_front.txt", "1 2\n", "line 1: expected names of the columns, or 8 or 17"),
        (tartanair, "depth_lcam_top/000001_lcam_top_depth.png", "x", "expected a PNG"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(write, file, text, says, tmp_path, capsys):
    write(tmp_path / "P000")
    (tmp_path / "P000" / file).write_text(text)
    assert cli.run(["recording", "import", str(tmp_path / "P000"), str(tmp_path / "a.sqlite")]) == 2
    assert says in capsys.readouterr().err
    assert not (tmp_path / "a.sqlite").exists()


VIEW = View(RIGS[0], 90, 2, 2)
PFM = b"Pf\n2 2\n-1.0\n" + np.array([[1, 1], [4, 4]], "<f4").tobytes()
CORNER = 1 / np.sqrt(1.5)  # the rays of 2 x 2 pixels of 90 degrees are sqrt(1.5) long


@pytest.mark.parametrize(
    ("encoding", "payload", "metres"),
    [
        ("png carla", np.full((2, 2, 3), (92, 143, 2), np.uint8), 9.999991),
        ("png uint16 4000", np.array([[0, 4000], [8000, 2]], np.uint16), [[np.inf, 1], [2, 0.0005]]),
        ("png uint16 6553.5", np.full((2, 2), 13107, np.uint16), 2),
        ("png float32", np.full((2, 2, 4), (128, 0, 0, 63), np.uint8), 1.0),
        ("png float32", np.full((2, 2, 4), (72, 0, 0, 65), np.uint8), 12.5),
        ("png float32", np.full((2, 2, 4), (35, 194, 143, 68), np.uint8), 655.04),
        ("pfm planar", PFM, [[1, 1], [4, 4]]),  # the first row is the top one, as AirSim writes it
        ("pfm ray", PFM, [[CORNER, CORNER], [4 * CORNER, 4 * CORNER]]),
    ],
)
def test_encodings_have_their_known_answers(encoding, payload, metres):
    payload = payload if isinstance(payload, bytes) else png.encode(payload)
    depth = codecs.decode(payload, encoding, "depth", VIEW)
    np.testing.assert_allclose(depth, np.full((2, 2), metres), rtol=1e-6)
    with pytest.raises(BadReplyError, match=r"expected 16 bytes of pixels in a PFM|expected a PNG"):
        codecs.decode(payload[:-1], encoding, "depth", VIEW)
