"""What every registered model promises, walked over the registry: no model escapes, nor do small images."""

import numpy as np
import pytest
from contract import CHECKS, check_docstring, check_points, check_round_trip
from examples import EXAMPLES

from omniscv import cameras
from omniscv.errors import ArgumentError

CASES = [
    pytest.param(name, parameters, id=f"{name}-{i}")
    for name, examples in EXAMPLES.items()
    for i, parameters in enumerate(examples)
]
every_example = pytest.mark.parametrize(("name", "parameters"), CASES)
every_model = pytest.mark.parametrize("name", cameras.names())


@every_model
def test_every_model_has_an_example(name):
    assert EXAMPLES.get(name), f"add one of {name} to tests/cameras/examples.py"


def test_every_example_has_a_model():
    assert set(EXAMPLES) <= set(cameras.names())


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__.removeprefix("check_"))
@every_example
def test_contract(name, parameters, check):
    check(cameras.create(name, **parameters))


@every_example
def test_examples_are_seen(name, parameters):
    """A contract over no pixel would prove nothing."""
    assert cameras.create(name, **parameters).valid().mean() > 0.2


@every_model
def test_docstring(name):
    check_docstring(cameras.model(name))


@pytest.mark.parametrize(("width", "height"), [(1, 1), (1, 50), (50, 1), (2, 2), (7, 5), (1001, 2), (2, 499)])
@every_example
def test_sizes(name, parameters, width, height):
    """The image's middle is on the lens axis in images of any size, and the rest of the contract holds."""
    camera = cameras.create(name, **{**without_center(parameters), "width": width, "height": height})
    np.testing.assert_array_equal(camera.center, (width / 2, height / 2))
    check_round_trip(camera)
    check_points(camera)


@pytest.mark.parametrize("place", [(-3.25, 20.0), (40.0, 47.5), (-60.0, 130.0), (0.0, 0.0)])
@every_model
def test_centers_off_the_image(name, place):
    """What the image still shows keeps the contract."""
    camera = centered_at(name, place)
    if camera is not None:
        check_round_trip(camera)
        check_points(camera)


@every_model
def test_centers_far_off_the_image(name):
    """An image circle a thousand kilometres away shows nothing; no model shows anything wrong."""
    camera = centered_at(name, (1e9, -1e9))
    if camera is not None:
        check_points(camera)
        if hasattr(camera, "focal") and name != "pinhole":
            assert not camera.valid().any()


def centered_at(name, place):
    """The first example with its centre there; None, and refused, where a model has no centre."""
    parameters = {**without_center(EXAMPLES[name][0]), "width": 61, "height": 45}
    keys = {"cx": place[0], "cy": place[1]} if name == "kannala-brandt" else {"center": place}
    if not cameras.model(name).has_center and name != "kannala-brandt":
        with pytest.raises(ArgumentError, match="unexpected keyword argument 'center'"):
            cameras.create(name, **parameters, **keys)
        return None
    camera = cameras.create(name, **parameters, **keys)
    np.testing.assert_array_equal(camera.center, place)
    return camera


def without_center(parameters):
    return {key: value for key, value in parameters.items() if key not in ("center", "cx", "cy")}


@every_model
def test_wrong_arguments_are_refused(name):
    """With a sentence that names the argument, what was expected and what came."""
    good = EXAMPLES[name][0]
    for key, value in (
        ("width", 0),
        ("width", 2.5),
        ("height", True),
        ("height", -3),
        ("width", "64"),
        ("center", (1.0,)),
        ("center", (np.nan, 0.0)),
    ):
        if key == "center" and not cameras.model(name).has_center:
            continue
        with pytest.raises(ArgumentError, match=rf"^{key}: expected .*got "):
            cameras.create(name, **{**good, key: value})
    with pytest.raises(ArgumentError, match="no_such_thing"):
        cameras.create(name, **good, no_such_thing=1)
    camera = cameras.create(name, **good)
    for pixels in (np.zeros(3), np.zeros((2, 1)), np.float64(1), [[True, False]], [["a", "b"]]):
        with pytest.raises(ArgumentError, match="pixels: expected"):
            camera.unproject(pixels)
    with pytest.raises(ArgumentError, match="points: expected"):
        camera.project(np.zeros(2))


@every_model
def test_numbers_that_are_none_are_refused(name):
    """NaN, infinity and text in any numeric parameter: the error begins with the parameter's name."""
    good = EXAMPLES[name][0]
    for key in cameras.create(name, **good).parameters():
        if key == "profile":
            continue
        for value in (np.nan, np.inf, "wide", [1.0, np.nan]):
            others = {k: v for k, v in good.items() if not (key == "focal" and k == "fov_deg")}
            with pytest.raises(ArgumentError, match=rf"^{key}"):
                cameras.create(name, **{**others, key: value})


def test_an_unknown_name_is_answered_with_the_known_ones():
    with pytest.raises(ArgumentError, match=r"expected one of equirectangular, .*pinhole; got 'fishy'"):
        cameras.create("fishy", width=1, height=1)
    with pytest.raises(ArgumentError, match="expected a mapping with 'model'"):
        cameras.from_dict({"width": 1, "height": 1})
