"""The doctor's command and report, recordings with its remedies, and recordings of launched games."""

import getpass
import io
import json
import re
import signal
import socket
import subprocess
import sys
import zipfile

import numpy as np
import pytest
from PIL import Image
from support.games import beside, is_running, waited_for

import mock_server
import omniscv
import omniscv.diagnostics.server
from omniscv.cli import run
from omniscv.diagnostics import Finding
from omniscv.sources.recording.inspection import info, verify


def composed(path, uri, *options):
    arguments = ["record", "--source", uri, "--set", "face_size=64", "--modes", "lit", "--out", str(path)]
    assert run([*arguments, *options]) == 0
    camera = omniscv.cameras.create("equirectangular", width=256, height=128)
    with omniscv.open_source(path) as source:
        image = omniscv.render(camera, omniscv.Pose.from_angles((0, 0, 1.5)), source, face_size=64)
    return image.lit.astype(float)


def test_a_recording_with_overscan_has_a_tenth_of_the_error_of_a_vignette(tmp_path):
    """160 px beyond faces of 64: an edge's middle is where (32 / 192)^2 of the corners' loss is."""
    uri = "mock://four-wall?fault=vignette"
    true = composed(tmp_path / "true.sqlite", "mock://four-wall")
    before = np.abs(composed(tmp_path / "before.sqlite", uri) - true).mean()
    after = np.abs(composed(tmp_path / "after.sqlite", uri, "--overscan", "160") - true).mean()
    assert before > 5
    assert after <= before / 10


@pytest.mark.parametrize("fault", ["", "?fault=mask-noise=6"])
def test_a_recording_says_which_masks_no_object_has(fault, tmp_path, capsys):
    """Judged by the distance of every recorded colour from all objects' own."""
    path = tmp_path / "room.sqlite"
    words = ["--set", "face_size=32", "--modes", "object_mask", "--out", str(path)]
    assert run(["record", "--source", f"mock://four-wall{fault}", *words]) == 0
    said = capsys.readouterr().err
    with omniscv.open_source(path) as source:
        table = source.objects()
        own = np.array([*table.colors.values()])
        views = source.recorded_views()
        requests = [omniscv.sources.Request(view, "object_mask") for view in views]
        shown = np.concatenate([capture.pixels.reshape(-1, 3) for capture in source.capture(requests)])
    off = np.abs(shown[:, None].astype(int) - own).max(axis=-1)
    is_strange = ((off <= table.tolerance).sum(axis=-1) != 1) & (off > 0).all(axis=-1) & shown.any(axis=-1)
    colors = len(np.unique(shown[is_strange], axis=0))
    if fault:
        assert is_strange.sum() > 1000
        assert f"{is_strange.sum()} pixels of masks show {colors} colours or ids that no object has" in said
    else:
        assert not is_strange.any()
        assert said == ""


def test_the_command_prints_json_and_exits_with_1_if_anything_is_bad(capsys, monkeypatch):
    def examine(uri, position, quick, picture, layout, said, **deadlines):
        assert (position.tolist(), deadlines) == ([0.5, 0, 1.4], {"timeout_s": 3.0})
        return [Finding.unless("vignette" not in uri, "vignette", uri, "bad", "vrun r.Tonemapper.Quality 1")]

    monkeypatch.setattr("omniscv.diagnostics.doctor.examine_address", examine)
    options = ["--position", "0.5,0,1.4", "--timeout", "3"]
    assert run(["doctor", "mock://four-wall?fault=vignette", *options, "--json"]) == 1
    (finding,) = json.loads(capsys.readouterr().out)
    assert (finding["verdict"], finding["remedy"]) == ("bad", "vrun r.Tonemapper.Quality 1")
    assert run(["doctor", "mock://room", *options]) == 0
    assert "mock://room" in capsys.readouterr().out


