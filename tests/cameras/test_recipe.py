"""The recipe for a new model, at the top of ``omniscv/cameras/base.py``, and what is no model."""

import re
from pathlib import Path

import pytest

import omniscv.cameras.base
import omniscv.cameras.registry
from omniscv import cameras
from omniscv.errors import ArgumentError

ROOT = Path(__file__).parents[2]
RECIPE = omniscv.cameras.base.__doc__.split("To add a model")[1]


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
        (Twin, "Twin.name: expected a name that no other model has, got 'pinhole' of omniscv.cameras."),
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
