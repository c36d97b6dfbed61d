"""Packaged games, started and stopped."""

import json
import os
import signal
import subprocess
import sys
import threading

import psutil
import pytest
from support.games import STAND_IN, behave, beside, is_running, waited_for

import omniscv
from omniscv.errors import ArgumentError, DeadlineError, ServerConnectionError, SourceError
from omniscv.sources.unreal import watcher
from omniscv.sources.unreal.launcher import BACKUP, settings_folders, temporary_settings


def test_a_game_that_ends_is_quoted_and_its_settings_lie_beside_it(game):
    behave(game, code=3, words="no GPU found")
    with pytest.raises(ServerConnectionError, match=r"ended with code 3. Its last output: no GPU found"):
        omniscv.open_source(f"launch:{game}")
    assert settings_folders(game) == [beside(game)]
    assert settings_folders(beside(game) / "Game") == [beside(game)]
    assert settings_folders(game.parent / "Engine" / "tool") == [game.parent / "Engine"]


def test_a_game_that_never_answers_is_stopped(game):
    behave(game, wait_s=600)
    with pytest.raises(ServerConnectionError, match=r"reachable at port \d+, got none within 2 s"):
        omniscv.open_source(f"launch:{game}?startup_timeout_s=2")
    assert waited_for(lambda: not is_running(game))


def test_settings_come_back_while_the_game_runs_which_is_stopped_also_without_its_watcher(game):
    file = beside(game) / "unrealcv.ini"
    file.write_text("[UnrealCV.Core]\nPort=9000\n")
    with omniscv.open_source(f"launch:{game}?size=64x48&fov_deg=70.5") as source:
        assert source.capabilities.modes
        assert file.read_text() == "[UnrealCV.Core]\nPort=9000\n"
        script = psutil.Process(int((beside(game) / "pid").read_text())).parent()
        script.parent().kill()
    assert waited_for(lambda: not is_running(game))
    settings = json.loads((beside(game) / "settings.json").read_text())
    assert (settings["width"], settings["height"], float(settings["fov"])) == ("64", "48", 70.5)


OPENED_AND_KEPT = """
import sys, threading, omniscv
source = omniscv.open_source(sys.argv[1])
print("open", flush=True)
threading.Event().wait()
"""


