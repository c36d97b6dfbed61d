"""``dataset make``: the same bytes in every way, and nothing captured for what cannot be made."""

import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
from support.command_line import ROOT
from support.datasets import CLASSES, first_of, image, job_file, tree

import mock_server
import omniscv
from omniscv import dataset
from omniscv.errors import ArgumentError
from omniscv.job import load
from omniscv.make import dataset as maker
from omniscv.make import make
from omniscv.make.contents import Contents
from omniscv.make.source import open_source

EXPORT = "export: [webdataset]\n"


def test_workers_and_shards_make_the_same_bytes(whole, tmp_path):
    wanted = tree(whole / "dataset")
    job = load(job_file(tmp_path, more=EXPORT))
    make(replace(job, out=tmp_path / "workers"), workers=3)
    done = [make(replace(job, out=tmp_path / "one"), shard=(i, 3)) for i in (2, 0, 1)]
    for i in range(2):
        make(replace(job, out=tmp_path / f"part-{i}"), shard=(i, 2))
        shutil.copytree(tmp_path / f"part-{i}", tmp_path / "joined", dirs_exist_ok=True)
    joined = make(replace(job, out=tmp_path / "joined"), existing="resume")
    assert (joined.written, joined.kept, joined.missing) == (0, 6, 0)
    assert sum(each.written for each in done) == 6
    assert [each.missing > 0 for each in done] == [True, True, False]
    for name in ("workers", "one", "joined"):
        assert tree(tmp_path / name) == wanted, name


def test_no_file_holds_a_time_a_port_or_a_path(tmp_path):
    trees = []
    for name in ("first", "second"):
        with mock_server.serve("four-wall") as server:
            folder = tmp_path / name
            folder.mkdir()
            job = load(job_file(folder, source=server.uri))
            make(first_of(job, 1))
            trees.append(tree(job.out))
        text = b"".join(path.read_bytes() for path in job.out.glob("*.json*"))
        for strange in (str(server.port), str(tmp_path), "127.0.0.1"):
            assert strange.encode() not in text
    assert trees[0] == trees[1]


def test_the_list_of_frames_is_in_the_order_of_keys_with_checksums(whole):
    lines = (whole / "dataset" / "frames.jsonl").read_text(encoding="utf-8").splitlines()
    rows = [json.loads(line) for line in lines]
    assert [row["key"] for row in rows] == [f"{name}-{i}" for name in ("lens", "pano") for i in range(3)]
    fields = {"key", "camera", "pose", "time_ns", "place", "split", "scene", "files", "blank"}
    for row in rows:
        assert set(row) == fields
        assert {"lit", "labels", "classes", "depth", "normals", "image"} <= set(row["files"])
    stored = json.loads((whole / "dataset" / "dataset.json").read_text(encoding="utf-8"))
    assert (stored["format"], stored["omniscv"]) == (2, omniscv.__version__)
    assert stored["conventions"].items() >= {"depth": "ray metres", "pixels": "edge"}.items()
    wanted = {"format": "webdataset", "out": "webdataset", "options": {}, "cameras": []}
    assert stored["exports"] == [wanted]
    cameras = {name: omniscv.cameras.from_dict(each) for name, each in stored["cameras"].items()}
    assert cameras == dict(load(whole / "dataset.yaml").cameras)


def test_a_dataset_is_not_resumed_as_another(copied, tmp_path):
    path = copied.with_name("dataset.yaml")
    job = load(path)
    with pytest.raises(ArgumentError, match="expected a new folder, got a dataset"):
        make(job, existing="refuse")
    changed = {
        "options": replace(job, modes=("lit", "object_mask")),
        "camera 'pano'": replace(job, cameras={"pano": job.cameras["lens"]}),
        "splits": replace(job, recipe=replace(job.recipe, split=None)),
    }
    (tmp_path / "classes.yaml").write_text(CLASSES.replace("door}", "window}"), encoding="utf-8")
    changed[r"its classes.rules\[4\].class is 'door', in the job 'window'"] = load(path)
    for what, other in changed.items():
        with pytest.raises(ArgumentError, match=what):
            make(other, existing="resume")
    assert dataset.check(copied) == []


def test_another_scene_s_frames_are_refused(copied):
    """A frame that is there has scene, pose, time and place of the job, else nothing is made."""
    job = load(copied.with_name("dataset.yaml"))
    before = tree(copied)
    times_ns = (0, 500_000_000, 2 * 10**9)
    for other in (replace(job, source="scene://six-wall"), replace(job, times_ns=times_ns)):
        with pytest.raises(ArgumentError, match="expected"):
            make(other, existing="resume")
    assert {key: tree(copied)[key] for key in before if key != "dataset.json"} == {
        key: before[key] for key in before if key != "dataset.json"
    }


def test_a_set_that_another_process_has_just_finished_is_complete(tmp_path, monkeypatch):
    """It has removed the markers when this one looks for them."""
    job = load(job_file(tmp_path))
    run = maker._run

    def run_while_another_finishes(*args, **kw):
        done = run(*args, **kw)
        monkeypatch.undo()
        assert make(job, shard=(1, 2)).missing == 0
        return done

    monkeypatch.setattr(maker, "_run", run_while_another_finishes)
    done = make(job, shard=(0, 2))
    assert done.missing == 0
    assert done.written > 0
    assert dataset.check(job.out) == []


