"""Published layouts of frames with poses, written by each convention, and judged by tracing."""

import json
from contextlib import closing

import numpy as np
import pytest
from PIL import Image
from support import published
from support.pictured import AT, FACES, SCENE, SMALL, THERE, face, judge, panorama, put, run, seen
from support.published import EDGE, FLAT, PANORAMAS, RIGS, THREE, TUM, TURNED, matrix, scaled

import omniscv
from omniscv import cli
from omniscv.chart import traced
from omniscv.errors import ArgumentError, BadReplyError
from omniscv.geometry import Pose
from omniscv.importing import sequences
from omniscv.importing.importing import import_pictures
from omniscv.pictures import png
from omniscv.sources import View, codecs
from omniscv.sources.base import Request
from omniscv.sources.recording.store import Store


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "ENV" / "P000"


@pytest.fixture
def file(tmp_path):
    return tmp_path / "a.sqlite"


@pytest.mark.parametrize("name", PANORAMAS)
def test_panoramas_and_faces_compose_to_what_is_there(name, folder, file, capsys):
    write, poses, says, modes = PANORAMAS[name]
    write(folder, poses)
    assert run(folder, file) == 0
    out = capsys.readouterr().out
    assert f"layout {name}: {len(poses)} place" in out
    assert says in out
    assert "heading" not in out
    for pose in poses:
        judge(file, pose, modes)


@pytest.mark.parametrize("name", FLAT)
def test_flat_pictures_are_views_with_their_lens_and_pose(name, folder, file, capsys):
    write, wanted, says, per_m = FLAT[name]
    write(folder, wanted)
    assert run(folder, file) == 0
    out = capsys.readouterr().out
    assert f"layout {name}: 2 places" in out
    assert says in out
    with omniscv.open_source(file) as source:
        recorded = source.recorded_views()
        for view in wanted:
            near = (v for v in recorded if v.width == view.width)
            (same,) = (v for v in near if np.allclose(v.pose.R_w_c, view.pose.R_w_c))
            np.testing.assert_allclose(same.pose.position, view.pose.position, atol=1e-6)
            np.testing.assert_allclose(same.projection, view.projection, atol=1e-6)
            (lit,) = source.capture([Request(same, "lit")])
            np.testing.assert_array_equal(lit.pixels, seen(view)[0])
            if per_m:
                (depth,) = source.capture([Request(same, "depth")])
                assert np.abs(depth.pixels - seen(view)[1]).max() <= 0.51 / per_m


def test_what_contradicts_itself_is_refused(folder, file, capsys):
    published.replica(folder / "a" / "b", published.views(THREE))
    (folder / "a/cam_params.json").write_text('{"camera": {"scale": 1000}}')
    published.tum(folder / "freiburg1" / "mine", published.views(THREE, **TUM), "nobody's")
    published.two_d_three_ds(folder / "c" / "d", [TURNED])
    pose = next((folder / "c/d/pano/pose").iterdir())
    said = json.loads(pose.read_text())
    pose.write_text(json.dumps(said | {"camera_location": [1, 2, 3]}))
    for name, says in (
        ("a/b", "scale: expected 6553.5 of a metre, got 1000"),
        ("freiburg1/mine", "expected --intrinsics FILE, a lens file, or a folder of the bench"),
        ("c/d", "expected a camera_rt_matrix that has its camera at camera_location"),
    ):
        assert run(folder / name, file) == 2
        assert says in capsys.readouterr().err
    assert not file.exists()
    pose.write_text(json.dumps({"camera_location": said["camera_location"]}))
    assert run(folder / "c/d", file) == 0
    assert "the heading of panoramas without camera_rt_matrix is not known" in capsys.readouterr().out
    with omniscv.open_source(file) as source:
        np.testing.assert_allclose(source.recorded_views()[0].pose.position, AT)


def test_a_named_layout_of_frames_is_taken_at_its_word(folder, file):
    published.tartanair(folder, RIGS)
    report = import_pictures(folder, file, "tartanground")
    assert report.lines[0].startswith("layout tartanground: 2 places")
    with closing(Store(file)) as store:  # pictures stay as received
        rows = [*store.rows()]
    assert {row.encoding for row in rows} == {"png", "png float32", "png ids"}
    assert {row.payload for row in rows} == {path.read_bytes() for path in folder.rglob("*.png")}
    with pytest.raises(ArgumentError, match="expected pictures of layout ob3d, got none"):
        import_pictures(folder, file, "ob3d")


