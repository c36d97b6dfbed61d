"""What every registered model promises, walked over the registry: no model escapes, nor do small images."""

import inspect
import multiprocessing
import pickle
import re

import numpy as np
import pytest

from examples import changed, example_cameras, takes_center
from omniscv import cameras
from omniscv.cameras.radial import CircleCamera
from omniscv.errors import ArgumentError
from omniscv.testing.cameras import CHECKS, NUMERIC_CHECKS, check_docstring, check_points, check_round_trip

EXAMPLES = example_cameras()
every_example = pytest.mark.parametrize("camera", EXAMPLES.values(), ids=EXAMPLES)
PIXELS = np.stack(np.meshgrid([0.5, 20.5, 30.5, 44.5], [0.5, 22.5, 31.5]), axis=-1)
every_model = pytest.mark.parametrize("name", cameras.names())


def contract():
    """All checks of each model's own example; of cameras at the ends of parameters those of their numbers."""
    for name, camera in EXAMPLES.items():
        for check in CHECKS if name.endswith("-example") else NUMERIC_CHECKS:
            yield pytest.param(camera, check, id=f"{name}-{check.__name__.removeprefix('check_')}")


@pytest.mark.parametrize(("camera", "check"), [*contract()])
def test_contract(camera, check):
    check(camera)


@every_example
def test_examples_are_seen(camera):
    """A contract over no pixel would prove nothing."""
    assert camera.valid().mean() > 0.2


@every_model
@pytest.mark.parametrize("width", [1, 33])
def test_the_example_is_as_wide_as_asked_for(name, width):
    camera = cameras.model(name).example(width)
    assert type(camera) is cameras.model(name)
    assert camera.width == width


@every_model
def test_the_example_shows_the_same_at_any_size(name):
    """Its rays at parts of the image do not depend on the size."""
    small, large = cameras.model(name).example(64), cameras.model(name).example(512)
    pixels = small.pixels()[small.valid()]
    np.testing.assert_allclose(
        large.unproject(8 * pixels).directions, small.unproject(pixels).directions, rtol=0, atol=1e-12
    )


@every_model
def test_docstring(name):
    check_docstring(cameras.model(name))


@every_model
def test_classes_are_exported(name):
    cls = cameras.model(name)
    if cls.__module__.startswith("omniscv."):
        assert getattr(cameras, cls.__name__) is cls
        assert cls.__name__ in cameras.__all__


SIZES = [(1, 1), (1, 50), (7, 5), (301, 2), (2, 199)]


@pytest.mark.parametrize(("number", "name"), [*enumerate(cameras.names())])
def test_sizes(number, name):
    """The image's middle is on the lens axis in images of any size, and the rest of the contract holds."""
    for width, height in (SIZES[number % 5], SIZES[(number + 2) % 5]):
        camera = changed(cameras.model(name).example(64), width=width, height=height, center=None)
        np.testing.assert_array_equal(camera.center, (width / 2, height / 2))
        check_round_trip(camera)
        check_points(camera)


@pytest.mark.parametrize("place", [(-3.25, 20.0), (40.0, 47.5)])
@every_model
def test_centers_off_the_image(name, place):
    """What the image still shows keeps the contract."""
    if takes_center(name):
        camera = centered_at(name, place)
        check_round_trip(camera)
        check_points(camera)


@every_model
def test_centers_far_off_the_image(name):
    """An image circle a thousand kilometres away shows nothing; no model shows anything wrong."""
    if takes_center(name):
        camera = centered_at(name, (1e9, -1e9))
        check_points(camera)
        if isinstance(camera, CircleCamera):
            assert not camera.valid().any()


@every_model
def test_a_center_that_the_model_does_not_take_is_refused(name):
    if not takes_center(name):
        with pytest.raises(ArgumentError, match=rf"camera {name}: expected width, height.*; got 'center'"):
            cameras.from_dict({**cameras.model(name).example(64).to_dict(), "center": (1.0, 2.0)})


def centered_at(name, place):
    camera = changed(cameras.model(name).example(61), height=45, center=place)
    np.testing.assert_array_equal(camera.center, place)
    return camera


@every_model
def test_cameras_of_equal_numbers_are_one_key(name):
    """However they were made, and after pickling; of other numbers, another one."""
    camera, again = cameras.model(name).example(64), cameras.model(name).example(64)
    restored = pickle.loads(pickle.dumps(camera))  # noqa: S301 - our own bytes
    other = changed(camera, height=camera.height + 1)
    assert {camera: 1, again: 2, restored: 3} == {camera: 3}
    assert camera != other
    assert len({camera, other}) == 2
    assert camera != camera.to_dict()


def test_cameras_cross_into_spawned_processes():
    """A child that imports everything anew gets equal cameras, and sends equal ones back."""
    sent = [cameras.model(name).example(64) for name in cameras.names() if "thoby" not in name]
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        received = pool.map(cameras.from_dict, [camera.to_dict() for camera in sent])
        assert received == sent
        assert pool.map(type(sent[0]).to_dict, sent[:1]) == [sent[0].to_dict()]
    assert [hash(camera) for camera in received] == [hash(camera) for camera in sent]


