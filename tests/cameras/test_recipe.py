"""The recipe for a new model, at the top of ``omniscv/cameras/base.py``: walked from outside the package.

``support/thoby.py`` registers a lens that omniscv does not have; in another process the contract suite and
the stability chart must find it by themselves, and hold for it.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import omniscv.cameras.base
import omniscv.cameras.registry
from omniscv import cameras
from omniscv.errors import ArgumentError

ROOT = Path(__file__).parents[2]
RECIPE = omniscv.cameras.base.__doc__.split("To add a model")[1]


def run(*arguments, code=0):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests")])}
    done = subprocess.run(
        [sys.executable, *arguments], cwd=ROOT, env=environment, capture_output=True, text=True, timeout=200
    )
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout


def test_models_of_other_packages_keep_the_contract():
    """By the contract suite's examples and the stability chart; its pickles name its class.

    Importing the models loads no slow library.
    """
    script = (
        "import pickle, sys, omniscv.cameras\n"
        "assert not {'scipy', 'numba', 'cv2', 'matplotlib', 'yaml'} & set(sys.modules)\n"
        "from support.thoby import Thoby\n"
        "from omniscv.testing.cameras import CHECKS, check_docstring\n"
        "from cameras.examples import example_cameras\n"
        "from omniscv import cameras\n"
        "from omniscv.chart.limits import approaches\n"
        "camera = Thoby.example(64)\n"
        "assert cameras.names()[-1] == 'fisheye-thoby' and cameras.model('fisheye-thoby') is Thoby\n"
        "assert cameras.from_dict(camera.to_dict()) == camera\n"
        "assert cameras.create('fisheye-thoby', 64, 64, focal=25.6) == camera\n"
        "assert 'fisheye-thoby-example' in example_cameras()\n"
        "for check in CHECKS: check(camera)\n"
        "check_docstring(Thoby)\n"
        "assert all(way.error_px(0.1) < 1e-6 for way in approaches('fisheye-thoby'))\n"
        "assert b'thoby' in pickle.dumps(camera)\n"
    )
    run("-c", script)


def test_the_recipe_names_files_and_methods_that_exist():
    for path in re.findall(r"``([\w/-]+/[\w.-]+)``", RECIPE):
        assert (ROOT / path).is_file(), path
    for method in cameras.CentralCamera.__abstractmethods__ | cameras.Camera.__abstractmethods__:
        assert f"``{method}``" in RECIPE
    assert "``example``" in RECIPE


def test_other_classes_are_refused():
    class Nameless(cameras.Pinhole):
        name = ""

    class Twin(cameras.Pinhole):
        pass

    class Half(cameras.CentralCamera):
        name = "half"

    for cls, message in (
        (Nameless, "Nameless.name: expected the model's name, got ''"),
        (
            Twin,
            "Twin.name: expected a name that no other model has, got 'pinhole' of omniscv.cameras.pinhole",
        ),
        (Half, "Half: expected a class that implements _directions, _project"),
        (Path, "camera model: expected a subclass of omniscv.cameras.Camera, got <class 'pathlib.Path'>"),
        ("pinhole", "camera model: expected a subclass of omniscv.cameras.Camera, got 'pinhole'"),
    ):
        with pytest.raises(ArgumentError, match=f"^{re.escape(message)}"):
            cameras.register(cls)
    assert cameras.register(cameras.Pinhole) is cameras.Pinhole


def test_an_error_in_a_constructor_is_not_taken_for_a_wrong_argument(monkeypatch):
    class Broken(cameras.Pinhole):
        name = "broken"

        def __init__(self, width, height):
            super().__init__(width, height)
            len(5)

    monkeypatch.setitem(omniscv.cameras.registry._MODELS, "broken", Broken)
    with pytest.raises(TypeError, match=r"object of type 'int' has no len\(\)"):
        cameras.create("broken", 4, 4)
