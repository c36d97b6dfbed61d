"""Omni3D files: vertices as its own reader makes them, and projections."""

import json
from dataclasses import replace

import numpy as np
import pytest
from support.observed import framed, observed

import mock_server
import omniscv
from omniscv import cameras, dataset
from omniscv.dataset.formats.coco import matrix_of
from omniscv.errors import ArgumentError

SCENE = mock_server.load_scene("four-wall")
POSE = omniscv.Pose.from_angles((-1.5, 0.2, 1.4), yaw_deg=5, pitch_deg=-8)
CAMERAS = {
    "pinhole": cameras.create("pinhole", width=160, height=120, fov_deg=80),
    "panorama": cameras.create("equirectangular", width=256, height=128),
    "circle": cameras.create("noncentral-panorama", width=64, height=32, radius=0.2),
}


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    folder = tmp_path_factory.mktemp("frames")
    with omniscv.open_source("scene://four-wall") as source:
        return {
            name: framed(observed(source, camera, POSE, face_size=96), folder, ("boxes3d",), name)
            for name, camera in CAMERAS.items()
        }


def written(frames, out):
    (file,) = dataset.get("omni3d").export(frames, out, {})
    return json.loads(file.read_text())


def vertices(record):
    """As cubercnn makes them: x along the length, y along the height, z along the width."""
    w, h, length = record["dimensions"]
    signs = [
        (-1, -1, -1),
        (1, -1, -1),
        (1, 1, -1),
        (-1, 1, -1),
        (-1, -1, 1),
        (1, -1, 1),
        (1, 1, 1),
        (-1, 1, 1),
    ]
    own = np.array(signs) * (length, h, w) / 2
    return own @ np.array(record["R_cam"]).T + record["center_cam"]


@pytest.mark.parametrize("name", CAMERAS)
def test_vertices_are_the_corners_of_the_objects(name, frames, tmp_path):
    data = written([frames[name]], tmp_path)
    assert data["annotations"]
    for each in data["annotations"]:
        corners = np.array(each["bbox3D_cam"])
        assert corners == pytest.approx(vertices(each), abs=1e-9)
        low, high = SCENE.bounds(each["name"])
        world = POSE.to_world(corners)
        assert (world.min(axis=0) <= low + 1e-6).all()
        assert (world.max(axis=0) >= high - 1e-6).all()
        if not each["name"].startswith("Chair"):
            assert world.min(axis=0) == pytest.approx(low, abs=1e-6)
            assert world.max(axis=0) == pytest.approx(high, abs=1e-6)
        assert np.linalg.det(each["R_cam"]) == pytest.approx(1)
        assert each["dimensions"][1] == pytest.approx(high[2] - low[2])  # the height
        assert POSE.R_w_c @ np.array(each["R_cam"])[:, 1] == pytest.approx([0, 0, -1])
        assert each["valid3D"]
        assert each["category_name"] == each["name"]


def test_a_pinhole_image_has_its_matrix_and_projections(frames, tmp_path):
    data = written([frames["pinhole"]], tmp_path)
    (image,) = data["images"]
    K = np.array(image["K"])
    assert (image["width"], image["height"], K.shape) == (160, 120, (3, 3))
    labels = frames["pinhole"].layer("labels")
    projected = 0
    for each in data["annotations"]:
        corners = np.array(each["bbox3D_cam"])
        rows, columns = np.nonzero(labels == each["instance_id"])
        tight = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
        assert each["bbox2D_tight"] == tight
        if (corners[:, 2] > 0).all():
            uvw = corners @ K.T
            uv = uvw[:, :2] / uvw[:, 2:]
            assert each["bbox2D_proj"] == pytest.approx([*uv.min(axis=0), *uv.max(axis=0)], abs=1e-6)
            inside = np.clip(each["bbox2D_proj"], 0, [160, 120, 160, 120])
            assert each["bbox2D_trunc"] == pytest.approx(inside)
            assert (np.array(tight)[:2] >= inside[:2] - 2).all()
            assert (np.array(tight)[2:] <= inside[2:] + 2).all()
            projected += 1
        else:
            assert each["bbox2D_proj"] == each["bbox2D_trunc"] == [-1, -1, -1, -1]
    assert projected >= 3


def test_only_cameras_that_keep_lines_straight_have_a_matrix():
    assert matrix_of(CAMERAS["pinhole"]) == pytest.approx(
        np.array([[(f := 80 / np.tan(np.radians(40))), 0, 80], [0, f, 60], [0, 0, 1]]), abs=1e-6
    )
    straight = {name for name in cameras.names() if matrix_of(cameras.model(name).example(64)) is not None}
    assert straight == {"pinhole"}


def test_panoramas_have_their_camera_in_place_of_the_matrix(frames, tmp_path):
    data = written([frames["panorama"], frames["pinhole"]], tmp_path)
    wide, narrow = data["images"]
    assert "K" not in wide
    assert "K" in narrow
    assert cameras.from_dict(wide["camera"]) == CAMERAS["panorama"]
    assert {each["visibility"] for each in data["annotations"]} == {-1}
    assert sorted(each["id"] for each in data["annotations"]) == [*range(1, 1 + len(data["annotations"]))]
    projected = [
        each for each in data["annotations"] if each["bbox2D_proj"][0] >= 0 and each["image_id"] == 1
    ]
    for each in projected:
        pixels = CAMERAS["panorama"].project(np.array(each["bbox3D_cam"]))[0]
        assert each["bbox2D_proj"] == pytest.approx([*pixels.min(axis=0), *pixels.max(axis=0)])
    assert len(projected) >= 5


def test_frames_without_boxes_are_refused(frames, tmp_path):
    bare = replace(frames["pinhole"], files={**frames["pinhole"].files, "truth": tmp_path / "t.json"})
    (tmp_path / "t.json").write_text("{}")
    with pytest.raises(ArgumentError, match="pinhole: expected the truth boxes3d, got none"):
        dataset.get("omni3d").export([bare], tmp_path, {})
