"""Hostile texts: jobs, scenes, calibration files and command lines."""

import json
import time

from attack.commands import SECONDS, clear, nothing_left, ran, refused, require
from attack.spoiling import scrambled, write
from attack.words import ARGUMENTS, YAML
from omniscv import Rig, RigCamera, calibration, cameras
from omniscv.calibration.kalibr import KALIBR
from omniscv.errors import ArgumentError
from omniscv.job import load

SMALL = {"width": 8, "height": 8}
PINHOLE = {"model": "pinhole", **SMALL}
JOB = {
    "source": "scene://four-wall",
    "record": "room.sqlite",
    "cameras": {
        "fish": {"model": "fisheye-equidistant", **SMALL, "fov_deg": 185, "center": [8, 8]},
        "ball": {"model": "noncentral-spherical-mirror", **SMALL, "mirror_radius": 0.3, "distance": 0.3},
        "lens": {"model": "kannala-brandt", **SMALL, "fx": 4, "fy": 4, "k": [0.1, 0, 0, 0]},
        "poly": {"model": "scaramuzza", **SMALL, "coefficients": [-4, 0, 0.1], "affine": [1, 0, 0]},
        "roll": {"model": "cylindrical", **SMALL, "fov_v_deg": 90, "profile": "angular"},
        "bowl": {"model": "catadioptric-hyperbolic", **SMALL, "distance": 1, "semi_latus_rectum": 0.4},
        "cone": {"model": "noncentral-conical-mirror", **SMALL, "half_angle_deg": 55, "distance": 0.3},
    },
    "poses": [
        {"position": [0, 0, 1.5], "yaw_deg": 90},
        {"position": [1, 0, 1], "pitch_deg": 5, "roll_deg": 1},
    ],
    "modes": ["lit", "depth"],
    "out": "images",
    "strategy": "cube",
    "viewpoints": 2,
    "face_size": 16,
    "filter": "bilinear",
    "image_format": "png",
    "rig": {
        "cameras": {
            "left": {"camera": PINHOLE, "position": [0.1, 0, 0]},
            "right": {"camera": PINHOLE, "yaw_deg": 9, "time_offset": 0},
        }
    },
    "source_options": {"timeout_s": 5, "retries": 0},
}
WAYPOINTS = {"kind": "waypoints", "points": [[0, 0, 0, 0, 0], [2, 1, 0, 0, 90]], "repeat": True}
SWING = {"kind": "swing", "by": [0.1, 0, 0], "turn_deg": 30, "period_s": 2, "about": [1.5, 1]}
TEXTURE = {"kind": "checker", "colors": [[0.1, 0.2, 0.3], [1, 1, 1]], "scale": 0.2, "angle_deg": 10}
SCENE = {
    "sky": [0.1, 0.2, 0.3],
    "pattern": {"kind": "waves", "period_rad": 0.1},
    "room": {
        "floor": [[-2, -2], [3, -2], [3, 2], [-2, 2]],
        "height": 2.5,
        "walls": [TEXTURE, {"kind": "plain"}],
        "floor_texture": TEXTURE,
        "ceiling_texture": {},
    },
    "objects": {
        "Table": {"texture": TEXTURE, "solids": [{"box": [1, 1, 0.1], "at": [1, 0, 0.7], "turn_deg": 20}]},
        "Ball": {"solids": [{"sphere": 0.2, "at": [1, 1, 1], "texture": TEXTURE}]},
        "Post": {"solids": [{"cylinder": [0.1, 1], "at": [-1, 1, 0.5]}], "moving": WAYPOINTS},
        "Door": {"solids": [{"box": [1, 0.1, 2], "at": [2, 1, 1]}], "moving": SWING},
    },
}


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


def spoiled(rng, value, chance=1.0):
    """A description with something in it replaced, removed, renamed, doubled or wrapped."""
    if not isinstance(value, dict | list) or not value or rng.random() < 0.15:
        return rng.choice(
            [Raw(rng.choice(YAML)), [value], {"a": value}, value, Raw(f"{written(value)}, {written(value)}")]
        )
    if isinstance(value, list):
        index = rng.randrange(len(value))
        changed = rng.choice([[], [spoiled(rng, value[index])], [value[index]] * 2])
        return [*value[:index], *changed, *value[index + 1 :]]
    key = rng.choice(list(value))
    action = rng.random()
    rest = {each: value[each] for each in value if each != key}
    if action < 0.1:
        return rest
    if action < 0.2:
        return {**rest, Raw(rng.choice(YAML)): value[key]}
    return {**rest, key: spoiled(rng, value[key])}