def test_what_is_no_address_is_not_examined_and_has_no_report(tmp_path, capsys):
    for address in ("http://localhost", "unreal://"):
        assert run(["doctor", address]) == 2
        assert "expected unreal://host:port" in capsys.readouterr().err
    assert run(["doctor", "--self", "--report", str(tmp_path / "r.zip")]) == 2
    assert "--report: expected an address unreal:// or mock://, got none" in capsys.readouterr().err


def record(game, *options):
    return ["record", "--launch", str(game), "--set", "face_size=32", "--modes", "lit", *map(str, options)]


def test_launched_games_are_recorded_and_stopped(game, tmp_path):
    out = tmp_path / "room.sqlite"
    places = [f"--position={0.1 * step},0,1.5" for step in range(16)]
    assert run([*record(game, "--launch", game, "--out", out), *places]) == 0
    settings = json.loads((beside(game) / "settings.json").read_text())
    assert (settings["width"], settings["height"], float(settings["fov"])) == ("32", "32", 90)
    assert 1024 < int(settings["port"]) < 65536
    assert (verify(out).ok, info(out).captures) == (True, {"lit": 96})
    assert len(info(out).servers) == 2
    assert waited_for(lambda: not is_running(game))
    assert not list(game.parent.rglob("unrealcv.ini"))


def test_sigterm_stops_the_game_and_keeps_the_captures(game, tmp_path):
    out = tmp_path / "room.sqlite"
    places = [f"--position={0.01 * step},0,1.5" for step in range(200)]
    command = [sys.executable, "-c", "from omniscv.cli import main; main()"]
    with subprocess.Popen(
        [*command, *record(game, "--out", out), *places], stderr=subprocess.PIPE, text=True
    ) as recorder:
        assert waited_for(lambda: out.exists() and verify(out).captures > 0)
        assert is_running(game)
        recorder.send_signal(signal.SIGTERM)
        _, printed = recorder.communicate(timeout=60)
    assert recorder.returncode == 143
    assert "what is complete is kept; this goes on: the same command" in printed
    assert waited_for(lambda: not is_running(game))
    assert verify(out).ok
    assert 0 < info(out).captures["lit"] < 1200
    assert not list(game.parent.rglob("unrealcv.ini"))


@pytest.mark.parametrize("dialect", ["0.3.10", "M", "N3"])
def test_a_report_holds_replies_timings_findings_and_captures(dialect, tmp_path, monkeypatch):
    monkeypatch.setattr(omniscv.diagnostics.server, "EDGE_PX", 64)
    with mock_server.serve("four-wall", dialect=dialect, size=(64, 64)) as server:
        run(["doctor", server.uri, "--quick", "--report", str(tmp_path / "report.zip")])
    with zipfile.ZipFile(tmp_path / "report.zip") as file:
        text = file.read("report.json").decode()
        captures = {name: file.read(name) for name in file.namelist() if name.startswith("captures/")}
    report = json.loads(text)
    replies = {row["command"]: row["reply"] for row in report["replies"]}
    assert report["dialect"] == dialect
    assert replies["vget /scene/name"].startswith(("four-wall", "error"))
    assert all(row["ms"] >= 0 and not row["reply"].startswith("no reply") for row in report["replies"])
    assert {"dialect", "mask colours"} <= {finding["name"] for finding in report["findings"]}
    assert len(captures) == 8
    for name, payload in captures.items():
        if name.endswith(".png"):
            assert Image.open(io.BytesIO(payload)).size == (64, 64)
        else:
            assert name.endswith("depth.npy")
            assert np.load(io.BytesIO(payload)).shape[:2] == (64, 64)
    for secret in (socket.gethostname(), getpass.getuser(), str(tmp_path), "127.0.0.1"):
        assert not re.search(rf"\b{re.escape(secret)}\b", text)


@pytest.mark.parametrize("path", ["C:\\Users\\Jane Doe\\x.ini", "/home/jane/x", "\\\\nas\\share", "~/x"])
def test_paths_are_left_out(path):
    from omniscv.diagnostics.report import _without

    found = _without({"reply": f"Config file: {path}\nvget /camera/0/lit png"}, [])
    assert found == {"reply": "Config file: (path)\nvget /camera/0/lit png"}
