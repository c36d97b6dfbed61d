"""Packaged games, started and stopped."""

import json

import pytest
from support.games import STAND_IN, behave, beside, is_running, waited_for

import omniscv
from omniscv.errors import ArgumentError, ServerConnectionError
from omniscv.sources.unreal.launcher import settings_folders


def test_a_game_that_ends_is_quoted(game):
    behave(game, code=3, words="no GPU found")
    with pytest.raises(ServerConnectionError, match=r"ended with code 3. Its last output: no GPU found"):
        omniscv.open_source(f"launch:{game}")


def test_a_game_that_never_answers_is_stopped(game):
    behave(game, wait_s=600)
    with pytest.raises(ServerConnectionError, match=r"reachable at port \d+, got none within 4 s"):
        omniscv.open_source(f"launch:{game}?startup_timeout_s=4")
    assert waited_for(lambda: not is_running(game))


def test_settings_that_were_there_come_back(game):
    """As soon as the game has read its own."""
    file = beside(game) / "unrealcv.ini"
    file.write_text("[UnrealCV.Core]\nPort=9000\n")
    with omniscv.open_source(f"launch:{game}?size=64x48&fov_deg=70.5") as source:
        assert source.capabilities.modes
        assert file.read_text() == "[UnrealCV.Core]\nPort=9000\n"
    settings = json.loads((beside(game) / "settings.json").read_text())
    assert (settings["width"], settings["height"], float(settings["fov"])) == ("64", "48", 70.5)


def test_settings_lie_beside_the_executable(game):
    assert settings_folders(game) == [beside(game)]
    assert settings_folders(beside(game) / "Game") == [beside(game)]
    assert settings_folders(game.parent / "Engine" / "tool") == [game.parent / "Engine"]


@pytest.mark.parametrize(
    ("uri", "says"),
    [
        ("launch:/no/such/Game", "/no/such/Game: expected a game that can be run"),
        (f"launch:{STAND_IN}", "expected a game that can be run"),  # it is no program by itself
        ("launch:Game?speed=2", "expected options among port, size, .* got 'speed'"),
        ("launch:Game?size=big", "expected a value of size, got 'big'"),
    ],
)
def test_what_cannot_be_started_is_one_clear_error(uri, says):
    with pytest.raises(ArgumentError, match=says):
        omniscv.open_source(uri)