@every_model
def test_wrong_arguments_are_refused(name):
    """With a sentence that names the argument, what was expected and what came."""
    good = cameras.model(name).example(64).to_dict()
    for key, value in (
        ("width", 0),
        ("width", 2.5),
        ("height", True),
        ("height", -3),
        ("width", 10**7),
        ("width", "64"),
        ("center", (1.0,)),
        ("center", (np.nan, 0.0)),
    ):
        if key == "center" and takes_center(name) != ("center",):
            continue
        with pytest.raises(ArgumentError, match=rf"^{key}: expected .*got "):
            cameras.from_dict({**good, key: value})
    with pytest.raises(ArgumentError, match="no_such_thing"):
        cameras.from_dict({**good, "no_such_thing": 1})
    camera = cameras.from_dict(good)
    for pixels in (np.zeros(3), np.zeros((2, 1)), np.float64(1), [[True, False]], [["a", "b"]]):
        with pytest.raises(ArgumentError, match="pixels: expected"):
            camera.unproject(pixels)
    with pytest.raises(ArgumentError, match="points: expected"):
        camera.project(np.zeros(2))


@every_model
def test_numbers_that_are_none_are_refused(name):
    """NaN, infinity and text in any numeric parameter: the error begins with the parameter's name."""
    good = cameras.model(name).example(64).to_dict()
    for key in cameras.from_dict(good).parameters():
        if key == "profile":
            continue
        for value in (np.nan, np.inf, "wide", [1.0, np.nan]):
            with pytest.raises(ArgumentError, match=rf"^{key}"):
                cameras.from_dict({**good, key: value})


def at_the_ends_of_floats(described):
    """The description with each of its numbers, and with whole lists of numbers, huge and tiny."""
    for key, value in described.items():
        is_list = isinstance(value, list)
        if key in ("width", "height") or not isinstance(value[0] if is_list else value, float):
            continue
        for end in (1e308, -1e308, 1e155, 5e-324):
            if is_list:
                yield from ({**described, key: [*value[:i], end, *value[i + 1 :]]} for i in range(len(value)))
            yield {**described, key: [end] * len(value) if is_list else end}


@every_example
def test_numbers_at_the_ends_of_floats_are_computed_with_or_refused(camera):
    """No error of NumPy or of Python, and no valid ray that is none."""
    for described in at_the_ends_of_floats(camera.to_dict()):
        try:
            extreme = cameras.from_dict(described)
        except ArgumentError:
            continue
        rays = extreme.unproject(PIXELS)
        assert np.isfinite(rays.directions[rays.valid]).all()
        extreme.project(rays.directions[rays.valid])


def test_an_unknown_name_is_answered_with_the_known_ones():
    with pytest.raises(ArgumentError, match=r"expected one of equirectangular, .*pinhole; got 'fishy'"):
        cameras.create("fishy", width=1, height=1)
    with pytest.raises(ArgumentError, match="expected a mapping with 'model'"):
        cameras.from_dict({"width": 1, "height": 1})


@every_model
def test_a_missing_parameter_is_answered_with_all_of_them(name):
    parameters = inspect.signature(cameras.model(name)).parameters
    with pytest.raises(ArgumentError, match=r"expected width, height.*; got no width, no height") as caught:
        cameras.from_dict({"model": name})
    assert all(re.search(rf"\b{key}\b", str(caught.value)) for key in parameters)


def test_focal_lengths_given_as_text_and_as_numpy_scalars_are_numbers():
    """YAML 1.1 reads 1e2 as text."""
    expected = cameras.Pinhole(64, 48, focal=100.0)
    for focal in ("1e2", np.float32(100), np.int16(100), np.array(100.0), 100):
        assert cameras.create("pinhole", 64, 48, focal=focal) == expected
    for focal in (True, np.True_, [100.0], None.__class__, 10**400):
        with pytest.raises(ArgumentError, match="focal: expected a finite number > 0, got"):
            cameras.create("pinhole", 64, 48, focal=focal)


def test_nested_lists_are_refused_before_they_are_read():
    """A few bytes of YAML aliases can stand for a list of 10^30 numbers."""
    nested = [1.0]
    for _ in range(100):
        nested = [nested] * 10
    for key, name in (("center", "pinhole"), ("coefficients", "scaramuzza"), ("k", "kannala-brandt")):
        with pytest.raises(ArgumentError, match=f"^{key}: expected"):
            cameras.from_dict({**cameras.model(name).example(8).to_dict(), key: nested})


def test_images_and_polynomials_that_would_take_all_memory_are_refused():
    for name in cameras.names():
        described = cameras.model(name).example(64).to_dict()
        with pytest.raises(ArgumentError, match=r"size: expected at most 134217728 pixels"):
            cameras.from_dict({**described, "width": 10**6, "height": 10**6})
    with pytest.raises(ArgumentError, match=r"coefficients: expected at most 64 numbers, got 100000"):
        cameras.create("scaramuzza", 64, 64, coefficients=[-1.0] * 100_000)
