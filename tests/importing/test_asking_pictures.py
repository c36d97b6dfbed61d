"""Folders of posed pictures whose words are wrong, and what their pictures say: rooms drawn by formulas."""

import json
from contextlib import closing
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.overlapping import MISDESCRIBED, WORLDS, asked, convention, noisy, room, written

from omniscv import cli
from omniscv.diagnostics import posed_pictures
from omniscv.errors import ArgumentError
from omniscv.importing.conventions import Convention, Verdict, Words
from omniscv.importing.importing import import_pictures
from omniscv.sources.base import Request
from omniscv.sources.recording.replay import RecordedSource
from omniscv.sources.recording.store import Store

SOME = ("unreal, cm", "world to camera, along the ray", "w first", "late")


@pytest.fixture(scope="module")
def shots():
    return room(1, count=10)


@pytest.fixture(scope="module")
def few():
    return room(3, count=4)


def verdict_of(shots, name):
    told, right = MISDESCRIBED[name]
    pictures = {key: told[key] for key in ("depth", "ray") if key in told}
    R, t = written(shots, **{key: value for key, value in told.items() if key not in pictures})
    words = Words(quaternions="order" in told)
    return asked(shots, words, R, t, **pictures), convention(**right)


@pytest.mark.parametrize("name", SOME)
def test_pictures_tell_the_convention_of_poses(few, shots, name):
    verdict, right = verdict_of(shots if name == "late" else few, name)
    assert verdict.best.convention == right
    assert verdict.contradicts
    assert verdict.best.mean > 0.5 > 2 * verdict.said.mean


def test_sound_words_are_confirmed_and_what_pictures_cannot_tell_is_said():
    sound = noisy(room(2, count=4), 2, much=2.5, moving=0.06)
    line = asked(sound, Words()).line()
    assert line.startswith("pictures: as said, camera-to-world, axes camera, planar depth: agreement 0.")
    assert "cannot tell" not in line
    turned = asked(room(3, count=4, still=True), Words())
    assert not turned.contradicts
    assert "cannot tell" in turned.line()
    assert "units" in turned.line()
    nothing = room(4, count=4)
    nothing.depth[:] = np.random.default_rng(0).uniform(1, 4, nothing.depth.shape)
    random = asked(nothing, Words())
    assert not random.contradicts
    assert random.line().startswith("pictures cannot tell their convention: they agree by 0.")


LAYOUT = """
pictures: pinhole
place: 'color/(?P<i>\\d+)\\.png'
lit: 'color/{i}.png'
depth: {file: 'depth/{i}.png', kind: planar, unit: mm}
poses: {file: poses.txt, row: i%s}
intrinsics: {fx: %g, fy: %g, cx: %g, cy: %g}
%s
"""
RIGHT = ", axes: opengl, inverse: true"


def write_frames(shots, folder, poses, lit="color/{}.png", depth="depth/{}.png", per_m=5000):
    """Write the pictures of a folder, and its poses as matrices of 12 or 16 numbers a line."""
    for i in range(len(shots.R)):  # not in the order of their names as texts
        for name, pixels in (
            (lit, shots.lit[i][..., ::-1]),
            (depth, np.uint16(np.round(per_m * shots.depth[i]))),
        ):
            (file := folder / name.format(i)).parent.mkdir(exist_ok=True)
            cv2.imwrite(str(file), pixels)
    (folder / poses[0]).write_text("\n".join(" ".join(f"{v:.9f}" for v in row.ravel()) for row in poses[1]))


@pytest.fixture
def folder(few, tmp_path):
    """Writes a folder whose poses are OpenGL's from the world to the camera, with depth of 1/5000 m."""
    R, t = written(few, axes="opengl", inverse=True)
    write_frames(few, tmp_path, ("poses.txt", np.concatenate([R, t[..., None]], axis=-1)))

    def layout(poses="", more=""):
        (tmp_path / "my.yaml").write_text(LAYOUT % (poses, *few.lens, more))
        return tmp_path, tmp_path / "a.sqlite", str(tmp_path / "my.yaml")

    return layout