def test_a_game_ends_with_its_recorder_even_on_sigkill_and_its_settings_come_back(game):
    """Killed while the game loads, and while it serves; the next launch puts the user's settings back."""
    file = beside(game) / "unrealcv.ini"
    file.write_text("[UnrealCV.Core]\nPort=9000\n")
    file.chmod(0o640)
    for wait_s in (600, 0):
        behave(game, wait_s=wait_s)
        command = [sys.executable, "-c", OPENED_AND_KEPT, f"launch:{game}"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as recorder:
            assert (
                waited_for((beside(game) / "settings.json").exists) if wait_s else recorder.stdout.readline()
            )
            assert is_running(game)
            assert (beside(game) / BACKUP).exists() == bool(wait_s)
            recorder.kill()
        assert waited_for(lambda: not is_running(game))
        for name in ("pid", "settings.json"):
            (beside(game) / name).unlink()
    assert not (beside(game) / BACKUP).exists()
    assert file.read_text() == "[UnrealCV.Core]\nPort=9000\n"
    assert file.stat().st_mode & 0o777 == 0o640


STUBBORN = """#!/bin/sh
trap '' TERM
sleep 600 &
echo $! > child
wait
"""


def test_a_game_that_will_not_stop_is_killed_with_its_children(tmp_path):
    script = tmp_path / "Game.sh"
    child = tmp_path / "child"
    script.write_text(STUBBORN)
    script.chmod(0o755)
    with subprocess.Popen([sys.executable, watcher.__file__, "0.3", script], stdin=-1, stdout=-1) as watching:
        process = psutil.Process(int(watching.stdout.readline()))
        assert waited_for(lambda: child.exists() and child.read_text().strip())
        sleeper = psutil.Process(int(child.read_text()))
        assert process.is_running()
        assert sleeper.is_running()
    assert watching.returncode == 128 + signal.SIGKILL
    assert waited_for(lambda: not (process.is_running() or sleeper.is_running()))


def test_a_game_is_stopped_whose_starter_is_gone_before_it_knows_its_process(tmp_path):
    script = tmp_path / "Game.sh"
    child = tmp_path / "child"
    script.write_text("#!/bin/sh\necho $$ > child\nsleep 600\n")
    script.chmod(0o755)
    reading, writing = os.pipe()
    os.close(reading)
    with subprocess.Popen([sys.executable, watcher.__file__, "5", script], stdin=-1, stdout=writing):
        os.close(writing)
        assert waited_for(lambda: child.exists() and child.read_text().strip())
        process = psutil.Process(int(child.read_text()))
    assert waited_for(lambda: not process.is_running())


OURS = "; written by omniscv for one launch"


def killed_while_borrowing(folder):
    borrowing = temporary_settings(folder, "Port=1\n", 1)
    borrowing.__enter__()
    left = {path.name: path.read_bytes() for path in folder.iterdir()}
    borrowing.__exit__(None, None, None)
    for path in folder.iterdir():
        path.unlink()
    for name, data in left.items():
        (folder / name).write_bytes(data)


@pytest.mark.parametrize("before", [None, b"", b"Port=7\n"])
def test_settings_come_back_after_a_launch_and_after_a_killed_one(before, tmp_path):
    file = tmp_path / "unrealcv.ini"
    if before is not None:
        file.write_bytes(before)
    killed_while_borrowing(tmp_path)
    assert file.read_text().startswith(OURS)
    for _ in range(2):  # the second launch finds nothing to repair
        with temporary_settings(tmp_path, "Port=2\n", 1):
            assert file.read_text().startswith(OURS)
            assert file.read_text().endswith("Port=2\n")
            assert (tmp_path / BACKUP).exists() == (before is not None)
        left = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
        assert left == ({} if before is None else {"unrealcv.ini": before})


def test_settings_that_were_changed_after_a_kill_are_not_touched(tmp_path):
    (tmp_path / "unrealcv.ini").write_text("Port=7\n")
    killed_while_borrowing(tmp_path)
    (tmp_path / "unrealcv.ini").write_text("Port=8\n")
    with pytest.raises(SourceError, match=r"either .*-backup, .* or unrealcv.ini, changed since; keep"):
        temporary_settings(tmp_path, "", 1).__enter__()
    assert (tmp_path / "unrealcv.ini").read_text() == "Port=8\n"
    assert (tmp_path / BACKUP).read_text() == "Port=7\n"


def test_launches_of_one_package_wait_for_one_another(tmp_path):
    file = tmp_path / "unrealcv.ini"
    file.write_text("Port=7\n")
    seen = []

    def launch_another():
        with temporary_settings(tmp_path, "Port=2\n", 60):
            seen.append(file.read_text())

    with temporary_settings(tmp_path, "Port=1\n", 1):
        other = threading.Thread(target=launch_another)
        other.start()
        with pytest.raises(DeadlineError, match="another launch has not started yet"):
            temporary_settings(tmp_path, "", 0.2).__enter__()
        assert file.read_text().endswith("Port=1\n")
    other.join(60)
    assert [text[-7:] for text in seen] == ["Port=2\n"]
    assert file.read_text() == "Port=7\n"


def test_what_cannot_be_started_is_one_clear_error(tmp_path):
    for uri, says in (
        ("launch:/no/such/Game", "/no/such/Game: expected a game that can be run"),
        (f"launch:{STAND_IN}", "expected a game that can be run"),  # it is no program by itself
        ("launch:Game?speed=2", "expected options among port, size, .* got 'speed'"),
        ("launch:Game?size=big", "expected a value of size, got 'big'"),
        ("launch:Game?size=0x5", "size: expected a whole number of pixels >= 1, got 0"),
        ("launch:Game?port=65536", "port: expected a whole number <= 65535, got 65536"),
        ("launch:Game?fov_deg=nan", "fov_deg: expected a finite number > 0 and < 180, got nan"),
        ("launch:Game?startup_timeout_s=inf", "startup_timeout_s: expected a finite number > 0, got inf"),
    ):
        with pytest.raises(ArgumentError, match=says):
            omniscv.open_source(uri)
    game = tmp_path / "Game"
    game.write_bytes(b"\x7fELF and no more")
    game.chmod(0o755)
    with pytest.raises(ArgumentError, match=r"expected a game that can be run, got: .*Exec format error"):
        omniscv.open_source(f"launch:{game}")
    assert list(tmp_path.iterdir()) == [game]
