"""The recipe for a new model, at the top of ``omniscv/cameras/base.py``: walked from outside the package.

``support/thoby.py`` registers a lens that omniscv does not have; then the contract suite and the stability
picture must find it by themselves, in a process of their own, and hold for it.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import omniscv.cameras.base
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


def test_the_suites_find_an_outsiders_model():
    suites = ("test_contract.py",)
    paths = [str(ROOT / "tests" / "cameras" / suite) for suite in suites]
    out = run("-m", "pytest", "-q", "-p", "support.thoby", "-p", "no:cacheprovider", "-k", "thoby", *paths)
    passed = re.search(r"(\d+) passed, (?:\d+ skipped, )?\d+ deselected", out)
    assert passed, out
    assert int(passed[1]) >= 20  # every check, size and centre
    assert "failed" not in out


def test_an_outsiders_model_crosses_into_other_processes():
    """By its class, which the other process imports."""
    script = (
        "import pickle, sys; from omniscv import cameras; from support.thoby import Thoby\n"
        "camera = Thoby.example(64)\n"
        "assert cameras.names()[-1] == 'fisheye-thoby' and cameras.model('fisheye-thoby') is Thoby\n"
        "assert cameras.from_dict(camera.to_dict()) == camera\n"
        "assert cameras.create('fisheye-thoby', 64, 64, focal=25.6) == camera\n"
        "print(pickle.dumps(camera).hex())"
    )
    sent = run("-c", script).strip()
    run("-c", f"import pickle; print(pickle.loads(bytes.fromhex('{sent}')).valid().mean())")


def test_what_the_recipe_names_is_there():
    for path in re.findall(r"``([\w/-]+/[\w.-]+)``", RECIPE):
        assert (ROOT / path).is_file(), path
    for method in cameras.CentralCamera.__abstractmethods__ | cameras.Camera.__abstractmethods__:
        assert f"``{method}``" in RECIPE
    assert "``example``" in RECIPE


def test_classes_that_are_no_models_are_refused():
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


def test_importing_the_models_is_light():
    modules = run("-c", "import sys, omniscv.cameras; print(*sys.modules)").split()
    assert not {"scipy", "numba", "cv2", "matplotlib", "yaml"} & set(modules)


def test_an_error_in_a_constructor_is_not_taken_for_a_wrong_argument():
    script = (
        "from omniscv import cameras\n"
        "@cameras.register\n"
        "class Broken(cameras.Pinhole):\n"
        "    name = 'broken'\n"
        "    def __init__(self, width, height):\n"
        "        super().__init__(width, height)\n"
        "        len(5)\n"
        "try:\n"
        "    cameras.create('broken', 4, 4)\n"
        "except TypeError as error:\n"
        "    print(error)\n"
    )
    assert "object of type 'int' has no len()" in run("-c", script)
