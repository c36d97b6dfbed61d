"""Runs command lines from documents and help texts, each as far as a test can."""

import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

from support.documents import LEAST_PX, at_ports, shrunk

ROOT = Path(__file__).resolve().parents[2]

PARSED_ONLY = ("demo", "chart", "evaluate")
"""Commands that take long, and have tests of their own."""

READING = (
    *("cameras", "doctor", "job", "plan", "scenes", "send", "serve", "dataset check", "dataset info"),
    *("recording info", "recording places", "recording check"),
)
"""Commands that leave nothing behind: one document runs them for all, the others' are parsed."""

_EXIT_CODES = {"doctor": (0, 1)}  # 1: it found something bad


def name_of(words):
    """The command of a command line: its first word or, of a group, two."""
    pair = " ".join(words[1:3])
    return pair if words[1] in ("recording", "dataset") else words[1]


def shape_of(words):
    """What two command lines that run the same code share: the command and its options' names."""
    if words[1] in ("doctor", "serve"):  # addresses and options have tests of their own
        return words[1], "--self" in words
    options = {word.partition("=")[0] for word in words if word.startswith("--")}
    return name_of(words), frozenset(options), words[2].partition("://")[0] if len(words) > 2 else ""


def parse(command, words):
    """Check that a click command accepts the words, without running it."""
    with command.make_context(command.name, list(words)) as context:
        if hasattr(command, "resolve_command"):
            rest = [*getattr(context, "_protected_args", ()), *context.args]
            parse(*command.resolve_command(context, rest)[1:])


def sized(arguments):
    """The words of a command that composes an image, with small sizes where it names none."""
    if arguments[0] not in ("render", "plan") or "--source" not in arguments:
        return arguments
    camera = arguments[arguments.index("--camera") + 1] if "--camera" in arguments else ""
    if Path(camera).suffix:  # a calibration, with its size
        return [*arguments, "--set", f"face_size={LEAST_PX}"]
    return arguments if "--size" in arguments else [*arguments, "--size", f"{2 * LEAST_PX}x{LEAST_PX}"]


def run(words, ports, parsed_only=False):
    """Run a command line in the present folder, or parse it; an AssertionError names it if it fails."""
    if words[0] != "omniscv":
        script = ROOT / words[0]
        assert os.access(script, os.X_OK), f"{words[0]}: expected an executable file"
        return
    from typer.main import get_command

    from omniscv import cli

    arguments = sized(at_ports(shrunk("\0".join(words[1:])), ports).split("\0"))
    if parsed_only or arguments[0] in PARSED_ONLY or "--launch" in arguments:
        parse(get_command(cli.app), arguments)
    elif arguments[0] == "serve":
        _serve(arguments)
    else:
        code = cli.run(arguments)
        expected = _EXIT_CODES.get(arguments[0], (0,))
        assert code in expected, f"{' '.join(words)}: expected exit code {expected}, got {code}"


def _serve(arguments):
    """Start a server at any free port, and stop it once it has printed its address."""
    anywhere = re.sub(r"--port[=\0]\d+", "--port=0", "\0".join(arguments)).split("\0")
    program = "from omniscv.cli import main; main()"
    process = subprocess.Popen([sys.executable, "-c", program, *anywhere], stdout=subprocess.PIPE, text=True)
    try:
        assert "unreal://" in process.stdout.readline()
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=60)
        assert process.returncode == 0
    finally:
        process.kill()


JOB = """
source: mock://four-wall
cameras: {panorama: {model: equirectangular, width: 64, height: 32}}
poses: [{position: [0, 0, 1.5]}]
face_size: 64
out: images
"""


CLASSES = "rules: [{match: '*', class: thing}]\n"


def example_inputs(folder):
    """Write the files that examples of the help read into the present folder: a job, recordings, images, a
    dataset, a folder of captures."""
    (folder / "job.yaml").write_text(JOB, encoding="utf-8")
    recording = folder / "captures" / "four-wall.sqlite"
    for name in ("room.sqlite", "kitchen.sqlite"):
        shutil.copy(recording, folder / name)
    run(["omniscv", "render", "job.yaml"], {})
    job = JOB.replace("out: images", "modes: [lit, object_mask]\nclasses: classes.yaml\nout: dataset")
    (folder / "classes.yaml").write_text(CLASSES, encoding="utf-8")
    (folder / "dataset.yaml").write_text(job, encoding="utf-8")
    run(["omniscv", "dataset", "make", "dataset.yaml"], {})
    run(["omniscv", "recording", "export", str(recording), "faces/"], {})
