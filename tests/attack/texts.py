"""Hostile texts: jobs, scenes, calibration files and command lines."""

import json
import time

import yaml
from support.calibration_files import LENS, SAVED, TEXTS

from attack.commands import SECONDS, clear, nothing_left, ran, refused, require
from attack.spoiling import replaced, scrambled, write
from attack.words import ARGUMENTS, YAML
from mock_server import load_scene
from mock_server.settings import SCENES
from omniscv import Rig, RigCamera, calibration, cameras
from omniscv.calibration.kalibr import KALIBR
from omniscv.errors import ArgumentError
from omniscv.job import EXAMPLE, load

JOB = yaml.safe_load(EXAMPLE.read_text(encoding="utf-8"))
ROOMS = [yaml.safe_load(path.read_text(encoding="utf-8")) for path in sorted(SCENES.glob("*.yaml"))]


class Raw(str):
    """YAML to be written as it is."""


def written(value):
    """YAML of a description."""
    if isinstance(value, Raw):
        return str(value)
    if isinstance(value, dict):
        return "{" + ", ".join(f"{written(key)}: {written(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(written, value)) + "]"
    return value if isinstance(value, str) and value.isidentifier() else json.dumps(value)


def spoiled(rng, value):
    """What takes the place of a value in a description."""
    other = Raw(rng.choice(YAML))
    twice = Raw(f"{written(value)}, {written(value)}")
    return rng.choice([other, [value], {"a": value}, {other: value}, value, twice])


def description(rng, valid):
    """YAML of a description that is spoiled, scrambled or both."""
    for _ in range(rng.randint(0, 3)):
        valid = replaced(rng, valid, spoiled)
    text = written(valid)
    return scrambled(rng, text) if rng.random() < 0.4 else text


def judged(read, path, command):
    """Read a file; where it is refused, the command line must refuse it as well."""
    started = time.process_time()
    try:
        read(path)
    except ValueError as error:  # an ArgumentError is one
        spent = time.process_time() - started
        require(spent < SECONDS, f"{spent:.2f} s to refuse it")
        require(isinstance(error, ArgumentError) or read.__module__.startswith("mock_server"), repr(error))
        require("\n" not in str(error), f"more than one line: {error}")
        require(path.name in refused(command), f"{error}: the line does not name the file")
    require(time.process_time() - started < 5 * SECONDS, f"{time.process_time() - started:.2f} s to read it")


def described(rng, folder, name, valid, read, command):
    """Read a spoiled description of that name; where it is refused, no file is left."""
    with nothing_left(folder) as work:
        judged(read, write(work / name, description(rng, valid)), command)
        require([each.name for each in work.iterdir()] == [name], f"a refused {name} left files")


def job(rng, folder):
    command = rng.choice(["render", "plan", "record"])
    described(rng, folder, "job.yaml", JOB, load, [command, "job.yaml"])


def scene(rng, folder):
    source = f"{rng.choice(['scene', 'mock'])}://scene.yaml"
    command = ["render", "--size", "8x4", "--source", source]
    described(rng, folder, "scene.yaml", rng.choice(ROOMS), load_scene, command)


CHAIN = Rig({"cam0": RigCamera(LENS), "cam1": RigCamera.turned(LENS, (0.1, 0, 0), 20, time_offset=0.01)})
CALIBRATIONS = {
    **TEXTS,
    "opencv": calibration.dumps(SAVED["opencv"], "opencv", ".xml"),
    "opencv-omnidir": calibration.dumps(SAVED["opencv-omnidir"], "opencv-omnidir", ".json"),
    "kalibr": KALIBR.write(CHAIN.cameras, rig=True),
}


def calibration_file(rng, folder):
    name = rng.choice(list(CALIBRATIONS))
    path = write(folder / "camera.txt", scrambled(rng, CALIBRATIONS[name]))
    started = time.process_time()
    try:
        if name in ("kalibr", "aria") and rng.random() < 0.5:
            require(calibration.load_rig(path).cameras, "a rig without cameras")
            return
        found = calibration.load(path, rng.choice([name, None]))
        require(found and all(isinstance(each, cameras.Camera) for each in found.values()), repr(found))
    except ArgumentError as error:
        clear(error, name)
    require(time.process_time() - started < SECONDS, f"{name}: {time.process_time() - started:.2f} s")


VIEWED = "--source --camera --size --set --position --modes --accuracy"
OPTIONS = {
    "render": f"{VIEWED} --yaw --roll --stem".split(),
    "plan": VIEWED.split(),
    "record": ["--source", "--position", "--set", "--modes", "--overscan", "--launch"],
    "cameras": ["--x"],
    "doctor": ["--position"],
    "recording": ["--json"],
    "serve": ["--size", "--fault", "--dialect", "--depth", "--latency-ms", "--seed"],
    "chart": ["--progress"],
}
"""By command; a value may also stand alone."""

RUNS = {
    "render": "--size 8x4 --source scene://direction --set face_size=16 --set strategy=cube",
    "plan": "--size 8x4",
    "record": "--set face_size=16 --source scene://direction --modes lit",
    "serve": "--port 99999",
    "chart": "nothing",
}
"""What makes a command cheap, or sure to be refused, where it is not overridden."""


def command_line(rng, folder):
    command = rng.choice([*OPTIONS, "render", "render", "plan"])
    arguments = RUNS.get(command, "").split()
    for _ in range(rng.randint(1, 3)):
        option = rng.choice([*OPTIONS[command], ""])
        value = rng.choice(ARGUMENTS)
        one = option and rng.random() < 0.5
        arguments += [f"{option}={value}"] if one else filter(None, (option, value))
    if command == "recording":
        arguments.insert(0, rng.choice(["info", "verify", "export", "import", "info"]))
    with nothing_left(folder):
        ran([command, *arguments])


def case(rng, folder):
    rng.choice([job, scene, calibration_file, command_line])(rng, folder)
