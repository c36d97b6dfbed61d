"""The report of a server: what is in it, and what is not."""

import getpass
import io
import json
import re
import socket
import zipfile

import numpy as np
import pytest
from PIL import Image

import mock_server
import omniscv.diagnostics.server
from omniscv.cli import run


@pytest.mark.parametrize("dialect", ["0.3.10", "M", "N1", "N2", "N3"])
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


def test_a_report_is_of_a_server(tmp_path, capsys):
    assert run(["doctor", "--self", "--report", str(tmp_path / "r.zip")]) == 2
    assert "--report: expected an address unreal:// or mock://, got none" in capsys.readouterr().err
