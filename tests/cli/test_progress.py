"""How far long work has come, and signals that end it, also where a shell started it with SIGINT ignored."""

import contextlib
import math
import re
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import pytest
from support.processes import OMNISCV, started

from omniscv import cli
from omniscv.cli import console, run
from omniscv.cli.console import Display, display
from omniscv.errors import NotARecordingError, RecordingError
from omniscv.job import load
from omniscv.make import run as run_job
from omniscv.progress import Meter, Progress, Remaining, phase, without_images
from omniscv.sources.recording.inspection import info, verify

JOB = """
source: scene://four-wall
cameras:
  flat: {model: equirectangular, width: 16, height: 8}
  ring: {model: noncentral-panorama, width: 16, height: 8, radius: 0.5}
poses: [{position: [0, 0, 1.5]}, {position: [0.5, 0, 1.5]}]
modes: [lit, depth]
face_size: 16
strategy: exact
out: images
"""


@pytest.fixture
def job(tmp_path):
    path = tmp_path / "job.yaml"
    path.write_text(JOB)
    return path


def test_the_progress_of_a_job_only_grows_and_ends_at_all(job):
    seen = []
    run_job(load(job), seen.append)
    for before, after in pairwise(seen):
        gained = after - before
        assert min(gained.images, gained.captures, gained.of_captures, gained.nbytes) >= 0
    assert {each.of_images for each in seen} == {4}
    assert seen[-1].images == 4
    assert seen[-1].captures == seen[-1].of_captures > 0
    pixels = seen[-1].nbytes / seen[-1].captures
    assert 16 * 16 * 3 <= pixels <= 64 * 64 * 4, "bytes of a small picture, colours or depth"


def test_plain_progress_is_lines_where_it_is_asked_for_and_counts_each_capture_once(job, capfd):
    assert run(["render", str(job)]) == 0
    assert capfd.readouterr().err == ""
    recording = job.with_name("room.sqlite")
    assert run(["record", str(job), "--out", str(recording), "--progress", "plain"]) == 0
    _, *lines = capfd.readouterr().err.splitlines()  # the first: --out overrides a key
    line = r"images \d/4(, \d+/\d+ captures, \d+\.\d MB, [\d.e+]+/s, \d+\.\d MB/s)?(, [\d:]+ left)?"
    assert len(lines) >= 2
    assert all(re.fullmatch(line, each) for each in lines), lines
    there = sum(info(recording).captures.values())
    assert lines[-1].startswith(f"images 4/4, {there}/{there} captures, ")
    assert lines[-1].endswith(", 0:00 left")


def test_without_a_terminal_there_are_lines_at_times_that_grow_to_a_minute(monkeypatch, capsys):
    clock = iter([0, *(40 * step for step in range(1, 8)), *range(1000, 2000, 40)])
    monkeypatch.setattr(time, "monotonic", lambda: next(clock))
    monkeypatch.setattr(console, "FIRST_LINE_S", 20.0)
    for style, count in ((None, 5), ("none", 0)):  # after 40, 80, 120, 200, 280 s
        with display("images", style) as shown:
            for done in range(7):
                shown.steps(done, 9)
        assert len(capsys.readouterr().err.splitlines()) == count
    monkeypatch.undo()
    with contextlib.closing(Display("images", "plain", every_s=3600)) as shown:
        for done in range(100):
            shown.steps(done, 100)
    assert capsys.readouterr().err.startswith("images 0/100\nimages 99/100")


def test_phases_are_shown_with_their_steps_also_while_they_report_nothing(monkeypatch, capsys):
    monkeypatch.setattr(console, "FIRST_LINE_S", 0.01)
    with display("images") as shown, phase("opening the source"):
        printed = ""
        while "opening the source" not in printed:
            time.sleep(0.05)
            printed += capsys.readouterr().err
        with phase("searching places", 9) as step:
            step(4)
            assert shown.line() == "searching places 4/9"
        assert shown.line() == "opening the source"
    assert shown.line() == "images 0/0"


SEARCHED = """
source: scene://four-wall
cameras: {pano: {model: equirectangular, width: 16, height: 8}}
poses: {random: {low: [-1, -1, 1], high: [1, 1, 2], count: 9, clearance: 0.2, seed: 1}}
modes: [depth]
face_size: 16
"""


def test_a_command_names_its_phases(tmp_path, monkeypatch):
    """Places are searched once, also of a dataset that is limited: keys need no places."""
    (tmp_path / "job.yaml").write_text(SEARCHED)
    seen = []
    for arguments in (["plan"], ["dataset", "make", "--limit", "2", "--set", "out=made"]):
        monkeypatch.setattr(Display, "phase", lambda _, *phase: seen.append(phase))
        monkeypatch.chdir(tmp_path)
        assert run([*arguments, "job.yaml"]) == 0
        names = [name for name, _, _ in seen]
        assert {"opening the source", "searching places"} < set(names)
        assert seen.count(("searching places", 9, 9)) == 1
        seen.clear()


def test_what_is_left_is_shown_once_it_is_known(monkeypatch):
    clock = iter((0.0, 5.0, 7.5, 9.0, 11.0, 13.0, 15.0, 30.0))
    monkeypatch.setattr(time, "monotonic", lambda: next(clock))
    shown = Display("images")
    assert (shown.fraction, shown.line()) == (0, "images 0/0")
    shown(Progress(1, 10, 10, 10))
    assert shown.fraction == 1 / 10
    assert "left" not in shown.line(), "one image may have taken what is made once"
    shown(Progress(1, 10, 20, 30))  # half of the captures known of the second image
    assert shown.fraction == pytest.approx(1.5 / 10)
    shown(Progress(2, 10, 30, 30))
    assert "left" not in shown.line()
    for images in (3, 4, 5):
        shown(Progress(images, 10, 10 * images, 10 * images))
    assert shown.line().endswith(", 0:10 left")
    shown(Progress(10, 10, 90, 90))
    assert shown.line().endswith(", 0:00 left")


