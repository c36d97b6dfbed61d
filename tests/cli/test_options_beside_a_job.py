"""Options beside a job take the place of its keys, and a line says which; without one they are the job."""

import json
from collections.abc import Mapping
from pathlib import Path

import pytest

from omniscv.arguments import shown
from omniscv.cli import run
from omniscv.cli.options import IMAGES, JobArguments
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.job import address, load, overridden, read


def loaded(job, **values):
    """The job of a file and options with these values."""
    values = {name.replace("-", "_"): value for name, value in values.items()}
    return JobArguments(job, IMAGES, values, frozenset(values)).load()


@pytest.mark.parametrize(
    ("options", "field", "value"),
    [
        ({"modes": "lit"}, "modes", ("lit",)),
        ({"yaw": 0.0}, "poses.0.yaw", 0.0),
        ({"position": "1,0,1.5", "pitch": 10.0}, "poses.0.position.0", 1.0),
        ({"size": "16x8"}, "cameras.pano.width", 16),
        ({"camera": "pinhole", "size": "8x6", "set": ["camera.focal=5"]}, "cameras.pinhole.focal", 5.0),
        ({"out": "elsewhere"}, "out.name", "elsewhere"),
        ({"set": ["face_size=16", "filter=area"]}, "options.face_size", 16),
        ({"set": ["pose.yaw_deg=0"]}, "poses.0.yaw", 0.0),
        ({"set": ["modes=[lit]"]}, "modes", ("lit",)),
        ({"set": ["record=room.sqlite"]}, "record.name", "room.sqlite"),
    ],
)
def test_an_option_overrides_its_key(options, field, value, job, capsys):
    """The job without it has another value. One line names it."""
    overridden_job = loaded(job, **options)
    assert _field(overridden_job, field) == value
    assert _field(load(job), field) != value
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    assert all(f"--{name} overrides " in line for name in options)


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        ("face_size", "KEY=VALUE such as strategy=exact or camera.fov_deg=185, got 'face_size'"),
        ("a..b=1", "--set: expected KEY=VALUE"),
        ("modes=[lit", "--set modes: line 2: expected YAML"),
        ("strateg=cube", "unknown key 'strateg'; did you mean strategy? known keys: source, "),
        ("source.x=1", "source: expected something in which x can be set"),
    ],
)
def test_a_wrong_setting_is_refused(setting, says, job, capsys):
    assert run(["render", str(job), "--set", setting]) == 2
    assert says in capsys.readouterr().err


def _field(job, path):
    """A value of a job; None where there is none."""
    value = job
    for key in path.split("."):
        if isinstance(value, Pose):
            value = {"position": value.position, "yaw": -round(value.to_unreal()[1][1], 9)}
        if isinstance(value, Mapping):
            value = value.get(key)
        elif key.isdecimal():
            value = value[int(key)]
        else:
            value = getattr(value, key, None)
    return value


def test_each_written_file_is_listed_once(job, capsys):
    command = ["render", str(job), "--set", "poses=[{position: [0, 0, 1.5]}, {position: [0, 0, 1.4]}]"]
    out = job.parent / "out"
    assert run([*command, "--json"]) == 0
    files = sorted(map(str, out.iterdir()))
    assert sorted(json.loads(capsys.readouterr().out)) == files
    assert run(command) == 0
    assert capsys.readouterr().out.startswith(f"{len(files)} files in {out}/\n2 images: 24 captures, at most")


def test_a_command_renders_what_options_make_of_a_job(job, capsys):
    options = ["--size", "16x8", "--modes", "depth", "--stem", "small", "--out", "x"]
    assert run(["render", str(job), *options]) == 0
    printed = capsys.readouterr()
    assert printed.err == (
        f"omniscv: {job}: --size overrides cameras.*.width and cameras.*.height; --modes overrides modes; "
        "--out overrides out\n"
    )
    written = json.loads((job.parent / "x" / "small.json").read_text())
    assert (written["camera"]["width"], written["options"]["face_size"]) == (16, 32)
    assert run(["dataset", "make", str(job), "--size", "16x8", "--out", "y"]) == 0
    assert (job.parent / "y" / "dataset.json").exists()


def test_paths_of_options_are_relative_to_the_present_folder(job, monkeypatch, capsys):
    room = job.parent / "room.sqlite"
    assert run(["record", str(job), "--out", str(room)]) == 0
    (job.parent / "sub").mkdir()
    job = job.rename(job.parent / "sub" / "job.yaml")
    assert run(["render", str(job), "--source", "room.sqlite", "--out", "here"]) == 0
    assert {each.name for each in job.parent.parent.iterdir()} == {"room.sqlite", "sub", "here"}


def test_cameras_of_a_rig_are_not_changed_in_part(job):
    rig = {"cameras": {"left": {"camera": {"model": "pinhole", "width": 8, "height": 8, "fov_deg": 90}}}}
    described = {"source": "scene://four-wall", "poses": [{"position": [0, 0, 1]}], "rig": rig}
    with pytest.raises(ArgumentError, match=r"cameras\.\*\.width: expected a job without a rig"):
        overridden(described, {"cameras.*.width": 4})
    camera = {"model": "pinhole", "width": 8, "height": 8, "fov_deg": 90}
    changed = overridden(described, {"cameras": {"other": camera}, "rig": None, "cameras.*.width": 4})
    assert {name: each.width for name, each in read(changed, Path()).cameras.items()} == {"other": 4}


def test_what_is_overridden_is_not_changed():
    described = {"a": {"x": {"n": 1}, "y": {"n": 2}}, "list": [{"n": 1}], "left": 0}
    before = shown(described)
    found = overridden(described, {"a.*.n": 5, "list.*.n": 6, "new.deep": 7, "left": None})
    assert found == {"a": {"x": {"n": 5}, "y": {"n": 5}}, "list": [{"n": 6}], "new": {"deep": 7}}
    assert shown(described) == before


def test_a_url_keeps_its_slashes(job):
    assert loaded(job, out="s3://bucket/kitchen").out == "s3://bucket/kitchen"
    assert address("s3://bucket/kitchen", Path("/elsewhere")) == "s3://bucket/kitchen"
