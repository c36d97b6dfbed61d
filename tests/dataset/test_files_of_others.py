"""What somebody else has put into a folder stays: only files that a record lists are removed or replaced."""

import json
import os

import pytest
from support.datasets import image, tree

from omniscv import dataset
from omniscv.cli import run
from omniscv.errors import ArgumentError

NOTES = {
    "notes.json": '{"mine": 1}',
    "notes.md": "mine",
    "notes.lit.png": "mine",
    "exports/model.onnx": "mine",
    "exports/coco/notes.txt": "mine",
    "parts/list.json": "mine",
}

SMALL = """
source: scene://four-wall
cameras: {{{camera}: {{model: equirectangular, width: 32, height: 16}}}}
poses: [{{position: [0, 0, 1.5]}}]
modes: {modes}
face_size: 32
out: {out}
"""


@pytest.fixture
def small(tmp_path, monkeypatch):
    """A function that writes a job of one image into the present folder, and returns its name."""
    monkeypatch.chdir(tmp_path)

    def write(name="pano.yaml", camera="pano", modes="[lit, object_mask]", out=".", more=""):
        text = SMALL.format(camera=camera, modes=modes, out=out) + more
        (tmp_path / name).write_text(text, encoding="utf-8")
        return name

    return write


def put(folder, files):
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)


def contents(folder, names):
    return {name: (folder / name).read_text() for name in names}


def stderr(capsys):
    (line,) = capsys.readouterr().err.splitlines()
    return line


def test_a_job_may_write_beside_itself_and_replaces_its_own_files_only(small, tmp_path):
    job = small(more="record: pano.sqlite\nexport: [coco]\n")
    assert run(["dataset", "make", job]) == 0
    put(tmp_path, NOTES)
    before = {name: (tmp_path / name).read_bytes() for name in ("pano.yaml", "pano.sqlite")}
    assert run(["dataset", "make", job, "--overwrite"]) == 0
    assert contents(tmp_path, NOTES) == NOTES
    assert {name: (tmp_path / name).read_bytes() for name in before} == before
    assert dataset.check(tmp_path) == []


def test_what_is_overwritten_leaves_nothing_of_its_own(small, tmp_path):
    assert run(["dataset", "make", small(more="export: [webdataset, ply]\n", modes="[lit, depth]")]) == 0
    put(tmp_path, NOTES)
    assert run(["dataset", "make", small(modes="[depth]", camera="other"), "--overwrite"]) == 0
    files = {name for name in tree(tmp_path) if name not in NOTES and name != "pano.yaml"}
    kinds = ("depth.exr", "depth_error.exr", "json")
    assert files == {"dataset.json", "frames.jsonl", *(f"other.{kind}" for kind in kinds)}
    assert not (tmp_path / "exports" / "ply").exists()


@pytest.mark.parametrize("option", [[], ["--resume"], ["--overwrite"], ["--shard", "0/2"]])
def test_a_manifest_of_another_program_is_not_touched(option, small, tmp_path, capsys):
    put(tmp_path, {**NOTES, "dataset.json": '{"name": "mine"}', "failed.jsonl": "mine"})
    job = small()
    before = tree(tmp_path)
    assert run(["dataset", "make", job, *option]) == 2
    assert "dataset.json, or that of a dataset, got one of another program; move it" in stderr(capsys)
    assert tree(tmp_path) == before


@pytest.mark.parametrize("name", ["pano.json", "pano.lit.png", "failed.jsonl", "parts/0-of-2.json"])
def test_files_in_the_way_are_named_before_anything_is_written(name, small, tmp_path, capsys):
    put(tmp_path, {name: "mine"})
    job = small()
    before = tree(tmp_path)
    assert run(["dataset", "make", job]) == 2
    line = stderr(capsys)
    assert f"got files that it has not written: {name}; move them away, or write elsewhere" in line
    assert tree(tmp_path) == before


def test_files_in_the_place_of_an_export_are_named_before_anything_is_written(small, tmp_path, capsys):
    put(tmp_path, {"exports/coco/annotations.json": "mine"})
    job = small(more="export: [coco]\n")
    before = tree(tmp_path)
    assert run(["dataset", "make", job]) == 2
    assert "exports/coco: expected free names for the export to coco, got files" in stderr(capsys)
    assert tree(tmp_path) == before


def test_a_frame_is_not_named_as_the_manifest(small, capsys):
    assert run(["dataset", "make", small(camera="dataset")]) == 2
    assert "key: expected another than that of dataset.json" in stderr(capsys)
    assert run(["render", small(camera="objects")]) == 2
    assert "stem: expected another than that of objects.json" in stderr(capsys)


def test_images_are_not_rendered_into_a_dataset(small, tmp_path, capsys):
    job = small(out="made")
    assert run(["dataset", "make", job]) == 0
    before = tree(tmp_path / "made")
    capsys.readouterr()
    assert run(["render", job]) == 2
    assert "expected a folder for images, got a dataset; write elsewhere" in stderr(capsys)
    assert tree(tmp_path / "made") == before