RUNS = {
    "alike": (5, [1.0] * 50),
    "a long start": (40, [0.2] * 500),
    "a slow first image": (5, [30, *[1.0] * 99]),
    "four at a time": (3, [4.0 if number % 4 == 0 else 0.01 for number in range(80)]),
    "kept ones first": (1, [*[0.001] * 5, *[2.0] * 95]),
    "uneven": (2, [1 + 0.7 * math.sin(2.4 * number) for number in range(60)]),
}


@pytest.mark.parametrize("run", RUNS)
def test_what_is_left_is_within_half_from_a_tenth_of_a_run_on_or_not_shown(run):
    start_s, images_s = RUNS[run]
    whole_s = start_s + sum(images_s)
    remaining = Remaining()
    now_s = start_s
    shown = 0
    for number, image_s in enumerate(images_s, start=1):
        now_s += image_s
        remaining.note(Progress(number, len(images_s), 6 * number, 6 * number), now_s)
        left_s = remaining.seconds(now_s)
        if now_s < whole_s / 10 or number == len(images_s) or left_s is None:
            continue
        shown += 1
        each_s = max(images_s[1:])  # the image in progress may be nearly done
        assert left_s <= 1.5 * (whole_s - now_s) + each_s
        assert left_s >= (whole_s - now_s) / 1.5 - each_s
    assert shown > 0.3 * len(images_s)


def test_what_is_left_of_one_image_follows_from_its_captures_after_the_first():
    remaining = Remaining()
    for captures in range(1, 19):
        seconds = 20.0 + 5 * captures  # twenty seconds of opening, and of what is compiled
        remaining.note(Progress(0, 1, captures, 18), seconds)
        left_s = remaining.seconds(seconds)
        assert left_s in (None, pytest.approx(5 * (18 - captures)))
    assert left_s == 0


def test_parts_add_up_from_any_number_of_threads():
    seen = []
    meter = Meter(8, seen.append)

    def work(_):
        part = meter.part()
        for done in range(1, 101):
            part(Progress(done // 50, 1, done, 100, 10 * done))

    with ThreadPoolExecutor(4) as threads:
        list(threads.map(work, range(4)))
    without_images(meter.part())(Progress(5, 5, 1, 1, 1))
    assert seen[-1] == Progress(8, 8, 401, 401, 4001)


def captures_in(path):
    try:
        return verify(path).captures
    except (NotARecordingError, RecordingError):  # not there yet, or just being made
        return 0


HUP = pytest.param(signal.SIGHUP, [], marks=pytest.mark.soak)


@pytest.mark.parametrize(("number", "ignored"), [(signal.SIGINT, [signal.SIGINT, signal.SIGHUP]), HUP])
def test_a_signal_ends_a_recording_that_can_be_resumed(number, ignored, tmp_path):
    """It may come several times, as from ``timeout`` and terminals. SIGHUP under nohup changes nothing."""
    out = tmp_path / "room.sqlite"
    positions = [f"--position={0.001 * step},0,1.5" for step in range(1000)]
    options = ["--set", "face_size=32", "--modes", "lit", "--out", out]
    with started(*OMNISCV, "record", *options, *positions, ignored=ignored) as process:
        if signal.SIGHUP in ignored:
            process.send_signal(signal.SIGHUP)
        while captures_in(out) == 0:
            assert process.poll() is None
            time.sleep(0.02)
        for _ in range(3):
            process.send_signal(number)
        _, said = process.communicate(timeout=60)
    assert process.returncode == 128 + number
    stopped = "omniscv: stopped; what is complete is kept; this goes on: "
    assert (
        said.splitlines()[-1] == f"{stopped}the same command, without --overwrite and --resume if it has them"
    )
    assert verify(out).ok
    assert 0 < info(out).captures["lit"] < 6000


# What a handler raises within a callback of C, or in ``__del__``, is printed and gone.
LOST = """
class Ends:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGTERM)
        sum(range(1000))
def command():
    Ends()
    console.check()
    return 0
"""
INTERRUPTED = """
def command():
    try:
        os.kill(os.getpid(), signal.SIGINT)
        sum(range(1000))
    except KeyboardInterrupt as cause:
        raise ImportError("failed to import") from cause
"""


@pytest.mark.parametrize(("command", "code"), [(LOST, 143), (INTERRUPTED, 130)])
def test_a_signal_that_was_lost_is_noticed_and_what_an_import_makes_of_it_is_no_failure(command, code):
    program = f"import os, signal, sys\nfrom omniscv.cli import console\n{command}"
    run_it = [sys.executable, "-c", f"{program}\nsys.exit(console.unwound(command))"]
    done = subprocess.run(run_it, timeout=60, capture_output=True)
    assert (done.returncode, done.stderr) == (code, b"")


def test_a_signal_before_the_command_begins_stops_it_too(monkeypatch):
    """Nothing of a command runs outside of what unwinds it."""
    monkeypatch.setattr(cli, "_print_log", lambda: pytest.fail("it is not guarded"))
    monkeypatch.setattr(cli.console, "unwound", lambda command: 130)
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 130
