"""``omniscv dataset``: its commands; and what formats and jobs of datasets refuse, each in one line."""

import json
import shlex
from dataclasses import replace

import pytest
from support.datasets import job_file, tree

from omniscv import cameras, dataset
from omniscv.cli import run
from omniscv.errors import ArgumentError
from omniscv.job import load
from omniscv.make import make


def lines(capsys, code, *arguments):
    assert run(["dataset", *map(str, arguments)]) == code
    printed = capsys.readouterr()
    return (printed.out if code == 0 else printed.err).splitlines()


def test_a_dataset_is_made_in_shards_and_finished(whole, tmp_path, capsys):
    job = job_file(tmp_path, more="export: [webdataset]\n")
    out = tmp_path / "dataset"
    (first,) = lines(capsys, 0, "make", job, "--shard", "0/2")
    (second,) = lines(capsys, 0, "make", job, "--shard", "1/2", "--workers", "2")
    (third,) = lines(capsys, 0, *shlex.split(first.partition("omniscv dataset ")[2]))
    assert "frames of other shards are missing: after them this finishes: " in first
    assert "complete" in second
    assert third == f"{out}: 0 frames made, 6 kept; complete"
    assert tree(out) == tree(whole / "dataset")
    (check,) = lines(capsys, 0, "check", out, "--deep")
    assert check == f"{out}: 6 frames, no faults"


def test_info_counts_and_classes_are_listed(whole, capsys):
    found = json.loads("\n".join(lines(capsys, 0, "info", whole / "dataset", "--json")))
    assert (found["complete"], found["frames"], found["objects"], found["places"]) == (True, 6, 20, 2)
    assert (found["cameras"], found["missing"]) == ({"lens": 3, "pano": 3}, {})
    assert sorted(found["splits"].values()) == [2, 4]
    assert sum(found["classes"].values()) == 20
    assert found["bytes"]["lit"] == sum(path.stat().st_size for path in (whole / "dataset").glob("*.lit.png"))
    table = lines(capsys, 0, "info", whole / "dataset")
    assert any(line.startswith("frames ") and " 6" in line for line in table)
    rows = [line.split() for line in lines(capsys, 0, "classes", whole / "dataset", whole / "classes.yaml")]
    assert ["Chair_1", "chair", "5"] in rows
    assert ["Ball", "otherprop", "40"] in rows


def test_export_prints_its_files(whole, tmp_path, capsys):
    to = ("--to", "webdataset", "--out", tmp_path / "x")
    printed = lines(capsys, 0, "export", whole / "dataset", *to, "--set", "max_count=3")
    assert sorted(printed) == sorted(str(path) for path in (tmp_path / "x").glob("[!.]*"))
    assert len(printed) == 4
    (tmp_path / "x" / "mine.txt").touch()
    again = lines(capsys, 0, "pack", whole / "dataset", "--as", "webdataset", "--out", tmp_path / "x")
    assert {path.name for path in (tmp_path / "x").iterdir()} >= {"mine.txt", "shards.json"}
    assert len(again) == 3


def test_wrong_usage_is_one_line_and_code_2(whole, capsys):
    for arguments, says in (
        (["make", "nothing.yaml"], "nothing.yaml: expected a readable file"),
        (["make", "{job}", "--shard", "2/2"], "--shard: expected I/N with I from 0 to N - 1, such as 0/4"),
        (["export", "{out}", "--to", "ply", "--camera", "nope"], "ply: --camera, or 'cameras' in a job:"),
        (["export", "{out}", "--to", "webdataset", "--set", "size=3"], "unknown key 'size'; known keys:"),
        (["export", "{out}", "--to", "webdataset", "--out", "{out}"], "a folder that holds no dataset"),
        (["info", "{folder}"], "expected the folder of a dataset"),
        (["classes", "four-wall", "{folder}/dataset.yaml"], "unknown key 'source'; known keys: rules"),
    ):
        names = {"job": whole / "dataset.yaml", "out": whole / "dataset", "folder": whole}
        (line,) = lines(capsys, 2, *(each.format(**names) for each in arguments))
        assert line.startswith("omniscv: ")
        assert says in line
        assert len(line) <= 310


FISHEYES = "fisheye-equidistant kannala-brandt"
CARRIED = {
    "colmap": (f"equirectangular {FISHEYES} pinhole extended-unified", "noncentral-panorama scaramuzza"),
    "euroc": ("pinhole kannala-brandt", "equirectangular lidar"),
    "horizonnet": ("equirectangular", "fisheye-equidistant"),
    "kitti_lidar": ("lidar", "equirectangular rolling-shutter"),
    "kalibr": ("pinhole", "equirectangular cylindrical noncentral-conical-mirror"),
    "nerfstudio": (f"equirectangular {FISHEYES} pinhole", "noncentral-panorama scaramuzza cylindrical"),
    "poses": ("equirectangular", "noncentral-panorama"),
}
"""By format: models that it carries, and others."""


@pytest.mark.parametrize("format", CARRIED)
def test_cameras_that_formats_carry(format):
    carried, others = (names.split() for names in CARRIED[format])
    for name in others:
        assert name in dataset.get(format).refuses(cameras.model(name).example(32))
    for name in carried:
        assert dataset.get(format).refuses(cameras.model(name).example(32)) is None, name


def test_jobs_are_refused_before_the_source_is_opened(tmp_path):
    """Opening this one would be another error."""
    for more, says in (
        ("export: [cocoa]", "export: format: expected one of"),
        ("export: [hf]", "format: expected a format that is written, got hf; use coco or webdataset"),
        ("store: zarr", "store: expected one of files, fast; got 'zarr'"),
        ("export: [webdataset, webdataset]", "got 'webdataset' twice"),
        ("export: [{format: coco, out: ../x}]", "out: expected the name of a folder"),
        ("export: {webdataset: true}", "export: expected a list"),
        ("export: [{format: coco, cameras: [left]}]", "expected one of pano, lens; got 'left'"),
        ("export: [colmap, horizonnet]", "cannot carry camera 'lens'"),
        ("export: [{format: horizonnet, cameras: [pano]}]", "horizonnet: expected frames with layout"),
        ("truth: {boxen: true}", "truth: unknown key 'boxen'; did you mean boxes? known keys: poses, layout"),
        ("truth: {tolerance: {abs: 1}}", "truth.tolerance: unknown key 'abs'; did you mean abs_m?"),
        ("truth: {layout: {source: guess}}", "truth.layout: source: expected one of scene, fitted"),
        ("layout: {source: scene}", "layout: expected no such key, got {'source': 'scene'}; write truth"),
        ("seam: split", "seam: expected no such key, got 'split'; write it into 'export'"),
        ("shard: {format: webdataset}", "unknown key 'shard'; known keys: source, poses"),
    ):
        with pytest.raises(ArgumentError) as failed:
            make(load(job_file(tmp_path, source="scene://nowhere", more=more + "\n")))
        assert says in str(failed.value)
        assert len(str(failed.value)) <= 1000
        assert not (tmp_path / "dataset").exists()
    job = load(job_file(tmp_path, source="scene://nowhere"))
    with pytest.raises(ArgumentError, match="classes: expected modes with object_mask, got lit; add them"):
        make(replace(job, modes=("lit",)))
