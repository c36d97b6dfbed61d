"""Packaged games, started and stopped: a small program that serves the mock room stands in for one."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from omniscv.captures.inspection import info, verify
from omniscv.captures.unreal.launch import LaunchedSource, settings_folders
from omniscv.cli import run
from omniscv.errors import ArgumentError, ConnectionFailed

STAND_IN = Path(__file__).with_name("game.py")


@pytest.fixture
def game(tmp_path):
    """A package as Unreal makes them: a launcher, and the game in Game/Binaries/Linux."""
    binaries = tmp_path / "package" / "Game" / "Binaries" / "Linux"
    binaries.mkdir(parents=True)
    (tmp_path / "package" / "Engine" / "Binaries" / "Linux").mkdir(parents=True)
    shutil.copy(STAND_IN, binaries / "Game")
    launcher = tmp_path / "package" / "Game.sh"
    launcher.write_text(f'#!/bin/sh\n"{sys.executable}" "{binaries}/Game" "$@"\n')
    launcher.chmod(0o755)
    return launcher


def beside(game):
    return game.parent / "Game" / "Binaries" / "Linux"


def behave(game, **behaviour):
    (beside(game) / "behaviour.json").write_text(json.dumps(behaviour))


def is_running(game):
    try:
        os.kill(int((beside(game) / "pid").read_text()), 0)
    except ProcessLookupError:
        return False
    return True


def waited_for(condition):
    """Whether it comes true within a time that is long for any machine."""
    until = time.monotonic() + 60
    while not condition() and time.monotonic() < until:
        time.sleep(0.02)
    return condition()


def record(game, *options):
    return ["record", "--launch", str(game), "--face-size", "32", "--modes", "lit", *map(str, options)]


def test_a_launched_game_is_recorded_and_stopped(game, tmp_path):
    """It finds its settings beside the executable that the launcher starts, and they are gone afterwards."""
    out = tmp_path / "room.sqlite"
    behave(game, wait_s=0.3)
    assert run(record(game, "--out", out)) == 0
    settings = json.loads((beside(game) / "settings.json").read_text())
    assert (settings["width"], settings["height"], float(settings["fov"])) == ("32", "32", 90)
    assert 1024 < int(settings["port"]) < 65536
    assert (verify(out).ok, info(out).captures) == (True, {"lit": 6})
    assert waited_for(lambda: not is_running(game))
    assert not list(game.parent.rglob("unrealcv.ini"))


def test_ctrl_c_stops_the_game_and_keeps_the_captures(game, tmp_path):
    out = tmp_path / "room.sqlite"
    places = [f"--position={0.01 * step},0,1.5" for step in range(400)]
    command = [sys.executable, "-c", "from omniscv.cli import main; main()"]
    with subprocess.Popen(
        [*command, *record(game, "--out", out), *places], stderr=subprocess.PIPE, text=True
    ) as recorder:
        assert waited_for(lambda: out.exists() and verify(out).captures > 0)
        assert is_running(game)
        recorder.send_signal(signal.SIGINT)
        _, said = recorder.communicate(timeout=60)
    assert recorder.returncode == 130
    assert "stopped; what was captured is in the record" in said
    assert waited_for(lambda: not is_running(game))
    assert verify(out).ok
    assert 0 < info(out).captures["lit"] < 2400
    assert not list(game.parent.rglob("unrealcv.ini"))


def test_a_game_that_ends_is_quoted(game):
    behave(game, code=3, words="no GPU found")
    with pytest.raises(ConnectionFailed, match=r"ended with code 3; it said: no GPU found"):
        LaunchedSource(game)


def test_a_game_that_never_answers_is_stopped(game):
    behave(game, wait_s=600)
    with pytest.raises(ConnectionFailed, match=r"expected an answer at port \d+ within 1 s, got none"):
        LaunchedSource(game, patience_s=1)
    assert waited_for(lambda: not is_running(game))


def test_settings_that_were_there_come_back(game):
    """As soon as the game has read its own."""
    file = beside(game) / "unrealcv.ini"
    file.write_text("[UnrealCV.Core]\nPort=9000\n")
    with LaunchedSource(game, size=(64, 48), fov_deg=70.5) as source:
        assert source.capabilities.modes
        assert file.read_text() == "[UnrealCV.Core]\nPort=9000\n"
    settings = json.loads((beside(game) / "settings.json").read_text())
    assert (settings["width"], settings["height"], float(settings["fov"])) == ("64", "48", 70.5)


def test_one_package_twice_shares_the_captures(game, tmp_path):
    out = tmp_path / "room.sqlite"
    places = [f"--position={0.1 * step},0,1.5" for step in range(16)]
    assert run([*record(game, "--launch", game, "--out", out), *places]) == 0
    assert info(out).captures == {"lit": 96}
    assert len(info(out).servers) == 2
    assert not list(game.parent.rglob("unrealcv.ini"))


def test_settings_lie_beside_the_executable(game):
    assert settings_folders(game) == [beside(game)]
    assert settings_folders(beside(game) / "Game") == [beside(game)]
    assert settings_folders(game.parent / "Engine" / "tool") == [game.parent / "Engine"]


@pytest.mark.parametrize(
    ("uri", "says"),
    [
        ("launch:/no/such/Game", "/no/such/Game: expected a game that can be run"),
        (f"launch:{STAND_IN}", "expected a game that can be run"),  # it is no program by itself
        ("launch:Game?speed=2", "expected options such as port=9001.* got speed=2"),
        ("launch:Game?size=big", "got size=big"),
    ],
)
def test_what_cannot_be_started_is_told(uri, says):
    from omniscv import open_source

    with pytest.raises(ArgumentError, match=says):
        open_source(uri)
