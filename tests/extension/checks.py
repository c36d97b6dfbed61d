"""What docs/extending.md and docs/datasets.md add by public names works in jobs, datasets and commands."""

import ast
import os
import re
import subprocess
import sys
from inspect import cleandoc
from types import ModuleType

import numpy as np
import OpenImageIO
import pytest
from support.command_line import ROOT
from support.documents import blocks
from support.recordings import CountingSource

import omniscv
from omniscv import cli, dataset, planning
from omniscv.job import load
from omniscv.make import costs, make, run
from omniscv.testing import check_camera

POSE = omniscv.Pose.from_angles((0, 0, 1.5), yaw_deg=20)
MOST_LINES = 40


def definitions(page):
    """The statements of a page's Python that import, define or register."""
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    for block in blocks(text):
        if block.language == "python" and "register" in block.text:
            for node in ast.parse(block.text).body:
                source = ast.get_source_segment(block.text, node)
                decorators = [f"@{ast.unparse(each)}\n" for each in getattr(node, "decorator_list", ())]
                registers = isinstance(node, ast.Expr) and "register" in source
                if registers or isinstance(node, (ast.ClassDef, ast.FunctionDef, ast.ImportFrom)):
                    yield "".join(decorators) + source


OUTSIDER = [each for page in ("extending.md", "datasets.md") for each in definitions(page)]
TEXT = "\n".join(["import numpy as np", "import omniscv", "from omniscv import dataset", *OUTSIDER])
sys.modules["outsider"] = outsider = ModuleType("outsider")
exec(TEXT, vars(outsider))
CAMERA = omniscv.cameras.create("fisheye-thoby", 64, 64, focal=22.0)


def shows_the_sky(lit):
    """Whether an image has the grey of the page's sky, where each pixel's ray looks."""
    grey = 127.5 * (1 + (CAMERA.unproject().directions @ POSE.R_w_c.T)[..., 2])
    off = np.abs(lit[..., 0] - grey)[CAMERA.valid()]
    return off.mean() < 1.5 and off.max() < 10


def test_every_kind_takes_at_most_forty_lines_and_public_names():
    names = {"FisheyeThoby", "Sky", "Sparse", "Rough", "farthest", "Keys"}
    assert names <= vars(outsider).keys()
    assert all(each.count("\n") < MOST_LINES for each in OUTSIDER)
    assert set(re.findall(r"\b_[a-z]\w*", TEXT)) == {"_directions", "_project"}  # what a camera implements
    check_camera(CAMERA)


def test_a_source_is_rendered_recorded_and_replayed(tmp_path):
    path = tmp_path / "sky.sqlite"
    with omniscv.open_source("sky://") as live, omniscv.record(live, path) as source:
        image = omniscv.render(CAMERA, POSE, source, ("lit", "depth"), face_size=96)
    assert shows_the_sky(image.lit)
    assert np.isposinf(image.depth[image.valid]).all()
    with omniscv.open_source(path) as replay:
        again = omniscv.render(CAMERA, POSE, replay, ("lit", "depth"), face_size=96)
    for layer in image.layers:
        np.testing.assert_array_equal(again[layer], image[layer])


def test_a_strategy_plans_the_captures():
    ring = omniscv.cameras.create("noncentral-panorama", width=32, height=16, radius=1.0)
    with CountingSource(omniscv.open_source("scene://four-wall")) as source:
        omniscv.render(ring, POSE, source, strategy="sparse", face_size=16)
    assert len({tuple(request.view.pose.position) for request in source.requests}) == 16


@planning.register
class DepthFirst(planning.Strategy):
    """Faces in two rounds: depth, that the strategy is sent, then all that the image needs."""

    name = "depth-first"
    nearest = None

    def rounds(self, plan):
        viewpoints = planning.face_viewpoints(plan, plan.groups(), None)
        first = viewpoints[0]
        kept = yield planning.Round(
            (planning.Viewpoint(first.center_w, first.views, first.pixels[:0], ("depth",), keep=True),)
        )
        if kept is not None:
            DepthFirst.nearest = min(float(capture.pixels.min()) for capture in kept[0]["depth"])
        yield planning.Round(viewpoints)


def test_a_strategy_is_sent_what_it_keeps():
    modes = ("lit", "object_mask", "depth")
    with omniscv.open_source("scene://four-wall") as source:
        own = omniscv.render(CAMERA, POSE, source, modes, strategy="depth-first", face_size=96)
        faces = omniscv.render(CAMERA, POSE, source, modes, strategy="exact", face_size=96)
    for layer in faces.layers:
        np.testing.assert_array_equal(own[layer], faces[layer])
    assert 0.7 < DepthFirst.nearest <= faces.depth[faces.valid].min()  # planar, in a room


