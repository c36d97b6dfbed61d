"""The recipe for a new model, at the top of ``omniscv/cameras/base.py``, walked step by step.

A lens that the registry does not have (Thoby's fit to a real fisheye) is added as the recipe says, and
nothing more; then everything that works by name must work for it. A recipe that has gone stale fails here.
"""

import re
import runpy
from pathlib import Path

import numpy as np
import pytest
from contract import CHECKS, check_docstring
from examples import EXAMPLES

import omniscv.cameras.base
from omniscv import cameras
from omniscv.cameras.base import Camera, polar
from omniscv.demo import demo_cameras

ROOT = Path(__file__).parents[2]
RECIPE = omniscv.cameras.base.__doc__.split("To add a model")[1]


class Thoby(Camera):
    """A lens by two numbers: ``r = f k1 sin(k2 phi)``, phi from +z.

    Parameters: ``focal`` f in px; ``k1`` and ``k2``, without unit.
    Domain: phi <= pi / (2 k2), where the radius no longer grows; r <= f k1.
    Source: Thoby, on the AF DX 10.5 mm: k1 = 1.47, k2 = 0.713.
    """

    name = "fisheye-thoby"

    def __init__(self, width, height, focal, k1=1.47, k2=0.713, center=None):
        super().__init__(width, height, center)
        self.focal, self.k1, self.k2 = (
            self._number(key, value, above=0) for key, value in (("focal", focal), ("k1", k1), ("k2", k2))
        )

    def parameters(self):
        return {"focal": self.focal, "k1": self.k1, "k2": self.k2}

    def _unproject(self, pixels):
        r_px, cos_a, sin_a = polar(pixels, self.center)
        t = r_px / (self.focal * self.k1)
        phi = np.arcsin(np.minimum(t, 1)) / self.k2
        directions = np.stack([np.sin(phi) * cos_a, np.sin(phi) * sin_a, np.cos(phi)], axis=-1)
        return np.zeros_like(directions), directions, t <= 1

    def _project(self, points):
        across, cos_a, sin_a = polar(points[..., :2], np.zeros(2))
        turned = self.k2 * np.arctan2(across, points[..., 2])
        r_px = self.focal * self.k1 * np.sin(turned) * (1 - 1e-15)
        return self.center + np.stack([r_px * cos_a, r_px * sin_a], axis=-1), turned <= np.pi / 2


EXAMPLE = {"width": 61, "height": 61, "focal": 25.0}


@pytest.fixture
def listed(monkeypatch):
    """Step 2; the table by names follows from it, as a test below says."""
    monkeypatch.setattr(cameras, "_MODELS", (*cameras._MODELS, Thoby))
    monkeypatch.setattr(cameras, "_BY_NAME", {cls.name: cls for cls in cameras._MODELS})


@pytest.mark.usefixtures("listed")
def test_it_is_served_by_name():
    assert Thoby.name in cameras.names()
    assert cameras.model(Thoby.name) is Thoby
    assert type(cameras.create(Thoby.name, **EXAMPLE)) is Thoby


@pytest.mark.usefixtures("listed")
@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__.removeprefix("check_"))
def test_the_contract_holds(check):
    check(cameras.create(Thoby.name, **EXAMPLE))


def test_its_docstring_is_the_model():
    check_docstring(Thoby)


@pytest.mark.usefixtures("listed")
def test_without_an_example_it_is_noticed():
    assert set(cameras.names()) - set(EXAMPLES) == {Thoby.name}


def test_what_the_recipe_names_is_there():
    assert {cls.name: cls for cls in cameras._MODELS} == cameras._BY_NAME
    for path in re.findall(r"``([\w/-]+/[\w.-]+)``", RECIPE):
        assert (ROOT / path).is_file(), path
    for method in Camera.__abstractmethods__:
        assert f"``{method}``" in RECIPE


def test_every_place_that_lists_models_is_in_the_recipe():
    """And lists them all: the examples, the stability picture, the demo."""
    approaches = runpy.run_path(str(ROOT / "scripts" / "draw-stability"))["APPROACHES"]
    for path, names in (
        ("tests/cameras/examples.py", EXAMPLES),
        ("scripts/draw-stability", approaches),
        ("omniscv/demo.py", demo_cameras()),
    ):
        assert f"``{path}``" in RECIPE
        assert set(names) == set(cameras.names()), path