def test_a_key_has_no_dot_and_is_used_once(tmp_path):
    job = load(job_file(tmp_path))
    with pytest.raises(ArgumentError, match="without a dot"):
        make(replace(job, cameras={"cam.left": job.cameras["pano"]}))
    with dataset.Writer(tmp_path / "written") as writer:
        shown = image()
        for key in ("a.b", "", "a/b", "..", "a\0"):
            with pytest.raises(ArgumentError, match="start of a file name"):
                writer.add(key, shown)
        assert writer.add("a", shown)
        with pytest.raises(ArgumentError, match=r"key: expected one that no other frame.*got 'a' again"):
            writer.add("a", replace(shown, pose=omniscv.Pose.from_angles((1, 0, 1.5))))


def test_frames_of_a_writer_are_read_back(tmp_path):
    shown = image()
    other = image(width=48)
    pose = omniscv.Pose.from_angles((1, 2, 3), 10, 20, 30)
    with dataset.Writer(tmp_path / "d", classes={"rules": [{"match": "*", "class": "thing"}]}) as writer:
        writer.add("b", shown, pose=pose, split="val", time=2.5, place="hall", truth={"note": [1, 2]})
        writer.add("a", other)
    first, second = dataset.open(tmp_path / "d")
    assert (first.key, second.key) == ("a", "b")
    assert {first.camera_name, second.camera_name} == {"equirectangular", "equirectangular-1"}
    assert (second.camera, second.pose.to_dict()) == (shown.camera, pose.to_dict())
    assert (second.split, second.time, second.place) == ("val", 2.5, "hall")
    assert (first.truth, second.truth) == ({}, {"note": [1, 2]})
    assert (first.layer("classes") == (first.layer("labels") > 0)).all()
    assert dataset.check(tmp_path / "d", deep=True) == []
    with pytest.raises(ArgumentError, match=re.escape("c.truth.json: expected finite, plain values")):
        dataset.Writer(tmp_path / "d", resume=True).add("c", shown, truth={"note": float("nan")})


def test_the_keys_of_a_job(tmp_path):
    """Flow is an export; what truths and formats share reaches those that take it."""
    truth = "boxes: true, bfov: false, amodal: off, layout: {source: scene}, flow: {gap: 2}"
    exports = "{format: coco, seam: split}, {format: depth-png, out: metres, cameras: [pano]}"
    more = f"truth: {{{truth}, tolerance: {{abs_m: 0.05}}}}\nexport: [{exports}]\nmedia: {{xmp: true}}\n"
    job = load(job_file(tmp_path, more=more))
    contents = Contents.of(job)
    assert contents.truth == {"layout": {"source": "scene", "tolerance": {"abs_m": 0.05}}, "boxes": {}}
    assert [(each.format, each.out, each.options, each.cameras) for each in contents.exports] == [
        ("coco", "coco", {"seam": "split"}, ()),
        ("depth_png", "metres", {}, ("pano",)),
        ("flow", "flow", {"tolerance": {"abs_m": 0.05}, "gap": 2}, ()),
    ]
    assert job.recipe.media == {"xmp": True}
    assert contents.kinds(job) >= {"layout", "truth", "classes", "labels", "depth_error", "image"}


def test_truths_that_capture_make_the_same_bytes_beside_other_images(tmp_path):
    """They hide objects of the source that images are captured from; records of all kinds pass the check."""
    more = "truth: {boxes: true, boxes3d: true, bfov: true, amodal: masks, layout: true}\n"
    job = load(job_file(tmp_path, more=more))
    for workers in (1, 3):
        make(replace(first_of(job, 2), out=tmp_path / f"{workers}"), workers=workers)
    assert tree(tmp_path / "1") == tree(tmp_path / "3")
    assert dataset.check(tmp_path / "1", deep=True) == []
    frame = dataset.open(tmp_path / "1")[-1]
    assert set(frame.truth) == {"boxes", "boxes3d", "bfov", "amodal"}
    assert frame.layout["source"] == "scene"


RECORDING = ROOT / "captures" / "four-wall.sqlite"


@pytest.mark.parametrize(
    "source",
    ["mock://four-wall?dialect=N2&size=64x64", "mock://four-wall?dialect=0.3.10&size=64x64", str(RECORDING)],
)
def test_a_dataset_of_each_source_has_no_faults(source, tmp_path):
    job = load(job_file(tmp_path, source=json.dumps(source)))
    with open_source(job) as opened:
        modes = tuple(mode for mode in job.modes if mode in opened.capabilities.modes)
    poses = tuple(omniscv.Pose.from_angles((0.0, 0.0, 1.5), yaw) for yaw in (30,))
    options = omniscv.RenderOptions("cube")
    job = replace(job, modes=modes, poses=poses, times_ns=None, places=None, options=options)
    make(job)
    assert dataset.check(job.out, deep=True) == []
    frames = dataset.open(job.out)
    assert len(frames) == 2
    with omniscv.open_source("scene://four-wall") as scene:
        names = scene.objects().names()
    for frame in frames:
        assert set(names) <= set(frame.instances)
        floor = frame.layer("labels") == frame.instances["Layout_Floor"]
        rays_w = frame.camera.unproject().directions @ frame.pose.R_w_c.T
        height = 1.5 + rays_w[..., 2] * frame.layer("depth")
        assert floor.mean() > 0.1
        assert np.median(np.abs(height[floor & ~frame.layer("label_edge")])) < 0.02