def description(rng, valid):
    """YAML of a description that is spoiled, scrambled or both."""
    for _ in range(rng.randint(0, 3)):
        valid = spoiled(rng, valid)
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


def job(rng, folder):
    with nothing_left(folder) as work:
        path = write(work / "job.yaml", description(rng, JOB))
        judged(load, path, [rng.choice(["render", "plan", "record"]), path.name])
        require([each.name for each in work.iterdir()] == ["job.yaml"], "a refused job left files")


def scene(rng, folder):
    import mock_server

    with nothing_left(folder) as work:
        path = write(work / "scene.yaml", description(rng, SCENE))
        source = f"{rng.choice(['scene', 'mock'])}://{path.name}"
        judged(mock_server.load_scene, path, ["render", "--size", "8x4", "--source", source])
        require([each.name for each in work.iterdir()] == ["scene.yaml"], "a refused scene left files")


def _calibrations():
    lens = cameras.create("kannala-brandt", 40, 30, fx=15.0, fy=15.5, cx=20.25, cy=14.0, k=[0.1, 0, 0, 1e-5])
    bent = cameras.create("scaramuzza", 40, 30, coefficients=[-15.0, 0.0, 0.01], affine=(1.01, 0.001, -0.002))
    plain = cameras.create("pinhole", 40, 30, fx=25.0, fy=26.0, distortion=(-0.2, 0.03, 1e-3, 0))
    mei = cameras.create("unified", 40, 30, fx=20.0, fy=21.0, xi=1.1)
    aria = cameras.create("fisheye624", 640, 480, fx=240.0, fy=240.0)
    theta = cameras.create("ftheta", 40, 30, polynomial=(0, 0.05, 0, 1e-6), reference="pixel-to-angle")
    rig = Rig({"cam0": RigCamera(lens), "cam1": RigCamera.turned(lens, (0.1, 0, 0), 20, time_offset=0.01)})
    return {
        "json": calibration.dumps({"cam0": bent}, "json"),
        "opencv": calibration.dumps({"cam0": plain}, "opencv", ".xml"),
        "opencv-fisheye": calibration.dumps({"cam0": lens}, "opencv-fisheye"),
        "opencv-omnidir": calibration.dumps({"cam0": mei}, "opencv-omnidir", ".json"),
        "kalibr": KALIBR.write(rig.cameras, rig=True),
        "colmap": calibration.dumps({"1": lens}, "colmap"),
        "ocamcalib": calibration.dumps({"cam0": bent}, "ocamcalib"),
        "aria": calibration.dumps({"camera-slam-left": aria}, "aria"),
        "isaac": calibration.dumps({"cam0": lens, "cam1": theta}, "isaac"),
        "ncore": calibration.dumps({"cam0": theta}, "ncore"),
    }


CALIBRATIONS = _calibrations()


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
    "render": [
        "--size",
        "8x4",
        "--source",
        "scene://direction",
        "--set",
        "face_size=16",
        "--set",
        "strategy=cube",
    ],
    "plan": ["--size", "8x4"],
    "record": ["--set", "face_size=16", "--source", "scene://direction", "--modes", "lit"],
    "serve": ["--port", "99999"],
    "chart": ["nothing"],
}
"""What makes a command cheap, or sure to be refused, where it is not overridden."""


def command_line(rng, folder):
    command = rng.choice([*OPTIONS, "render", "render", "plan"])
    arguments = list(RUNS.get(command, []))
    for _ in range(rng.randint(1, 3)):
        option, value = rng.choice([*OPTIONS[command], ""]), rng.choice(ARGUMENTS)
        arguments += (
            [f"{option}={value}"]
            if option and rng.random() < 0.5
            else [each for each in (option, value) if each]
        )
    if command == "recording":
        arguments.insert(0, rng.choice(["info", "verify", "export", "import", "info"]))
    with nothing_left(folder):
        ran([command, *arguments])


def case(rng, folder):
    """Draw a hostile text of any kind."""
    rng.choice([job, scene, calibration_file, command_line])(rng, folder)