@pytest.mark.parametrize("name", ["pano.json", "pano.depth.exr"])
def test_images_do_not_replace_files_of_others(name, small, tmp_path, capsys):
    put(tmp_path, {name: "{}"})
    job = small()
    before = tree(tmp_path)
    assert run(["render", job]) == 2
    assert f"got files that it has not written: {name}" in stderr(capsys)
    assert tree(tmp_path) == before


@pytest.mark.parametrize("again", ["[lit]", "[lit, depth]\nimage_format: jpg\ndepth_format: npy"])
def test_an_image_that_is_rendered_again_leaves_no_layer_of_the_earlier_one(again, small, tmp_path):
    assert run(["render", small(modes="[lit, object_mask, depth, normals]", out="images")]) == 0
    put(tmp_path / "images", {"notes.json": "{}", "pano.txt": "mine"})
    job = small(modes=again, out="images")
    assert run(["render", job]) == 0
    assert run(["render", job, "--out", "fresh"]) == 0
    wanted = tree(tmp_path / "fresh")
    there = tree(tmp_path / "images")
    assert there.keys() - wanted.keys() == {"notes.json", "pano.txt", "objects.json"}
    assert {name: there[name] for name in wanted} == wanted
    assert run(["look", "images", "--out", "page.html"]) == 0


def test_images_of_version_0_2_list_no_files_and_are_replaced_too(small, tmp_path):
    job = small(modes="[lit, depth]", out="images")
    assert run(["render", job]) == 0
    described = json.loads((tmp_path / "images" / "pano.json").read_bytes())
    described.pop("files")
    (tmp_path / "images" / "pano.json").write_text(json.dumps(described))
    assert run(["render", job, "--modes", "lit"]) == 0
    assert not (tmp_path / "images" / "pano.depth.exr").exists()


def test_what_a_killed_rendering_left_is_its_own(small, tmp_path, monkeypatch):
    """The journal of an image lists its layers before they are there."""
    job = small(modes="[lit, depth]", out="images")
    with monkeypatch.context() as patch:
        patch.setattr("omniscv.compose.files.write_json", lambda *_: os._exit(9))
        if (child := os.fork()) == 0:  # noqa: TID251
            run(["render", job])
            os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9
    assert (tmp_path / "images" / "pano.lit.png").exists()
    assert run(["render", job, "--modes", "lit"]) == 0
    files = {"pano.lit.png", "pano.json"}
    assert tree(tmp_path / "images").keys() - {"objects.json"} == files


def test_an_export_replaces_its_own_files_wholly_and_no_others(tmp_path, whole):
    out = tmp_path / "out"
    dataset.export(whole / "dataset", "webdataset", out, max_count=1)
    put(out, {"notes.txt": "mine", "000000.txt": "mine"})
    dataset.export(whole / "dataset", "coco", out)  # beside it
    both = set(tree(out))
    dataset.export(whole / "dataset", "webdataset", out, max_count=100)
    dataset.export(whole / "dataset", "webdataset", tmp_path / "fresh", max_count=100)
    fresh = tree(tmp_path / "fresh")
    shards = {name for name in both if name.endswith(".tar")}
    assert len(shards) > 1
    assert {name for name in tree(out) if name.endswith(".tar")} == {n for n in fresh if n.endswith(".tar")}
    assert {"notes.txt", "000000.txt", "annotations.json"} <= set(tree(out))


def test_an_export_does_not_replace_files_of_others(tmp_path, whole, capsys):
    put(tmp_path, {"annotations.json": "mine"})
    arguments = ["dataset", "export", str(whole / "dataset"), "--to", "coco", "--out", str(tmp_path)]
    assert run(arguments) == 2
    assert "got files that it has not written: annotations.json" in stderr(capsys)
    assert set(tree(tmp_path)) == {"annotations.json"}


def test_a_writer_does_not_replace_files_of_others(tmp_path):
    put(tmp_path, {"a.lit.png": "mine", "b.json": "mine"})
    with dataset.Writer(tmp_path) as writer:
        for key in ("a", "b"):
            with pytest.raises(ArgumentError, match=f"not written: {key}."):
                writer.add(key, image())
        writer.add("c", image())
    assert contents(tmp_path, ["a.lit.png", "b.json"]) == {"a.lit.png": "mine", "b.json": "mine"}
    assert [frame.key for frame in dataset.open(tmp_path)] == ["c"]


def test_nothing_is_removed_before_everything_was_checked(small, tmp_path):
    assert run(["dataset", "make", small(out="made")]) == 0
    before = tree(tmp_path / "made")
    for more in ("truth: {flow: true}\n", "export: [colmap, {format: horizonnet}]\n"):
        assert run(["dataset", "make", small(out="made", more=more), "--overwrite"]) == 2
        assert tree(tmp_path / "made") == before
