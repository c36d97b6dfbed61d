"""The command line as a person meets it: help with examples, and one clear line when something is wrong."""

import json
import re
import socket

import pytest

from omniscv.cli import run

COMMANDS = [
    ["demo"], ["render"], ["record"], ["serve"], ["cameras"], ["plan"], ["doctor"],
    ["captures", "info"], ["captures", "verify"], ["captures", "export"], ["captures", "import"],
]  # fmt: skip


@pytest.fixture
def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def failed(capsys, code, arguments):
    """The one line that a failing command prints."""
    assert run([str(a) for a in arguments]) == code
    printed = capsys.readouterr()
    lines = printed.err.strip().splitlines()
    assert len(lines) == 1, printed.err
    assert lines[0].startswith("omniscv: ")
    assert "Traceback" not in printed.out + printed.err
    return lines[0]


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_every_command_has_an_example(command, capsys):
    assert run([*command, "--help"]) == 0
    text = re.sub(r"\s+", " ", capsys.readouterr().out)
    assert f"Example: omniscv {' '.join(command)}" in text


def test_version(capsys):
    import omniscv

    assert run(["--version"]) == 0
    assert capsys.readouterr().out.strip() == f"omniscv {omniscv.__version__}"


def test_cameras_lists_every_model(capsys):
    from omniscv import cameras

    assert run(["cameras"]) == 0
    listed = capsys.readouterr().out
    assert all(name in listed for name in cameras.names())
    assert run(["cameras", "equirectangular"]) == 0
    assert "theta" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--camera", "fisheye"], "camera: expected one of"),
        (["--size", "0x512"], "width: expected a whole number of pixels >= 1, got 0"),
        (["--size", "big"], "--size: expected WIDTHxHEIGHT"),
        (["--camera", "fisheye-equidistant", "--fov", "180", "--param", "focal=100"], "focal"),
        (["--position", "nan,0,1"], "position: expected"),
        (["--position", "0,0"], "--position: expected 3 numbers"),
        (["--modes", "colour"], "--modes: expected some of"),
        (["--face-size", "-4"], "--face-size: expected"),
        (["--param", "radius"], "--param: expected NAME=VALUE"),
        (["--strategy", "guess"], "strategy: expected"),
        (["--filter", "sharp"], "filter: expected"),
        (["--source", "http://localhost"], "source"),
        (["--source", "mock://moon"], "moon"),
        (["--colour"], "No such option"),
    ],
)
def test_wrong_usage_is_one_line_and_code_2(options, says, capsys, tmp_path):
    arguments = ["render", "--size", "64x32", "--out", tmp_path / "out", *options]
    assert says in failed(capsys, 2, arguments)
    assert not (tmp_path / "out").exists()


def test_nobody_listens(capsys, tmp_path, free_port):
    arguments = ["render", "--source", f"unreal://127.0.0.1:{free_port}", "--out", tmp_path / "out"]
    line = failed(capsys, 1, arguments)
    assert str(free_port) in line
    assert not (tmp_path / "out").exists()


def test_a_file_that_is_no_recording(capsys, tmp_path):
    path = tmp_path / "notes.sqlite"
    path.write_text("dear diary")
    assert "notes.sqlite" in failed(capsys, 1, ["render", "--source", path, "--out", tmp_path / "out"])
    assert "notes.sqlite" in failed(capsys, 1, ["captures", "info", path])
    assert path.read_text() == "dear diary"
    assert not (tmp_path / "out").exists()


def test_a_file_that_is_not_there(capsys, tmp_path):
    failed(capsys, 1, ["render", "--source", tmp_path / "none.sqlite", "--out", tmp_path / "out"])
    assert list(tmp_path.iterdir()) == []


def test_a_recording_without_the_asked_view(capsys, tmp_path):
    record = tmp_path / "one.sqlite"
    assert (
        run(
            [
                "record",
                "--source",
                "mock://four-wall",
                "--face-size",
                "32",
                "--modes",
                "lit",
                "--out",
                str(record),
            ]
        )
        == 0
    )
    capsys.readouterr()
    line = failed(
        capsys,
        1,
        ["render", "--source", record, "--size", "64x32", "--position", "1,0,1.5", "--out", tmp_path / "out"],
    )
    assert "nearest" in line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("- not a job", "expected a job in YAML"),
        ("source: mock://four-wall\ncameras: {}\nposes: []\n", "cameras: expected"),
        ("sources: x\n", "'sources'"),
        ("source: mock://four-wall\n", "'cameras'"),
        ("{", "expected a job in YAML"),
        ("!!python/object/apply:os.system [true]", "expected a job in YAML"),
        ("source: mock://four-wall\ncameras: {../up: {model: pinhole}}\nposes: []\n", "file names"),
    ],
)
def test_a_wrong_job_is_one_line(text, says, capsys, tmp_path):
    job = tmp_path / "job.yaml"
    job.write_text(text)
    assert says in failed(capsys, 2, ["render", job])


def test_a_job_renders_every_camera_at_every_pose(capsys, tmp_path):
    (tmp_path / "job.yaml").write_text(
        """
        source: mock://four-wall
        record: room.sqlite
        cameras:
          pano: {model: equirectangular, width: 64, height: 32}
          fish: {model: fisheye-equidistant, width: 32, height: 32, fov_deg: 180}
        poses:
          - {position: [0, 0, 1.5]}
          - {position: [0.5, 0, 1.5], yaw_deg: 30}
        modes: [lit, depth]
        out: images
        """
    )
    assert run(["render", str(tmp_path / "job.yaml")]) == 0
    names = {path.name for path in (tmp_path / "images").iterdir()}
    assert {f"{stem}-{i}.json" for stem in ("pano", "fish") for i in (0, 1)} <= names
    assert (tmp_path / "room.sqlite").exists()
    capsys.readouterr()
    assert run(["plan", str(tmp_path / "job.yaml")]) == 0
    assert "cube" in capsys.readouterr().out


def test_columns_beyond_the_walls_are_told(capsys, tmp_path):
    """The room is 5 m wide: with a radius of 2.7 m some columns of the panorama begin outside."""
    arguments = ["render", "--camera", "noncentral-panorama", "--param", "radius=2.7", "--size", "32x16"]
    assert run([*arguments, "--modes", "depth", "--out", str(tmp_path / "out")]) == 0
    assert "pixels are unsure" in capsys.readouterr().err
    written = json.loads((tmp_path / "out" / "noncentral-panorama.json").read_text())
    assert 0 < written["unsure_pixels"] < 32 * 16
    assert (tmp_path / "out" / "noncentral-panorama.unsure.png").exists()
