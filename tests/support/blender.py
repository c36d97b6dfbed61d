"""Blender where it is found, scenes made with it, and a program that speaks as it does."""

import atexit
import json
import os
import shutil
import subprocess
import sys
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path

from mock_server import load_scene, scene_file
from mock_server.solids import BOX, CYLINDER, RECTANGLE, SPHERE
from mock_server.yaml_text import parse, read_text
from omniscv.errors import OmniscvError
from omniscv.sources.blender import blender_command

HERE = Path(__file__).parent
_KINDS = {RECTANGLE: "rectangle", BOX: "box", SPHERE: "sphere", CYLINDER: "cylinder"}


def found():
    """The command that runs a script inside Blender; None where there is no Blender."""
    with suppress(OmniscvError):
        return blender_command()[:-1]
    return None


def run_inside(script, *arguments):
    """Run a script inside Blender."""
    command = [*found(), str(script), *(() if found()[-1] == "-P" else ("--",)), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr[-1000:]


@cache
def rebuilt(name, sides=64):
    """The path of a scene of the mock server, rebuilt in Blender once; what is round has so many sides."""
    folder = Path(tempfile.mkdtemp(prefix="omniscv-rooms-"))
    atexit.register(shutil.rmtree, folder)
    path = folder / f"{name}.blend"
    (folder / "room.json").write_text(json.dumps(_solids(name)))
    run_inside(HERE / "blender_room.py", folder / "room.json", path, sides)
    return path


def address(name, query="samples=1", sides=64):
    """The address of a scene of the mock server, rebuilt in Blender."""
    return f"blender://{rebuilt(name, sides)}?{query}"


def _solids(name):
    scene = load_scene(name)
    page = Path(scene_file.__file__).parent / "scenes" / f"{name}.yaml"
    file = scene_file.read(parse(read_text(page)), name)
    objects = {each: {"color": _color(scene.label(each)), "solids": []} for each in scene.objects}
    for owner, row in zip(file.names, file.rows, strict=True):
        row = [float(x) for x in row]
        axes = [row[5:8], row[8:11], row[11:14]]
        solid = {"kind": _KINDS[int(row[0])], "center": row[2:5], "axes": axes, "half": row[14:17]}
        objects[owner]["solids"].append(solid)
    return objects


def _color(label):
    return [0.3 + 0.4 * (step * label % 101) / 101 for step in (37, 53, 71)]


def fake(folder, version="5.0.1", content="BLENDER", **faults):
    """An address of a scene in ``folder``, opened by a program that speaks as Blender does.

    ``faults`` are those of :mod:`support.fake_blender`.
    """
    program = folder / "blender"
    script = HERE / "fake_blender.py"
    program.write_text(f'#!/bin/sh\nFAKE_BLENDER="$0" exec "{sys.executable}" -I "{script}" {version} "$@"\n')
    program.chmod(0o755)
    (folder / "room.blend").write_text(content)
    (folder / "room.blend.json").write_text(json.dumps(faults))
    return f"blender://{folder / 'room.blend'}?blender={program}"


def renders(folder):
    """What the program has rendered so far, in all its processes."""
    log = folder / "room.blend.log"
    return log.read_text().split() if os.path.exists(log) else []
