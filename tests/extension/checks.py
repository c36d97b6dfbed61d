"""What an outsider adds by public names alone works through ``render``, a job and the command line."""

import inspect
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import OpenImageIO
import outsider
import pytest
from PIL import Image

import omniscv
from omniscv import cli, dataset, jobs
from omniscv.testing import check_camera

POSE = omniscv.Pose.from_angles((0.0, 0.0, 0.0), yaw_deg=20.0)
CAMERA = outsider.Lambert(384, 128)
MODES = ("lit", "object_mask", "depth")


def squares(camera):
    """Whether each pixel's ray meets a light square."""
    x, y, z = np.moveaxis(camera.unproject().directions @ POSE.R_w_c.T, -1, 0)
    return (np.arctan2(y, x) // np.radians(10) + np.arctan2(z, np.hypot(x, y)) // np.radians(10)) % 2 == 1


@pytest.mark.parametrize(
    "kind", ["Lambert", "Checkerboard", "DepthFirst", "Rough", "write_ppm", "brightness", "Table"]
)
def test_each_takes_at_most_forty_lines(kind):
    assert len(inspect.getsource(getattr(outsider, kind)).splitlines()) <= 40


def test_an_outsider_uses_public_names_alone():
    text = Path(outsider.__file__).read_text(encoding="utf-8")
    own = {"_unproject", "_project", "_source"}  # what subclasses of Camera and SourceWrapper write or use
    words = {word for word in text.replace("(", " ").replace(".", " ").split() if word.startswith("_")}
    assert {word.rstrip("):,") for word in words} <= own | {"__init__", "_", "__init__()"}


def test_a_camera_keeps_the_contract():
    assert omniscv.cameras.model("lambert") is outsider.Lambert
    check_camera(outsider.Lambert(96, 32))


def test_a_camera_and_a_source_through_render():
    with omniscv.open_source("checker://") as source:
        image = omniscv.render(CAMERA, POSE, source, MODES, face_size=256)
    light = squares(CAMERA)
    assert (image.labels == np.where(light, 2, 1)).mean() > 0.98
    np.testing.assert_allclose(image.depth, 5.0, rtol=1e-4)
    assert image.objects.names() == ["Dark", "Light"]
    assert (image.object_mask[image.labels == 2] == image.objects.colors["Light"]).all()


def test_a_source_without_a_wire_is_recorded_and_replayed(tmp_path):
    path = tmp_path / "checker.sqlite"
    with omniscv.open_source("checker://") as live, omniscv.record(live, path) as source:
        captured = omniscv.render(CAMERA, POSE, source, MODES, face_size=96)
    with omniscv.open_source(path) as replay:
        again = omniscv.render(CAMERA, POSE, replay, MODES, face_size=96)
    for layer in captured.layers:
        np.testing.assert_array_equal(again[layer], captured[layer])


def test_a_strategy_is_sent_what_it_keeps():
    with omniscv.open_source("checker://") as source:
        own = omniscv.render(CAMERA, POSE, source, MODES, strategy="depth-first", face_size=96)
        faces = omniscv.render(CAMERA, POSE, source, MODES, strategy="faces", face_size=96)
    for layer in faces.layers:
        np.testing.assert_array_equal(own[layer], faces[layer])
    assert outsider.DepthFirst.nearest == pytest.approx(5 / np.sqrt(3), rel=0.2)  # near a cube's corner


def test_a_modality_is_composed_and_written(tmp_path):
    camera = omniscv.cameras.create("fisheye-equidistant", width=64, height=64, fov_deg=180)
    with omniscv.open_source("rough:checker://") as source:
        image = omniscv.render(camera, POSE, source, ("lit", "roughness"), face_size=96)
        image.save(tmp_path, stem="rough")
    assert (image["roughness"][image.valid] == 0.5).all()
    assert (image["roughness"][~image.valid] == -1.0).all()
    written = OpenImageIO.ImageInput.open(str(tmp_path / "rough.roughness.exr"))
    assert written.spec().channelnames == ("Y",)
    np.testing.assert_array_equal(written.read_image("float")[..., 0], image["roughness"])


JOB = """
source: rough:checker://
cameras: {{broom: {{model: lambert, width: 384, height: 128}}}}
poses: [{{position: [0, 0, 0], yaw_deg: 20}}]
modes: [lit, object_mask, depth, roughness]
strategy: depth-first
face_size: 256
image_format: ppm
out: {out}
"""


def test_all_of_them_through_a_job(tmp_path):
    (tmp_path / "job.yaml").write_text(JOB.format(out="images"), encoding="utf-8")
    written = jobs.run(jobs.load(tmp_path / "job.yaml"))
    assert {path.name for path in written} >= {"broom.lit.ppm", "broom.roughness.exr", "broom.labels.png"}
    with Image.open(tmp_path / "images" / "broom.lit.ppm") as picture:
        lit = np.asarray(picture)
    assert ((lit[..., 0] > 128) == squares(CAMERA)).mean() > 0.95


def test_a_plan_of_a_strategy_lists_it(tmp_path):
    (tmp_path / "job.yaml").write_text(JOB.format(out="images"), encoding="utf-8")
    found = {cost.strategy: cost for cost in jobs.costs(jobs.load(tmp_path / "job.yaml"))}
    assert found["depth-first"].requests == found["faces"].requests


def test_all_of_them_through_the_command_line(tmp_path):
    """In a process of its own, where the package is found by its entry point."""
    site = tmp_path / "site"
    info = site / "outsider-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: outsider\nVersion: 1.0\n", encoding="utf-8")
    (info / "entry_points.txt").write_text(
        "[omniscv.plugins]\noutsider = outsider\n[omniscv.sources]\nchecker = outsider:open_checkerboard\n",
        encoding="utf-8",
    )
    (site / "outsider.py").write_text(Path(outsider.__file__).read_text(encoding="utf-8"), encoding="utf-8")
    command = [
        sys.executable, "-c", "from omniscv.cli import main; main()", "render", "--source", "checker://",
        "--camera", "lambert", "--size", "384x128", "--position", "0,0,0", "--modes", "lit,object_mask,depth",
        "--set", "strategy=depth-first", "--set", "image_format=ppm", "--out", str(tmp_path / "out"),
    ]  # fmt: skip
    paths = os.pathsep.join([str(site), *sys.path])
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, env={**os.environ, "PYTHONPATH": paths}
    )
    assert done.returncode == 0, done.stderr
    with Image.open(tmp_path / "out" / "lambert.lit.ppm") as lit:
        assert lit.size == (384, 128)
    labels = cv2.imread(str(tmp_path / "out" / "lambert.labels.png"), cv2.IMREAD_UNCHANGED)
    assert set(np.unique(labels)) == {1, 2}


