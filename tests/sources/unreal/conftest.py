"""A packaged game: a small program that serves the mock room stands in for one."""

import shutil
import sys

import pytest
from support.games import STAND_IN


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