def test_words_that_pictures_contradict_are_refused_with_those_to_write(folder, capsys):
    path, file, layout = folder()
    args = ["recording", "import", str(path), str(file), "--layout", layout]
    assert cli.run(args) == 2
    said, words = capsys.readouterr().err.replace("\n", " ").split("; write ")
    assert "world-to-camera, axes opengl, planar depth of 1/5000 m: agreement 0." in said
    assert words.startswith("poses: {axes: opengl, inverse: true} in a layout and --depth planar-1/5000; or")
    assert not file.exists()
    assert cli.run([*args, "--trust-words"]) == 0
    assert "; taken as said" in capsys.readouterr().out


def test_a_layout_that_asks_comes_in_by_its_pictures(folder, few):
    path, file, layout = folder(more="asks: true")
    assert import_pictures(path, file, layout).lines[1].endswith("; taken as pictures show")
    right = path / "right.sqlite"
    said = import_pictures(path, right, folder(RIGHT)[2], depth="planar-1/5000")
    assert said.lines[1].startswith("pictures: as said, world-to-camera, axes opengl")
    with closing(Store(file)) as asked_, closing(Store(right)) as named:
        assert [row.payload for row in asked_.rows()] == [row.payload for row in named.rows()]
    with RecordedSource(file) as source:
        views = source.recorded_views()
    relative = [views[0].pose.R_w_c.T @ view.pose.R_w_c for view in views]
    np.testing.assert_allclose(relative, few.R[0].T @ few.R, atol=1e-6)


def test_a_mirror_of_replica_in_other_axes_and_units_comes_in(few, tmp_path):
    R, t = written(few, axes="opengl")
    last = np.tile([[[0.0, 0, 0, 1]]], (len(R), 1, 1))
    matrices = np.concatenate([np.concatenate([R, t[..., None]], axis=-1), last], axis=1)
    names = "results/frame{:06}.png", "results/depth{:06}.png"
    write_frames(few, tmp_path, ("traj.txt", matrices), *names, per_m=1000)
    lens = dict(zip(("fx", "fy", "cx", "cy"), few.lens, strict=True))
    camera = {**lens, "cx": lens["cx"] - 0.5, "cy": lens["cy"] - 0.5, "w": 96, "h": 72, "scale": 6553.5}
    (tmp_path / "cam_params.json").write_text(json.dumps({"camera": camera}))
    taken = import_pictures(tmp_path, tmp_path / "a.sqlite")
    assert "camera-to-world, axes opengl, planar depth of 1/1000 m" in taken.lines[1]
    assert taken.lines[1].endswith("; taken as pictures show")
    with RecordedSource(tmp_path / "a.sqlite") as source:
        views = source.recorded_views()
        (depth,) = source.capture([Request(views[0], "depth")])
    np.testing.assert_allclose(depth.pixels, few.depth[0], atol=1e-3)
    np.testing.assert_allclose([view.pose.position for view in views], few.t, atol=1e-6)


def test_fisheye_frames_are_asked_by_their_lens_file(few, tmp_path):
    size = 96
    focal = 40.0
    v, u = np.mgrid[:size, :size] + 0.5 - size / 2
    theta = np.hypot(u, v) / focal
    side = np.tan(theta) / np.maximum(np.hypot(u, v), 1e-9)
    maps = [np.float32(f * axis * side + c - 0.5) for f, axis, c in ((81.6, u, 48), (81.6, v, 36))]
    along = few.depth * np.linalg.norm(few.rays(), axis=-1)
    lens = {"camera_model": "OPENCV_FISHEYE", "fl_x": focal, "fl_y": focal, "cx": size / 2, "cy": size / 2}
    lens |= {"w": size, "h": size, "k1": 0, "k2": 0, "k3": 0, "k4": 0, "frames": []}
    (tmp_path / "lens.json").write_text(json.dumps(lens))
    rows = []
    for i, (R, t) in enumerate(zip(*written(few, axes="opengl", per_m=100), strict=True)):
        lit, depth = (cv2.remap(each[i], *maps, cv2.INTER_NEAREST) for each in (few.lit, np.float32(along)))
        cv2.imwrite(str(tmp_path / f"{i}_rgb.png"), lit[..., ::-1])
        np.save(tmp_path / f"{i}_depth.npy", depth)
        rows.append(" ".join([str(i), *(f"{x:.9f}" for x in (*t, *Rotation.from_matrix(R).as_quat()))]))
    (tmp_path / "poses.txt").write_text("\n".join(rows))
    said = {"poses": tmp_path / "poses.txt", "intrinsics": tmp_path / "lens.json", "depth": "ray-m"}
    with pytest.raises(ArgumentError, match="write --frame opengl and --unit cm; or --trust-words"):
        import_pictures(tmp_path, tmp_path / "a.sqlite", "pinhole", **said)
    taken = import_pictures(tmp_path, tmp_path / "a.sqlite", "pinhole", frame="opengl", unit="cm", **said)
    assert any(line.startswith("pictures: as said, camera-to-world, axes opengl") for line in taken.lines)


