"""What the doctor says of posed pictures: faults that were put in, with their sizes; of sound ones none."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.overlapping import noisy, read, room

from omniscv import cli
from omniscv.diagnostics.posed_faults import PAIRS, WIDTH
from omniscv.diagnostics.posed_pictures import examine_pictures, find
from omniscv.geometry import Pose
from omniscv.importing.conventions import Words
from omniscv.importing.overlap import PosedPictures, Shot

SIZE = {"count": 16, "width": 112, "height": 84, "step_deg": 7.0}


def scaled(shots, fx=1.0, fy=1.0, x=0.0, y=0.0):
    a, b, cx, cy = shots.lens
    return replace(shots, lens=(a / fx, b / fy, cx - x, cy - y))


def along(shots, k):
    return replace(shots, depth=shots.depth * np.linalg.norm(shots.rays(), axis=-1) ** k)


def beside(shots, scale=1.0, x=0.0, y=0.0):
    """Shots whose colours are larger than depth, and lie beside it, px."""
    height, width = shots.depth.shape[1:]
    a = (1 - scale) * (width - 1) / 2 + x
    b = (1 - scale) * (height - 1) / 2 + y
    M = np.array([[scale, 0, a], [0, scale, b]])
    how = {"flags": cv2.INTER_CUBIC, "borderMode": cv2.BORDER_REFLECT}
    lit = [cv2.warpAffine(each, M, (width, height), **how) for each in shots.lit]
    return replace(shots, lit=np.stack(lit))


def changed(shots, change):
    return replace(shots, depth=change(shots.depth))


FAULTY = {
    "focal length": (lambda room: scaled(room(), 1.02, 1.02), np.log(1.02)),
    "aspect": (lambda room: scaled(room(), 1.01, 1 / 1.01), 2 * np.log(1.01)),
    "centre, x": (lambda room: scaled(room(), x=1.5), 1.5),
    "centre, y": (lambda room: scaled(room(), y=-1.5), -1.5),
    "scale of depth": (lambda room: changed(room(), lambda depth: depth / 1.02), np.log(1.02)),
    "offset of depth": (lambda room: changed(room(), lambda depth: depth - 0.03 * np.median(depth)), 0.03),
    "planar depth, towards along the ray": (lambda room: along(room(), 0.4), 0.4),
    "radial distortion k1": (lambda room: room(k1=0.03), 0.03),
    "time of pictures after poses": (lambda room: room(late=0.3), 0.3),
    "rolling shutter, top to bottom": (lambda room: room(rolling=0.5), 0.5),
    "focal length of colours": (lambda room: beside(room(), 1.04), np.log(1.04)),
    "colours, x": (lambda room: beside(room(), x=3), 3.0),
    "colours, y": (lambda room: beside(room(), y=-3), -3.0),
}
"""By the parameter, shots that have it off, and by how much."""
OTHER = {
    "mirrored": (
        lambda room: replace(s := room(), lit=s.lit[:, :, ::-1]),
        "colours over depth",
        "mirrored: 0.",
    ),
    "late": (
        lambda room: replace(s := room(), lit=np.concatenate([s.lit[:1], s.lit[:-1]])),
        "colours over depth",
        "of 1 frames later",
    ),
    "piled": (
        lambda room: changed(room(), lambda depth: np.minimum(depth, 2.5)),
        "values of depth",
        "have the greatest",
    ),
    "steps": (lambda room: changed(room(), lambda depth: np.round(depth, 1)), "steps of depth", "0.1 at"),
    "moving": (lambda room: noisy(room(), much=0.01, moving=0.3), "surfaces that are gone", "%"),
}
"""Other faults, by the finding that has another verdict than ok, and how it reads."""


def making(seed, world="boxes", spoiled=False):

    def make(**told):
        shots = room(seed, world=world, **{**SIZE, **told})
        return noisy(shots, seed) if spoiled else shots

    return make


def found_in(shots):
    found = find(read(shots, pairs=PAIRS, most=WIDTH), shots.R, shots.t, along=False)
    return {fault.parameter.name: fault for fault in found.faults}


def check_named(name, make):
    of, size = FAULTY[name]
    found = found_in(of(make))
    assert [*found] == [name]
    assert abs(found[name].size - size) < 3 * found[name].sigma


def test_a_fault_is_named_with_its_size():
    """Of one parameter; the focal length's is the next test's."""
    check_named("colours, x", lambda **told: making(2)(count=12, **told))


def test_nothing_is_named_in_sound_pictures_or_from_few_frames():
    values = examined(making(4, spoiled=True)(count=9))
    assert {finding.verdict for finding in values.values()} == {"ok"}
    assert values["lens, scale and time"].value == "nothing is off beyond doubt"
    few = scaled(making(2)(count=6), 1.02, 1.02)
    assert examined(few)["faults"].value == "none is named from fewer than 8 frames"


def examined(shots):
    found = examine_pictures(read(shots, pairs=PAIRS, most=WIDTH), Words())
    return {finding.name: finding for finding in found}


def check_other(name, make):
    of, finding, says = OTHER[name]
    found = examined(of(make))[finding]
    assert found.verdict != "ok"
    assert says in found.value


@pytest.mark.parametrize("name", ["mirrored", "piled"])
def test_colours_and_values_that_do_not_belong_to_depth(name):
    make = making(5)
    check_other(name, lambda **told: make(count=7, **told))


def test_the_horizon_of_flat_ground_is_no_sentinel():
    """Level pictures, 1.5 m above the ground: a row of pixels has the greatest planar depth."""
    height = 120
    width = 160
    focal = 131.0
    below = np.arange(height) + 0.5 - height / 2
    rows = np.where(below > 0, 1.5 * focal / np.maximum(below, 0.5), 0).astype(np.float32)
    depth = np.repeat(rows[:, None], width, axis=1)
    shot = Shot(depth, None, (focal, focal, width / 2, height / 2))
    t = np.array([[0.1 * i, 0, 1.5] for i in range(4)])
    level = np.repeat(Pose.from_angles((0, 0, 0)).R_w_c[None], 4, axis=0)
    pictures = PosedPictures.read(level, t, lambda i, most: shot, np.radians(60), PAIRS, WIDTH)
    assert (depth == depth.max()).sum() > 0.008 * depth.size  # as many as of a sentinel
    assert "values of depth" not in {finding.name for finding in examine_pictures(pictures, Words())}


def test_the_doctor_takes_a_folder(tmp_path, capsys):
    shots = scaled(making(2)(count=8), 1.03, 1.03)
    count = 8
    for name in ("rgb", "depth"):
        (tmp_path / name).mkdir()
    rows = np.column_stack([np.arange(count) / 10, shots.t, Rotation.from_matrix(shots.R).as_quat()])
    (tmp_path / "groundtruth.txt").write_text("\n".join(" ".join(f"{v:.8f}" for v in row) for row in rows))
    for name in ("rgb", "depth"):
        (tmp_path / f"{name}.txt").write_text("\n".join(f"{i / 10} {name}/{i}.png" for i in range(count)))
    for i in range(count):
        cv2.imwrite(str(tmp_path / f"rgb/{i}.png"), shots.lit[i][..., ::-1])
        cv2.imwrite(str(tmp_path / f"depth/{i}.png"), np.uint16(np.round(5000 * shots.depth[i])))
    keys = dict(zip(("fx", "fy", "cx", "cy"), shots.lens, strict=True))
    size = {"width": SIZE["width"], "height": SIZE["height"]}
    (tmp_path / "lens.json").write_text(json.dumps(keys | size))
    args = ["doctor", str(tmp_path), "--intrinsics", str(tmp_path / "lens.json"), "--json"]
    assert cli.run(args) == 1
    values = {row["name"]: row for row in json.loads(capsys.readouterr().out)}
    assert values["convention"]["value"].startswith("as said, camera-to-world, axes camera, planar depth")
    assert values["focal length"]["verdict"] == "bad"
    assert values["focal length"]["value"].startswith("off by +2.9")
    assert cli.run(["doctor", "mock://four-wall", "--layout", "tum"]) == 2
    assert "layout: expected a folder of frames with poses" in capsys.readouterr().err


@pytest.mark.soak
@pytest.mark.parametrize("world", ["boxes", "mesh", "mujoco"])
@pytest.mark.parametrize("name", [*FAULTY, *OTHER])
def test_every_fault_is_named_with_its_size(name, world):
    for seed in (6, 7, 8):
        (check_named if name in FAULTY else check_other)(name, making(seed, world))


@pytest.mark.soak
@pytest.mark.parametrize("world", ["boxes", "mesh", "mujoco"])
def test_no_fault_is_named_in_sound_pictures(world):
    for seed in range(6):
        assert not found_in(making(seed, world)())
        assert not found_in(making(seed, world, spoiled=True)())
