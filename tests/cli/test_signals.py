"""Ctrl-C, also where a shell started the command with SIGINT ignored, as it does with background jobs."""

import signal
import subprocess
import sys
import time
from contextlib import contextmanager

import pytest

from omniscv.errors import NotARecordingError, RecordingError
from omniscv.sources.recording.inspection import info, verify

COMMAND = [sys.executable, "-c", "from omniscv.cli import main; main()"]


@contextmanager
def started(*arguments, ignored=False):
    """A command in a process of its own, killed if the test fails."""
    before = (lambda: signal.signal(signal.SIGINT, signal.SIG_IGN)) if ignored else None
    process = subprocess.Popen(
        [*COMMAND, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=before,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def captures_in(path):
    try:
        return verify(path).captures
    except (NotARecordingError, RecordingError):  # not there yet, or just being made
        return 0


@pytest.mark.parametrize("ignored", [False, True])
def test_ctrl_c_ends_a_recording_that_can_be_resumed(ignored, tmp_path):
    out = tmp_path / "room.sqlite"
    positions = [f"--position={0.001 * step},0,1.5" for step in range(1000)]
    options = ["--face-size", "32", "--modes", "lit", "--out", out]
    with started("record", *options, *positions, ignored=ignored) as process:
        while captures_in(out) == 0:
            assert process.poll() is None
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert said == "omniscv: stopped; recorded captures are kept, rerun to resume\n"
    assert verify(out).ok
    assert 0 < info(out).captures["lit"] < 6000


@pytest.mark.parametrize("ignored", [False, True])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_server_quietly(number, ignored):
    with started("serve", "six-wall", "--port", "0", ignored=ignored) as process:
        assert "six-wall at unreal://127.0.0.1:" in process.stdout.readline()
        process.send_signal(number)
        assert process.communicate(timeout=60) == ("", "")
    assert process.returncode == 0