def test_the_command_line_lists_them(capsys):
    assert cli.run(["cameras", "lambert"]) == 0
    assert "Lambert" in capsys.readouterr().out


DATASET = """
source: checker://
cameras: {{broom: {{model: lambert, width: 96, height: 32}}}}
poses: [{{position: [0, 0, 0]}}, {{position: [0, 0, 0], yaw_deg: 5}}]
modes: [lit, object_mask, depth]
image_format: ppm
truth: {{brightness: {{scale: 0.5}}}}
export: [{export}]
out: dataset
"""


def test_a_truth_and_a_format_through_a_dataset(tmp_path):
    """Made, exported again without the source, and checked."""
    (tmp_path / "job.yaml").write_text(DATASET.format(export="table"), encoding="utf-8")
    jobs.make(jobs.load(tmp_path / "job.yaml"))
    out = tmp_path / "dataset"
    assert dataset.check(out, deep=True) == []
    (path,) = dataset.export(out, "table", tmp_path / "again")
    assert path.read_bytes() == (out / "exports" / "table" / "table.csv").read_bytes()
    found = {tuple(line.split(",")) for line in path.read_text(encoding="utf-8").splitlines()}
    assert {(key, name) for key, name, _ in found} == {
        (f"broom-{i}", name) for i in (0, 1) for name in ("Dark", "Light")
    }
    means = {name: float(mean) for _, name, mean in found}
    assert means["Dark"] < 45 < 80 < means["Light"]  # half of 40 and 220, blended where squares are small
    path = out / "exports" / "table" / "table.csv"
    path.write_text("wrong", encoding="utf-8")
    assert dataset.check(out, format="table") == [
        "exports/table: table.csv: expected what the frames give, got other bytes"
    ]


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (
            "model: lambert",
            "model: noncentral-panorama, radius: 1",
            "table: cannot carry camera 'broom': its pixels",
        ),
        ("{brightness: {scale: 0.5}}", "{brightness: false}", "table: expected frames with truth"),
        (
            "modes: [lit, object_mask, depth]",
            "modes: [lit, depth]",
            "truth.brightness: expected modes with labels",
        ),
    ],
)
def test_what_they_cannot_carry_is_refused_before_the_source_is_opened(old, new, says, tmp_path):
    text = DATASET.format(export="table").replace("checker://", "checker-missing://").replace(old, new)
    (tmp_path / "job.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(omniscv.OmniscvError) as failed:
        jobs.make(jobs.load(tmp_path / "job.yaml"))
    assert says in str(failed.value)
