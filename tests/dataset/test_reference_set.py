"""The reference set by formulas of others: lenses by pycolmap, poses and depth by nerfstudio and gsplat."""

import json
import re
import runpy
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from PIL import Image
from support.command_line import ROOT

import mock_server
from omniscv import dataset
from omniscv.job import read
from omniscv.make import make

LENSES = ("pinhole", "kannala-brandt")


def load_script():
    """The script's names; it takes the scenes from a module beside it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / "scripts"))
        return runpy.run_path(str(ROOT / "scripts/make-reference"))


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """An eighth of the size, two poses, the two lenses that other programs hold."""
    script = load_script()
    folder = tmp_path_factory.mktemp("reference")
    job = script["described"](8)
    job |= {"cameras": {name: job["cameras"][name] for name in LENSES}, "poses": job["poses"][:2]}
    make(read(job, folder))
    (folder / "lenses").mkdir()
    for frame in dataset.open(folder / "set"):
        script["write_lenses"](folder / "lenses", frame.camera_name, frame.camera)
    return folder


def rays_by_gsplat(lens, pixels):
    """(H, W, 3) unit rays of pixels, camera frame, by the formulas that gsplat and nerfstudio publish."""
    x, y = ((pixels[..., i] - lens[f"c{a}"]) / lens[f"fl_{a}"] for i, a in enumerate("xy"))
    if lens["camera_model"] == "PINHOLE":
        rays = np.stack([x, y, np.ones_like(x)], axis=-1)
    else:
        r = np.hypot(x, y)
        theta = np.linspace(0, 2.1, 200_000)  # looked up, where they iterate
        powers = sum(lens.get(f"k{i}", 0.0) * theta ** (2 * i + 1) for i in (1, 2, 3, 4))
        theta = np.interp(r, theta + powers, theta)
        scale = np.sin(theta) / np.maximum(r, 1e-12)
        rays = np.stack([x * scale, y * scale, np.cos(theta)], axis=-1)
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


@pytest.mark.parametrize("name", LENSES)
def test_poses_depth_and_lens_meet_the_surfaces(name, reference):
    """Depth of a pinhole is planar, of others along the ray, as trainers of splats take it: in whole mm."""
    folder = reference / "set/exports/nerfstudio" / name
    scene = mock_server.load_scene("four-wall")
    lens = json.loads((folder / "transforms.json").read_text())
    pixels = np.stack(np.meshgrid(np.arange(lens["w"]) + 0.5, np.arange(lens["h"]) + 0.5), axis=-1)
    rays = rays_by_gsplat(lens, pixels)
    for frame in lens["frames"]:
        pose = np.array(frame["transform_matrix"])
        depth_m = np.asarray(Image.open(folder / frame["depth_file_path"])) / 1000
        distance_m = depth_m / rays[..., 2] if name == "pinhole" else depth_m
        directions = rays * (1, -1, -1) @ pose[:3, :3].T  # OpenGL's axes
        true_m = scene.trace(np.broadcast_to(pose[:3, 3], directions.shape), directions).distance
        known = depth_m > 0
        assert known.mean() > 0.7
        assert np.abs(distance_m - true_m)[known].max() < 0.02  # of faces of 60 px, inexact left out


def test_the_pinhole_as_lichtfeld_studio_reads_it(reference):
    """As its ``transforms.cpp`` and ``kernels_forward.cuh`` of 2026 have it: the camera's y and z turn round,
    the world is turned about Y, a point is seen at x fx + cx, pixel centres are at .5."""
    folder = reference / "set/exports/nerfstudio/pinhole"
    lens = json.loads((folder / "transforms.json").read_text())
    frames = {frame.key: frame for frame in dataset.open(reference / "set")}
    for entry in lens["frames"]:
        frame = frames[Path(entry["file_path"]).stem]
        to_world = np.array(entry["transform_matrix"]) @ np.diag([1, -1, -1, 1])
        to_camera = np.linalg.inv(to_world) @ np.diag([-1, 1, -1, 1])  # of its world
        rays = frame.camera.unproject()
        depth = frame.layer("depth")
        seen = np.isfinite(depth) & (depth > 0)
        points_w = frame.pose.to_world((depth[..., None] * rays.directions)[seen])
        points = points_w * (-1, 1, -1) @ to_camera[:3, :3].T + to_camera[:3, 3]
        pixels = points[:, :2] / points[:, 2:] * (lens["fl_x"], lens["fl_y"]) + (lens["cx"], lens["cy"])
        np.testing.assert_allclose(pixels, frame.camera.pixels()[seen], atol=1e-6)


@pytest.mark.parametrize("name", LENSES)
def test_lens_files_are_pycolmaps(name, reference):
    (line,) = re.findall(r"(?m)^[^#].*", (reference / f"lenses/{name}.colmap.txt").read_text())
    _, model, width, height, *numbers = line.split()
    params = [*map(float, numbers)]
    camera = pycolmap.Camera(model=model, width=int(width), height=int(height), params=params)
    frame = next(each for each in dataset.open(reference / "set") if each.camera_name == name)
    rays = frame.camera.unproject()
    ahead = rays.valid & (rays.directions[..., 2] > 0.1)
    pixels = camera.img_from_cam(rays.directions[ahead])
    np.testing.assert_allclose(pixels, frame.camera.pixels()[ahead], atol=1e-6)


def test_what_looks_at_no_picture_is_scored(reference):
    load_script()["score_trivial"](reference)
    report = json.loads((reference / "score/report.json").read_text())
    assert report["prediction"] == "constant"
    assert len(report["images"]) == 4
    depths = [frame.layer("depth") for frame in dataset.open(reference / "set")]
    known = np.concatenate([depth[np.isfinite(depth) & (depth > 0)] for depth in depths])
    depth = next(frame.layer("depth") for frame in dataset.open(reference / "set"))
    guess = np.load(next((reference / "trivial/constant").glob("*.npy")))
    assert guess.shape == depth.shape
    assert (guess == np.float32(np.median(known))).all()
    worst = report["mean"]["by_solid_angle"]["abs_rel"]
    assert report["beside"]["median"]["mean"]["by_solid_angle"]["abs_rel"] < worst < 1
