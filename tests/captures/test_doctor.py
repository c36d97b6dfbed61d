"""The doctor, before servers whose illness is known."""

import json

import pytest

import mock_server
from omniscv.captures.opening import open_link
from omniscv.captures.unreal.doctor import examine
from omniscv.cli import run


def examined(scene="four-wall", **options):
    """What the doctor finds, by name."""
    with mock_server.serve(scene, **options) as server, open_link(server.uri, timeout_s=10) as link:
        return {finding.name: finding for finding in examine(link)}


def test_a_server_without_faults_is_well():
    findings = examined()
    assert {finding.verdict for finding in findings.values()} == {"ok"}
    assert sum(name.startswith("seam ") for name in findings) == 12


def test_the_command_prints_json_and_tells_by_its_exit_code(capsys):
    assert run(["doctor", "mock://four-wall?fault=vignette=0.3", "--json"]) == 1
    findings = {each["name"]: each for each in json.loads(capsys.readouterr().out)}
    assert findings["vignette"]["verdict"] == "bad"
    assert "30.0%" in findings["vignette"]["value"]
    assert "r.Tonemapper.Quality 1" in findings["vignette"]["cure"]
    assert findings["exposure"]["verdict"] == "ok"


@pytest.mark.parametrize("address", ["room.sqlite", "http://localhost", "unreal://"])
def test_only_servers_are_examined(address, capsys):
    assert run(["doctor", address]) == 2
    assert "expected unreal://host:port" in capsys.readouterr().err