def test_a_modality_is_composed_and_written(tmp_path):
    with outsider.Rough(omniscv.open_source("scene://four-wall")) as source:
        image = omniscv.render(CAMERA, POSE, source, ("lit", "roughness"), face_size=96)
    image.save(tmp_path, stem="rough")
    assert (image["roughness"][image.valid] == 0.5).all()
    written = OpenImageIO.ImageInput.open(str(tmp_path / "rough.roughness.exr"))
    assert written.spec().channelnames == ("Y",)
    np.testing.assert_array_equal(written.read_image("float")[..., 0], image["roughness"])


JOB = """
source: sky://
cameras: {lens: {model: fisheye-thoby, width: 64, height: 64, focal: 22}}
poses: [{position: [0, 0, 1.5], yaw_deg: 20}]
modes: [lit, depth]
strategy: sparse
face_size: 96
image_format: npy
out: images
"""


def job_of(folder, text):
    (folder / "job.yaml").write_text(text, encoding="utf-8")
    return load(folder / "job.yaml")


def test_all_of_them_through_a_job_and_its_plan(tmp_path):
    job = job_of(tmp_path, JOB)
    assert {path.name for path in run(job)} >= {"lens.lit.npy", "lens.depth.exr"}
    assert shows_the_sky(np.load(tmp_path / "images" / "lens.lit.npy"))
    found = {cost.way: cost.requests for cost in costs(job)}
    assert found["sparse"] == found["exact"]


def test_all_of_them_through_the_command_line(tmp_path, capsys):
    """In a process of its own, where the package is found by its entry points."""
    info = tmp_path / "site" / "outsider-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: outsider\nVersion: 1.0\n", encoding="utf-8")
    points = """
    [omniscv.plugins]
    outsider = outsider
    [omniscv.sources]
    dusk = outsider:open_dusk
    """
    (info / "entry_points.txt").write_text(cleandoc(points), encoding="utf-8")
    opener = "def open_dusk(address):\n    return Sky()\n"
    (tmp_path / "site" / "outsider.py").write_text(f"{TEXT}\n{opener}", encoding="utf-8")
    options = (
        "--source dusk:// --camera fisheye-thoby --size 64x64 --set camera.focal=22 --position 0,0,1.5"
        f" --yaw 20 --modes lit,depth --set strategy=sparse --set image_format=npy --out {tmp_path}/out"
    )
    command = [sys.executable, "-c", "from omniscv.cli import main; main()", "render", *options.split()]
    paths = os.pathsep.join([str(tmp_path / "site"), *sys.path])
    environment = {**os.environ, "PYTHONPATH": paths}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    assert shows_the_sky(np.load(tmp_path / "out" / "fisheye-thoby.lit.npy"))
    assert cli.run(["cameras", "fisheye-thoby"]) == 0
    assert "A measured fisheye" in capsys.readouterr().out


DATASET = """
source: scene://four-wall
cameras: {lens: {model: fisheye-thoby, width: 64, height: 64, focal: 22}}
poses: [{position: [0, 0, 1.5]}, {position: [0, 0, 1.5], yaw_deg: 5}]
modes: [lit, depth]
truth: {farthest: true}
export: [keys]
out: dataset
"""


def test_a_truth_and_a_format_through_a_dataset(tmp_path):
    """Refused without depth, before the source is opened; made, exported again without it, checked."""
    text = DATASET.replace("scene://four-wall", "scene://missing").replace("[lit, depth]", "[lit]")
    with pytest.raises(omniscv.OmniscvError, match=r"truth\.farthest: expected modes with depth"):
        make(job_of(tmp_path, text))
    make(job_of(tmp_path, DATASET))
    out = tmp_path / "dataset"
    assert dataset.check(out, deep=True) == []
    for frame in dataset.open(out):
        assert frame.truth["farthest"]["metres"] == frame.layer("depth").max()
    (path,) = dataset.export(out, "keys", tmp_path / "again")
    assert path.read_text() == "lens-0\nlens-1"
    (out / "exports" / "keys" / "keys.txt").write_text("wrong", encoding="utf-8")
    (fault,) = dataset.check(out, format="keys")
    assert fault == "exports/keys: keys.txt: expected what the frames give, got other bytes"
