"""nerfstudio's transforms.json, by a reader of its conventions in numpy: nerfstudio itself needs torch."""

import json

import cv2
import numpy as np
import pytest
from support.traced_frames import black_frame, traced_frame

import mock_server
from omniscv import Pose, cameras
from omniscv.dataset import get

SCENE = mock_server.load_scene("four-wall")
BENDS = (0.02, -0.008, 0.002, -0.0004)
DISTORTION = (-0.1, 0.02, 0.003, -0.002, 0.01)
CAMERAS = {
    "EQUIRECTANGULAR": cameras.create("equirectangular", width=64, height=32),
    "OPENCV_FISHEYE": cameras.create("kannala-brandt", 48, 40, fx=15.0, fy=14.0, cx=23, cy=21, k=BENDS),
    "PINHOLE": cameras.create("pinhole", width=32, height=24, fov_deg=80, center=(15, 13)),
    "OPENCV": cameras.create("pinhole", 32, 24, fx=20.0, fy=21.0, cx=15.5, cy=11.0, distortion=DISTORTION),
}
POSES = [Pose.from_angles((0.3 * i, 0.1, 1.4), 33 * i, 7 * i, -5 * i) for i in range(3)]


def rays_of(data, frame, v, u):
    """(N, 3) origin and unit directions in the world of pixels in rows v and columns u.

    Cameras look along -z, x right, y up; a pixel's place is its index plus 0.5. Equirectangular: azimuth
    ``pi (u - cx) / fl_x`` and polar angle ``pi (0.5 + (v - cy) / fl_y)``. The others undo
    ``1 + k1 r^2 + k2 r^4 + k3 r^6 + k4 r^8`` and the tangential terms; r is then an angle for fisheyes.
    """
    x, y = (u + 0.5 - data["cx"]) / data["fl_x"], (v + 0.5 - data["cy"]) / data["fl_y"]
    if data["camera_model"] == "EQUIRECTANGULAR":
        theta = np.pi * x
        polar = np.pi * (0.5 + y)
        looking = [np.sin(theta) * np.sin(polar), np.cos(polar), -np.cos(theta) * np.sin(polar)]
    else:
        k1, k2, k3, k4, p1, p2 = (data.get(key, 0.0) for key in ("k1", "k2", "k3", "k4", "p1", "p2"))
        seen_x = x
        seen_y = y
        for _ in range(200):
            r2 = x**2 + y**2
            radial = 1 + r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * k4)))
            bent_x = 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
            bent_y = 2 * p2 * x * y + p1 * (r2 + 2 * y**2)
            x, y = (seen_x - bent_x) / radial, (seen_y - bent_y) / radial
        if data["camera_model"] == "OPENCV_FISHEYE":
            theta = np.hypot(x, y)
            looking = [x * np.sin(theta) / theta, -y * np.sin(theta) / theta, -np.cos(theta)]
        else:
            looking = [x, -y, -np.ones_like(x)]
    c2w = np.array(frame["transform_matrix"])
    directions = np.stack(looking, axis=-1) @ c2w[:3, :3].T
    return c2w[:3, 3], directions / np.linalg.norm(directions, axis=-1, keepdims=True)


@pytest.mark.parametrize("model", CAMERAS)
def test_its_rays_are_ours(model, tmp_path):
    camera = CAMERAS[model]
    frames = [black_frame(tmp_path, camera, pose, key=f"cam-{i}") for i, pose in enumerate(POSES)]
    get("nerfstudio").export(frames[::-1], tmp_path / "out", {})
    data = json.loads((tmp_path / "out/transforms.json").read_text())
    assert data["camera_model"] == model
    assert (data["w"], data["h"]) == (camera.width, camera.height)
    files = [frame["file_path"] for frame in data["frames"]]
    assert files == sorted(files) == [f"images/cam-{i}.png" for i in range(3)]
    rays = camera.unproject()
    v, u = np.nonzero(rays.valid)
    for frame, pose in zip(data["frames"], POSES, strict=True):
        origin, directions = rays_of(data, frame, v, u)
        np.testing.assert_allclose(origin, pose.position, atol=1e-12)
        np.testing.assert_allclose(directions, rays.directions[v, u] @ pose.rotation.T, atol=1e-9)


def test_several_cameras_get_a_folder_each_with_depth_and_masks(tmp_path):
    fisheye = cameras.create("fisheye-equidistant", width=40, height=40, fov_deg=170)
    shots = (("wide", fisheye), ("plain", CAMERAS["PINHOLE"]))
    frames = [traced_frame(tmp_path, SCENE, camera, POSES[0], name, name) for name, camera in shots]
    get("nerfstudio").export(frames, tmp_path / "out", {})
    for frame in frames:
        folder = tmp_path / "out" / frame.camera_name
        data = json.loads((folder / "transforms.json").read_text())
        (entry,) = data["frames"]
        depth = cv2.imread(str(folder / entry["depth_file_path"]), cv2.IMREAD_UNCHANGED)
        exact = frame.layer("depth").astype(float)
        if frame.camera_name == "plain":
            exact = exact * frame.camera.unproject().directions[..., 2]
        np.testing.assert_allclose(depth, 1000 * exact, atol=0.501)
        assert cv2.imread(str(folder / entry["file_path"])).shape[:2] == exact.shape
        assert ("mask_path" in entry) == (frame.camera_name == "wide")
    assert data["camera_model"] == "PINHOLE"
    wide = json.loads((tmp_path / "out/wide/transforms.json").read_text())
    assert [wide["camera_model"], *(wide[f"k{i}"] for i in (1, 2, 3, 4))] == ["OPENCV_FISHEYE", 0, 0, 0, 0]
    mask = cv2.imread(str(tmp_path / "out/wide" / wide["frames"][0]["mask_path"]), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(mask > 0, fisheye.valid())


def test_splits_are_lists_of_files_and_a_pinhole_with_skew_is_refused(tmp_path):
    camera = CAMERAS["EQUIRECTANGULAR"]
    splits = ("train", "val", "train")
    frames = [black_frame(tmp_path, camera, POSES[0], key=f"cam-{i}", split=s) for i, s in enumerate(splits)]
    get("nerfstudio").export(frames, tmp_path, {})
    data = json.loads((tmp_path / "transforms.json").read_text())
    assert data["train_filenames"] == ["images/cam-0.png", "images/cam-2.png"]
    assert (data["val_filenames"], data["test_filenames"]) == (["images/cam-1.png"], [])
    tilted = cameras.create("pinhole", 32, 24, fx=20.0, fy=21.0, cx=15.5, cy=11.0, skew=0.1)
    assert "pinhole" in get("nerfstudio").refuses(tilted)