@pytest.mark.soak
@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("spoil", [None, (1, 0), (2.5, 0.06)])
def test_every_misdescription_is_told(spoil, world):
    for seed in range(30, 34):
        shots = room(seed, count=10, world=world)
        shots = noisy(shots, seed, *spoil) if spoil else shots
        for name in MISDESCRIBED:
            verdict, right = verdict_of(shots, name)
            assert verdict.contradicts, name
            assert right in (verdict.best.convention, *verdict.tied), name


SOUND = {
    "noisy": {"count": 10}, "plain": {"count": 10, "boxes": 0, "plain": True},
    "line": {"count": 12, "straight": True}, "turns": {"count": 10, "still": True}, "two": {"count": 2},
    "far": {"count": 6, "step_deg": 35.0},
}  # fmt: skip


@pytest.mark.soak
@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("kind", SOUND)
def test_sound_folders_are_never_refused(kind, world):
    for seed in range(4):
        shots = room(seed, world=world, **SOUND[kind])
        for each in (shots, noisy(shots, seed, 2.5, 0.06)):
            for quaternions in (False, True):
                assert not asked(each, Words(quaternions=quaternions)).contradicts


@pytest.mark.parametrize(
    ("words", "median", "ratio", "metres", "per_m"),
    [
        (Words(), 3.0, 1000.0, 0.001, 1.0),  # floats of plausible metres: positions are in mm
        (Words(), 3000.0, 0.001, 1.0, 1000.0),  # no plausible metres: depth is in mm
        (Words(per_m=1000.0), 3.0, 0.25, 1.0, 4000.0),  # whole numbers of another known unit
        (Words(per_m=1000.0), 3.0, 0.3, 1 / 0.3, 1000.0),  # of an unknown one: positions
        (Words(metres=0.01), 3000.0, 1e-9, 0.01 / 1e-9, 1.0),  # depth that is never plausible
    ],
    ids=["positions in mm", "depth in mm", "depth in quarters", "no known unit", "nowhere plausible"],
)
def test_a_ratio_is_one_of_depth_where_that_is_known_and_plausible_else_of_positions(
    words, median, ratio, metres, per_m
):
    found = Verdict(words, median=median).units(Convention(ratio=ratio))
    assert found == pytest.approx((metres, per_m))


@pytest.mark.parametrize("has_best", [False, True])
def test_pictures_that_cannot_tell_their_convention_name_no_fault(has_best, monkeypatch):
    """Whether a convention scored best, or none did."""
    score = SimpleNamespace(convention=Convention(), mean=0.9)
    best = score if has_best else None
    verdict = Verdict(Words(), best, best, why="too few frames overlap" if has_best else "")
    monkeypatch.setattr(posed_pictures, "ask", lambda pictures, words: verdict)
    monkeypatch.setattr(posed_pictures, "_values", lambda *_: [])
    (found,) = posed_pictures.examine_pictures(
        SimpleNamespace(R=np.eye(3)[None], t=np.zeros((1, 3))), Words()
    )
    assert (found.name, found.verdict) == ("convention", "warning")
    assert found.value.startswith("cannot tell their convention")
