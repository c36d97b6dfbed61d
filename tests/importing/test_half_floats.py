"""Depth in half floats: their rounding reaches the bounds of images, whichever way the file comes in."""

import json

import numpy as np
import OpenImageIO
import pytest
from support.pictured import AT, FACES, SCENE, face, put, run, seen

import omniscv
from omniscv.chart import traced
from omniscv.geometry import Pose
from omniscv.importing.folders import import_folder

POSE = Pose.from_angles(AT)
EDGE = 128
OUT = omniscv.cameras.create("equirectangular", 128, 64)
WIDE = omniscv.cameras.create("equirectangular", 512, 256)
FISHEYE = omniscv.cameras.create("fisheye-equidistant", 128, 128, fov_deg=180)
BENT = omniscv.cameras.create(
    "pinhole", 256, 192, fx=150, fy=150, cx=128, cy=96, distortion=[-0.1, 0.01, 0, 0]
)
PLACE = ["--position", ",".join(map(str, AT))]


def save(file, numbers):
    """Write numbers of depth: NPY of half floats, or EXR or TIFF of them."""
    file.parent.mkdir(parents=True, exist_ok=True)
    if file.suffix == ".npy":
        np.save(file, numbers.astype(np.float16))
        return
    buffer = OpenImageIO.ImageBuf(np.ascontiguousarray(numbers[..., None], np.float32))
    if file.suffix == ".exr":
        buffer.specmod().channelnames = ("Z",)
    buffer.specmod().attribute("tiff:half", 1)  # else the library writes floats
    assert buffer.write(str(file), "half")


def judge(file, camera, pose=POSE, most_marked=0.15):
    """Depth is within its bounds, and these mark little."""
    with omniscv.open_source(file) as source:
        image = omniscv.render(camera, pose, source, ("depth",), unseen="blank")
    shown = image.valid
    truth = traced(SCENE, camera, pose).distance[shown]
    depth = image.depth[shown]
    bound = image.depth_error[shown]
    assert (np.abs(depth - truth) <= bound).mean() > 0.999
    assert (bound > 0.01 * truth).mean() < most_marked
    assert 2e-4 < np.median(bound) < 1e-2  # metres; a half float of 2 m is rounded by up to 1 mm


@pytest.mark.parametrize(
    ("suffix", "unit", "per_m"),
    [
        (".npy", "planar-m", 1),
        (".exr", "planar-m", 1),
        (".exr", "ray-m", 1),
        (".tif", "planar-m", 1),
        (".npy", "planar-cm", 100),
        (".npy", "ray-mm", 1000),
    ],
)
def test_faces(suffix, unit, per_m, tmp_path):
    for word in FACES:
        view = face(POSE, word, EDGE)
        lit, planar, _ = seen(view)
        lengths = view.ray_lengths() if unit.startswith("ray") else 1
        put(tmp_path / f"f/{word}.png", lit)
        save(tmp_path / f"f/{word}_depth{suffix}", planar * lengths * per_m)
    assert run(tmp_path / "f", tmp_path / "a.sqlite", "--depth", unit, *PLACE) == 0
    judge(tmp_path / "a.sqlite", OUT)


@pytest.mark.parametrize("unit", ["ray-m", "ray-cm"])
def test_a_panorama(unit, tmp_path):
    hits = traced(SCENE, WIDE, POSE)
    put(tmp_path / "f/a_rgb.png", np.uint8(255 * hits.color + 0.5))
    save(tmp_path / "f/a_depth.npy", hits.distance * (100 if unit == "ray-cm" else 1))
    assert run(tmp_path / "f", tmp_path / "a.sqlite", "--depth", unit, *PLACE) == 0
    judge(tmp_path / "a.sqlite", FISHEYE, most_marked=0.25)


@pytest.mark.parametrize("lens", ["distorted", "off-centre"])
def test_a_picture_of_a_lens(lens, tmp_path):
    camera = BENT
    if lens == "off-centre":
        camera = omniscv.cameras.create("pinhole", 256, 192, fx=150, fy=140, cx=120, cy=90)
    hits = traced(SCENE, camera, POSE)
    planar = hits.distance * camera.unproject(camera.pixels()).directions[..., 2]
    put(tmp_path / "f/a_rgb.png", np.uint8(255 * hits.color + 0.5))
    save(tmp_path / "f/a_depth.exr", planar)
    (tmp_path / "lens.json").write_text(json.dumps(camera.to_dict()))
    words = ["--intrinsics", tmp_path / "lens.json", "--depth", "planar-m", *PLACE]
    assert run(tmp_path / "f", tmp_path / "a.sqlite", *words) == 0
    judge(tmp_path / "a.sqlite", omniscv.cameras.create("pinhole", 96, 72, fov_deg=40), most_marked=0.3)


def test_a_folder_of_captures(tmp_path):
    """NPY of half floats, listed in captures.json."""
    entries = []
    for word in FACES:
        view = face(POSE, word, EDGE)
        save(tmp_path / f"f/{word}.npy", seen(view)[1])
        size = {"fov_deg": 90, "width": EDGE, "height": EDGE}
        placed = {"position": [*AT], "rotation": view.pose.R_w_c.tolist()}
        entries.append({"file": f"{word}.npy", "mode": "depth", "view": {**placed, **size}})
    (tmp_path / "f/captures.json").write_text(json.dumps(entries))
    import_folder(tmp_path / "f", tmp_path / "a.sqlite")
    judge(tmp_path / "a.sqlite", OUT)
