"""``omniscv send``, and ``doctor --self``: what an installation lacks is found, and what to do about it."""

import os
import socket
import subprocess
import sys

import pytest
from support.command_line import ROOT
from support.processes import OMNISCV

import mock_server
from omniscv.cli import run
from omniscv.diagnostics import installation


@pytest.fixture(scope="module")
def server():
    with mock_server.serve("four-wall", dialect="N2") as running:
        yield running


def test_replies_are_printed_in_order_binary_ones_by_kind_and_size(server, capsys):
    commands = ["vget /unrealcv/status", "vget /camera/0/depth npy", "vget /object/Table/mobility"]
    assert run(["send", server.uri, *commands]) == 0
    first, *_, picture, last = capsys.readouterr().out.splitlines()
    assert first == "Is Listening"
    assert picture.startswith("NPY, ")
    assert picture.endswith(" bytes, 640 x 480 px")
    assert last == "Movable"


def test_nothing_is_done_to_the_game_beside_the_commands_and_the_first_refusal_ends_it(server, capsys):
    before = dict(server.statistics.counts)
    assert run(["send", server.uri, "vset /action/game/pause", "vget /action/game/is_paused"]) == 0
    assert capsys.readouterr().out.splitlines() == ["ok", "true"]
    sent = {text: n for text, n in server.statistics.counts.items() if before.get(text, 0) != n}
    assert {text for text in sent if text.startswith("vset")} == {"vset /action/game/pause"}
    assert len(server.world.cameras) == 1
    assert run(["send", server.uri, "vget /scene/name", "vget /nothing", "vget /scene/name"]) == 1
    printed = capsys.readouterr()
    assert printed.out == "four-wall\n"
    assert "'vget /nothing' was refused: \"error No handler found" in printed.err


HERE = "unreal://localhost:1"


def test_wrong_usage_is_one_line_and_2(capsys):
    for arguments, says in (
        (["send", "mock://four-wall"], "Missing argument 'COMMAND...'"),
        (["send", "captures.sqlite", "vget /objects"], "expected unreal://host:port"),
        (["send", HERE, "vbatch 3"], "expected one with its own reply"),
        (["send", HERE, "vget\n/objects"], "expected one line such as 'vget /objects'"),
        (["send", HERE, "vget /objects", "--timeout", "0"], "--timeout: expected"),
        (["doctor"], "expected the address of a server or --self"),
        (["doctor", "--self", "mock://four-wall"], "expected the address of a server or --self"),
    ):
        assert run(arguments) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert says in line


def test_no_server_is_one_line_and_1(capsys):
    with socket.socket() as taken:  # and nobody listens there
        taken.bind(("127.0.0.1", 0))
        assert run(["send", "unreal://{}:{}".format(*taken.getsockname()), "vget /objects"]) == 1
    assert "No UnrealCV server reachable" in capsys.readouterr().err


def test_this_installation_is_whole(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run(["doctor", "--self"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert all(line.startswith(("ok ", "warning ")) for line in lines)
    text = "\n".join(lines)
    for word in ("numpy:", "import cv2: loads", "working folder", "kernels/linux-", "127.0.0.1", "GB free"):
        assert word in text
    assert list(tmp_path.iterdir()) == []


def test_a_port_in_use_is_no_fault_and_a_folder_without_room_to_write_is_one(tmp_path, monkeypatch):
    """Also for the superuser: it is no folder."""
    monkeypatch.setattr(installation, "_kernels", lambda: "compiled before")
    (file := tmp_path / "file").touch()
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        found = {each.name: each for each in installation.examine_installation(file, port)}
    assert found[f"port {port}"].verdict == "warning"
    folder = found["working folder"]
    assert (folder.verdict, folder.remedy[:21]) == ("bad", "choose another folder")


def test_what_is_missing_is_found_and_has_a_remedy(tmp_path):
    """In an environment without libGL, with an old NumPy."""
    (tmp_path / "cv2.py").write_text('raise ImportError("libGL.so.1: cannot open shared object file")\n')
    old = tmp_path / "numpy-1.26.4.dist-info"
    old.mkdir()
    (old / "METADATA").write_text("Metadata-Version: 2.1\nName: numpy\nVersion: 1.26.4\n")
    path = os.pathsep.join([str(tmp_path), str(ROOT)])
    broken = {**os.environ, "PYTHONPATH": path}

    def lines(*arguments):
        command = [sys.executable, *OMNISCV, *arguments]
        done = subprocess.run(command, env=broken, cwd=tmp_path, capture_output=True, text=True)
        return done.returncode, done.stdout + done.stderr

    code, text = lines("doctor", "--self")
    assert code == 1
    lines_of = (line for line in text.splitlines() if line[:3] == "bad")
    bad = {line.split(":")[0].removeprefix("bad").strip(): line for line in lines_of}
    assert {"numpy", "import cv2"} <= set(bad)
    assert "1.26.4, needs >=2.0" in bad["numpy"]
    assert "apt-get install libgl1 libglib2.0-0" in bad["import cv2"]
    code, text = lines("render", "--size", "16x8")
    assert code == 1
    assert text.count("\n") == 1
    assert "libGL.so.1: cannot open shared object file; 'omniscv doctor --self'" in text