def test_poses_that_contradict_each_other_are_named(folder, file):
    published.tartanair(folder, RIGS)
    top = folder / "pose_lcam_top.txt"
    lines = top.read_text().splitlines()
    lines[1] = (folder / "pose_lcam_left.txt").read_text().splitlines()[1]
    top.write_text("\n".join(lines))
    with pytest.raises(ArgumentError, match=r"top\.txt line 2: expected the front's turned up, off by 120"):
        import_pictures(folder, file)
    (folder / "pose_lcam_front.txt").unlink()
    with pytest.raises(ArgumentError, match=r"front\.txt: expected a file of poses, got none"):
        import_pictures(folder, file)
    assert not file.exists()


@pytest.mark.parametrize(
    ("write", "path", "text", "says"),
    [
        ("ob3d", "cameras/00001_cam.json", "[{}]", "expected a folder of layout ob3d, got KeyError"),
        ("tartanair", "pose_lcam_front.txt", "1 2\n", "line 1: expected names of the columns, or 8 or 17"),
        ("tartanair", "depth_lcam_top/000001_lcam_top_depth.png", "x", "expected a PNG"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(write, path, text, says, folder, file, capsys):
    getattr(published, write)(folder, RIGS)
    (folder / path).write_text(text)
    assert run(folder, file) == 2
    assert says in capsys.readouterr().err
    assert not file.exists()


VIEW = View(TURNED, 90, 2, 2)
PFM = b"Pf\n2 2\n-1.0\n" + np.array([[1, 1], [4, 4]], "<f4").tobytes()
CORNER = 1 / np.sqrt(1.5)  # the rays of 2 x 2 pixels of 90 degrees are sqrt(1.5) long


def test_encodings_have_their_known_answers():
    for encoding, payload, metres in (
        ("png carla", np.full((2, 2, 3), (92, 143, 2), np.uint8), 9.999991),
        ("png uint16 4000", np.array([[0, 4000], [8000, 2]], np.uint16), [[np.inf, 1], [2, 0.0005]]),
        ("png uint16 6553.5", np.full((2, 2), 13107, np.uint16), 2),
        ("png float32", np.full((2, 2, 4), (128, 0, 0, 63), np.uint8), 1.0),
        ("png float32", np.full((2, 2, 4), (72, 0, 0, 65), np.uint8), 12.5),
        ("png float32", np.full((2, 2, 4), (35, 194, 143, 68), np.uint8), 655.04),
        ("pfm planar", PFM, [[1, 1], [4, 4]]),  # the first row is the top one, as AirSim writes it
        ("pfm ray", PFM, [[CORNER, CORNER], [4 * CORNER, 4 * CORNER]]),
    ):
        payload = payload if isinstance(payload, bytes) else png.encode(payload)
        depth = codecs.decode(payload, encoding, "depth", VIEW)
        np.testing.assert_allclose(depth, np.full((2, 2), metres), rtol=1e-6)
        with pytest.raises(BadReplyError, match=r"expected 16 bytes of pixels in a PFM|expected a PNG"):
            codecs.decode(payload[:-1], encoding, "depth", VIEW)


def test_panoramas_with_truth_at_many_places(tmp_path, file, capsys):
    folder = tmp_path / "panos"
    poses = [Pose.from_angles(AT, yaw_deg=30), Pose.from_angles(THERE)]
    for name, pose in zip(("a", "b"), poses, strict=True):
        lit, distance, labels = panorama(pose)
        layers = {"rgb": lit, "depth": scaled(distance, 512), "semantic": np.uint8(labels)}
        for kind, pixels in layers.items():
            put(folder / f"{name}_{kind}.png", pixels)
    (tmp_path / "poses.csv").write_text("name,x,y,z,yaw\na_rgb.png,0.3,-0.2,1.45,30\nb,-0.4,0.5,1.2,0\n")
    (tmp_path / "names.json").write_text(json.dumps(["nothing", *sorted(SCENE.objects)]))
    words = ["--depth", "ray-1/512", "--missing", "65535", "--names", tmp_path / "names.json"]
    assert run(folder, file, *words) == 2
    assert "expected --poses FILE, or panoramas of one place, got 2 places" in capsys.readouterr().err
    assert run(folder, file, *words, "--poses", tmp_path / "poses.csv") == 0
    assert "layout latlong: 2 places, 2 of lit, 2 of depth, 2 of object_mask" in capsys.readouterr().out
    for pose in poses:
        judge(file, pose, ("lit", "depth", "object_mask"))
    with omniscv.open_source(file) as source:
        bound = omniscv.render(SMALL, poses[0], source, ("depth",)).depth_error
    assert np.median(bound) < 6 / 512  # steps of whole numbers; half a pixel changes depth by 16 mm
    assert run(folder, tmp_path / "b.sqlite", "--depth", "planar-mm", "--poses", tmp_path / "poses.csv") == 2
    assert "which have no optical axis, got planar" in capsys.readouterr().err


MINE = """
pictures: pinhole
place: 'color/(?P<i>\\d+)\\.png'
lit: 'color/{i}.png'
depth: {file: 'z/{i}.png', unit: 1/4000}
poses: {file: 'pose/{i}.txt', axes: opengl, inverse: true}
intrinsics: {fx: 32, fy: 32, cx: 31.5, cy: 31.5, centers: 0}
"""


def test_a_layout_of_the_user(tmp_path, file, capsys, monkeypatch):
    folder = tmp_path / "mine"
    layout = tmp_path / "mine.yaml"
    (folder / "pose").mkdir(parents=True)
    for i, word in enumerate([*FACES, "front"]):
        view = face(Pose.from_angles(AT), word, EDGE)
        put(folder / f"color/{i}.png", seen(view)[0])
        put(folder / f"z/{i}.png", scaled(seen(view)[1], 4000))
        R_c_w = (view.pose.R_w_c @ np.diag([1, -1, -1])).T
        pose = matrix(R_c_w, -R_c_w @ AT) if i < 6 else np.full((4, 4), -np.inf)
        np.savetxt(folder / f"pose/{i}.txt", pose)
    layout.write_text(MINE)
    assert run(folder, file, "--layout", layout) == 0
    out = capsys.readouterr().out
    assert "layout mine: 1 place, 6 of lit, 6 of depth" in out
    assert "1 frames left out: their poses are not finite" in out
    judge(file, Pose.from_angles(AT), ("lit", "depth"))
    monkeypatch.setattr(sequences, "_MOST_S", 1.0)
    (folder / ("a" * 60)).touch()
    for wrong, says in (
        (MINE.replace("z/{i}", "../z/{i}"), "expected a file in the folder, got '../z/0.png'"),
        (MINE.replace("z/{i}", "zz/{i}"), "depth: expected files zz/{i}.png, got none"),
        (MINE.replace("(?P<i>", "(?P<i"), "expected a folder of layout mine, got "),
        (MINE.replace("'color/(?P", "'(.+)+!color/(?P"), "place: expected a pattern that is matched with"),
    ):
        layout.write_text(wrong)
        assert run(folder, tmp_path / "b.sqlite", "--layout", layout) == 2
        assert says in capsys.readouterr().err


def test_an_import_that_finds_nothing_says_what_takes_the_pictures(tmp_path, file, capsys):
    folder = tmp_path / "mine"
    shown = published.views(THREE[:2])
    for i, view in enumerate(shown):
        put(folder / f"color/{i:04d}.png", seen(view)[0])
    assert run(folder, file) == 2
    assert "got 2 of lit: 0000, 0001; no poses; if they are posed, --poses" in capsys.readouterr().err
    rows = [" ".join(map(str, [*AT, *view.pose.quaternion()])) for view in shown]
    (folder / "trajectory.txt").write_text("\n".join(rows))
    assert run(folder, file) == 2
    (line,) = capsys.readouterr().err.splitlines()
    layout = line.partition("takes them, with ")[2].removesuffix(" in it")
    for word in ("FX", "FY", "CX", "CY"):
        layout = layout.replace(word, "32")
    (tmp_path / "my.yaml").write_text(layout)
    assert run(folder, file, "--layout", tmp_path / "my.yaml") == 0
    with omniscv.open_source(file) as source:
        for view, other in zip(source.recorded_views(), shown, strict=True):
            np.testing.assert_allclose(view.pose.R_w_c, other.pose.R_w_c, atol=1e-9)
            assert view.fov_deg == pytest.approx(90)


@pytest.mark.parametrize("model", ["pinhole", "equirectangular"])
def test_our_export_for_nerfstudio_comes_in_again(model, tmp_path, file, capsys):
    camera = {"model": model, "width": 96, "height": 64 if model == "pinhole" else 48}
    camera |= {"fov_deg": 80} if model == "pinhole" else {}
    angles = {"yaw_deg": 20.0, "pitch_deg": 10.0}
    poses = [Pose.from_angles(AT, **angles), Pose.from_angles(THERE)]
    job = {"source": "scene://four-wall", "cameras": {"cam": camera}, "modes": ["lit", "depth"]}
    job |= {"poses": [{"position": AT, **angles}, {"position": THERE}], "face_size": 128}
    (tmp_path / "job.yaml").write_text(json.dumps({**job, "out": str(tmp_path / "set")}))
    assert cli.run(["dataset", "make", str(tmp_path / "job.yaml")]) == 0
    nerf = tmp_path / "nerf"
    words = ["dataset", "export", str(tmp_path / "set"), "--to", "nerfstudio", "--out", str(nerf)]
    assert cli.run(words) == 0
    assert run(nerf, file) == 0
    assert "layout nerfstudio: 2 places, 2 of lit, 2 of depth" in capsys.readouterr().out
    with omniscv.open_source(file) as source:
        recorded = source.recorded_views()
        for pose, path in zip(poses, sorted((nerf / "images").iterdir()), strict=True):
            before = np.asarray(Image.open(path))
            if model == "pinhole":
                (view,) = (v for v in recorded if np.allclose(v.pose.position, pose.position, atol=1e-6))
                np.testing.assert_allclose(view.pose.R_w_c, pose.R_w_c, atol=1e-6)
                assert abs(view.fov_deg - 80) < 1e-9
                (lit,) = source.capture([Request(view, "lit")])
                np.testing.assert_array_equal(lit.pixels, before)
            else:
                image = omniscv.render(SMALL, pose, source, ("lit", "depth"), filter="nearest")
                assert np.abs(image.lit - before.astype(float))[4:-4].mean() < 5  # to faces and back
                off = np.abs(image.depth - traced(SCENE, SMALL, pose).distance)
                bounded = np.isfinite(image.depth_error)
                assert (off <= image.depth_error)[bounded].mean() > 0.99


def test_a_bent_picture_of_nerfstudio_is_made_straight(tmp_path, file, capsys):
    """A lens with distortion, traced through its own rays; judged by tracing what came in."""
    bent = {"k1": -0.2, "k2": 0.05, "p1": 0.002, "p2": -0.001}
    lens = {"fx": 90.0, "fy": 88.0, "cx": 66.0, "cy": 47.0}
    camera = omniscv.cameras.create("pinhole", 128, 96, **lens, distortion=[*bent.values()])
    pose = Pose.from_angles(AT, yaw_deg=35)
    put(tmp_path / "n/a.png", np.uint8(255 * traced(SCENE, camera, pose).color + 0.5))
    opengl = matrix(pose.R_w_c @ np.diag([1, -1, -1]), pose.position)
    frame = {"file_path": "./a", "transform_matrix": opengl.tolist()}
    given = {"fl_x": 90, "fl_y": 88, "cx": 66, "cy": 47, "w": 128, "h": 96, **bent, "frames": [frame]}
    (tmp_path / "n/transforms.json").write_text(json.dumps(given))
    assert run(tmp_path / "n", file) == 0
    assert "1 frames resampled to flat pictures" in capsys.readouterr().out
    with omniscv.open_source(file) as source:
        (view,) = source.recorded_views()
        (lit,) = source.capture([Request(view, "lit")])
    assert lit.pixels.min(axis=(0, 1)).max() > 0  # no black border
    assert np.abs(lit.pixels - seen(view)[0].astype(float)).mean() < 3
    frame["transform_matrix"] = (2 * opengl).tolist()
    (tmp_path / "n/transforms.json").write_text(json.dumps(given))
    assert run(tmp_path / "n", tmp_path / "b.sqlite") == 2
    assert "frames[0]: expected a matrix with the last row 0 0 0 1" in capsys.readouterr().err
