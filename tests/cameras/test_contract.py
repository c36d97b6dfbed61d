"""What every registered model promises, checked for the whole registry; parameters that lenses refuse."""

import inspect
import re

import numpy as np
import pytest

from examples import changed, example_cameras, takes_center
from omniscv import cameras
from omniscv.cameras.radial import CircleCamera
from omniscv.errors import ArgumentError
from omniscv.testing.contracts import CHECKS, NUMERIC_CHECKS, check_points, check_round_trip

EXAMPLES = example_cameras()
PIXELS = np.stack(np.meshgrid([0.5, 20.5, 30.5, 44.5], [0.5, 22.5, 31.5]), axis=-1)
every_model = pytest.mark.parametrize("name", cameras.names())


def contract():
    """All checks of each model's own example; the numeric ones of cameras at the ends of parameters."""
    for name, camera in EXAMPLES.items():
        for check in CHECKS if name.endswith("-example") else NUMERIC_CHECKS:
            yield pytest.param(camera, check, id=f"{name}-{check.__name__.removeprefix('check_')}")


@pytest.mark.parametrize(("camera", "check"), [*contract()])
def test_contract(camera, check):
    check(camera)
    assert camera.valid().mean() > 0.2  # a contract of invalid pixels would prove nothing


@every_model
def test_example_shows_the_same_at_any_size(name):
    small = cameras.model(name).example(32)
    large = cameras.model(name).example(256)
    pixels = small.pixels()[small.valid()]
    if name != "lidar":  # whose first column fires at one angle, however many there are
        np.testing.assert_allclose(
            large.unproject(8 * pixels).directions, small.unproject(pixels).directions, rtol=0, atol=1e-12
        )
    for width in (1, 33):
        camera = cameras.model(name).example(width)
        assert (type(camera), camera.width) == (cameras.model(name), width)


@every_model
def test_classes_are_documented_and_exported(name):
    """Documented in about ten lines: a formula, every parameter with its unit, the domain, the source."""
    cls = cameras.model(name)
    text = inspect.getdoc(cls) or ""
    assert 3 <= len(text.splitlines()) <= 14
    own = [key for key in inspect.signature(cls).parameters if key not in ("width", "height", "center")]
    for word in (" = ", "Domain: ", "Source: ", *(f"``{key}``" for key in own), *["Parameter"] * bool(own)):
        assert word in text
    assert not own or any(unit in text for unit in (" px", "metres", "_deg``"))
    if cls.__module__.startswith("omniscv."):
        assert getattr(cameras, cls.__name__) is cls
        assert cls.__name__ in cameras.__all__


SIZES = [(1, 1), (1, 50), (7, 5), (301, 2), (2, 199)]


@pytest.mark.parametrize(("number", "name"), [*enumerate(cameras.names())])
def test_sizes(number, name):
    """In images of any size the lens axis is in the middle and the contract holds."""
    example = cameras.model(name).example(64)
    for width, height in (SIZES[number % 5], SIZES[(number + 2) % 5]):
        camera = changed(example, width=width, height=height, center=None)
        assert camera != example
        np.testing.assert_array_equal(camera.center, (width / 2, height / 2))
        check_round_trip(camera)
        check_points(camera)


@every_model
def test_centers(name):
    """Beside the image the contract holds for what is still visible; a million kilometres away nothing is."""
    example = cameras.model(name).example(61)
    if not takes_center(name):
        with pytest.raises(ArgumentError, match=rf"camera {name}: expected width, height.*; got 'center'"):
            cameras.from_dict({**example.to_dict(), "center": (1.0, 2.0)})
        return
    for center in ((-3.25, 20.0), (40.0, 47.5), (1e9, -1e9)):
        camera = changed(example, height=45, center=center)
        np.testing.assert_array_equal(camera.center, center)
        check_points(camera)
        if center[0] < 1e9:
            check_round_trip(camera)
        elif isinstance(camera, CircleCamera):
            assert not camera.valid().any()


@every_model
def test_wrong_arguments_are_refused(name):
    good = cameras.model(name).example(64).to_dict()
    wrong = [("width", value) for value in (0, 2.5, 10**7, "64")] + [("height", True), ("height", -3)]
    if takes_center(name) == ("center",):
        wrong += [("center", (1.0,)), ("center", (np.nan, 0.0))]
    for key, value in wrong:
        with pytest.raises(ArgumentError, match=rf"^{key}: expected .*got "):
            cameras.from_dict({**good, key: value})
    with pytest.raises(ArgumentError, match=r"size: expected at most 134217728 pixels"):
        cameras.from_dict({**good, "width": 10**6, "height": 10**6})
    with pytest.raises(ArgumentError, match="no_such_thing"):
        cameras.from_dict({**good, "no_such_thing": 1})
    parameters = inspect.signature(cameras.model(name)).parameters
    if "fov_deg" in parameters and "focal" in parameters and parameters["focal"].default is None:
        with pytest.raises(ArgumentError, match=r"^focal: expected .*got both \(50, 90\)"):
            cameras.from_dict({**good, "focal": 50, "fov_deg": 90})
    camera = cameras.from_dict(good)
    for pixels in (np.zeros(3), np.zeros((2, 1)), np.float64(1), [[True, False]], [["a", "b"]]):
        with pytest.raises(ArgumentError, match="pixels: expected"):
            camera.unproject(pixels)
    with pytest.raises(ArgumentError, match="points: expected"):
        camera.project(np.zeros(2))
    for key in camera.parameters():
        for value in (np.nan, np.inf, "wide", [1.0, np.nan]) if key != "profile" else ():
            with pytest.raises(ArgumentError, match=rf"^{key}"):
                cameras.from_dict({**good, key: value})


@every_model
def test_missing_parameters_are_listed(name):
    parameters = inspect.signature(cameras.model(name)).parameters
    sized = name == "lidar"  # whose table has the size
    wanted = "preset: expected" if sized else r"expected width, height.*; got no width, no height"
    with pytest.raises(ArgumentError, match="expected a mapping with 'model'"):
        cameras.from_dict({"width": 1, "height": 1})
    with pytest.raises(ArgumentError, match=wanted) as caught:
        cameras.from_dict({"model": name})
    assert sized or all(re.search(rf"\b{key}\b", str(caught.value)) for key in parameters)


def at_the_ends_of_floats(described):
    """Yield the description with each of its numbers, and with whole lists of numbers, huge and tiny."""
    for key, value in described.items():
        values = value if isinstance(value, list) else [value]
        if key in ("width", "height") or not isinstance(values[0], float):
            continue
        for end in (1e308, -1e308, 1e155, 5e-324):
            every = [[end] * len(values)]
            if end > 1e200:
                every += [[*values[:i], end, *values[i + 1 :]] for i in range(len(values))]
            yield from ({**described, key: ends if isinstance(value, list) else ends[0]} for ends in every)


@every_model
def test_numbers_at_the_ends_of_floats_are_computed_with_or_refused(name):
    """No error of NumPy or of Python, and no valid ray that is not finite."""
    for described in at_the_ends_of_floats(cameras.model(name).example(64).to_dict()):
        try:
            extreme = cameras.from_dict(described)
        except ArgumentError:
            continue
        rays = extreme.unproject(PIXELS)
        assert np.isfinite(rays.directions[rays.valid]).all()
        extreme.project(rays.directions[rays.valid])


def test_focal_lengths_as_text_and_as_numpy_scalars_are_numbers():
    """YAML 1.1 reads 1e2 as text."""
    expected = cameras.Pinhole(64, 48, focal=100.0)
    for focal in ("1e2", np.float32(100), np.int16(100), np.array(100.0), 100):
        assert cameras.create("pinhole", 64, 48, focal=focal) == expected
    for focal in (True, np.True_, [100.0], None.__class__, 10**400):
        with pytest.raises(ArgumentError, match="focal: expected a finite number > 0, got"):
            cameras.create("pinhole", 64, 48, focal=focal)


@pytest.mark.parametrize("name", ["catadioptric-parabolic", "noncentral-conical-mirror"])
def test_parameters_that_changed_places_are_given_by_name(name):
    """In 0.1.0 those of the mirror stood before the focal length."""
    model = cameras.model(name)
    with pytest.raises(TypeError, match="positional"):
        model(64, 64, 0.5)
    others = [*inspect.signature(model).parameters.values()][2:]
    assert all(each.kind is each.KEYWORD_ONLY for each in others)


@pytest.mark.parametrize("name", [name for name in cameras.names() if cameras.model(name).lens])
def test_the_numbers_of_a_lens_make_the_same_lens(name):
    """What a model declares for lens files are arguments of its constructor, in order and all of them."""
    lens = cameras.model(name).lens
    camera = cameras.model(name).example(64)
    limits = {key: value for key, value in camera.to_dict().items() if key in ("reference", "fov_deg")}
    numbers = lens.numbers(camera)
    assert tuple(numbers) == tuple(each for each in lens.names if each in numbers)
    limits = {} if "focal" in lens.arguments(numbers) else limits
    again = cameras.create(name, camera.width, camera.height, **lens.arguments(numbers), **limits)
    np.testing.assert_array_equal(again.unproject().directions, camera.unproject().directions)


SIZE = {"width": 64, "height": 48}


def test_one_focal_length_is_described_by_focal_and_center():
    described = {"model": "pinhole", **SIZE, "focal": 30.0, "center": [10.0, 40.0]}
    camera = cameras.from_dict(described)
    assert camera.to_dict() == described
    assert camera == cameras.create("pinhole", **SIZE, fx=30, fy=30, cx=10, cy=40, distortion=[0.0] * 5)
    assert (camera.fx, camera.fy, camera.cx, camera.cy, camera.skew) == (30, 30, 10, 40, 0)
    wide = cameras.create("pinhole", **SIZE, fov_deg=90)
    assert wide.to_dict() == {"model": "pinhole", **SIZE, "focal": wide.focal, "center": [32.0, 24.0]}
    assert wide.focal == pytest.approx(32, rel=1e-15)

    limited = cameras.create("pinhole", **SIZE, fx=30.0, fy=30.0, fov_deg=60)  # ends at tan(30 degrees) f
    r = 30 * np.tan(np.radians(30))
    np.testing.assert_array_equal(limited.valid([(32 + r - 1e-9, 24), (32 + r + 1e-9, 24)]), [True, False])


FOCALS = {"fx": 30.0, "fy": 30.0}
REFUSED = [
    ("pinhole", {"focal": 30, "fov_deg": 60}, "focal: expected focal or fov_deg, got both"),
    ("pinhole", {"focal": 30, **FOCALS}, "focal: expected focal, or fx and fy, got focal = 30, fx = 30"),
    ("pinhole", {"fx": 30}, "focal: expected focal, or fx and fy, got fx = 30"),
    ("pinhole", {"center": (1, 2), "cx": 1}, "center: expected it or cx and cy, got both"),
    ("pinhole", {"distortion": [0.1] * 14}, "distortion: expected 4, 5, 8 or 12 numbers .*got 14"),
    ("pinhole", {"distortion": 0.1}, "distortion: expected finite numbers"),
    ("pinhole", {"width": 10**400}, "width: expected a whole number of pixels <= 1000000"),
    ("pinhole", {"fx": 0, "fy": 1}, "fx: expected a finite number > 0, got 0"),
    ("ftheta", {"polynomial": [0.1, 30]}, r"polynomial: expected \(0, c1, c2, ...\) with c1 > 0; got"),
    ("ftheta", {"polynomial": [0, 30], "linear": (0.2, 0.2, 1)}, "linear: expected c - d e further from 0"),
    ("ftheta", {"polynomial": [0, 30], "max_angle_deg": 181}, "max_angle_deg: expected .* <= 180, got 181"),
    ("ftheta", {"polynomial": [0, 30], "reference": "up"}, "reference: expected one of angle-to-pixel"),
    ("double-sphere", {**FOCALS, "xi": 0, "alpha": 1.1}, "alpha: expected .* >= 0 and <= 1, got 1.1"),
    ("extended-unified", {**FOCALS, "alpha": 0.5, "beta": 0}, "beta: expected a finite number > 0, got 0"),
    ("unified", {**FOCALS, "xi": -1}, "xi: expected a finite number > -1, got -1"),
    ("unified", {**FOCALS, "xi": 1, "distortion": (1, 2)}, "distortion: expected 4 finite numbers"),
    ("fisheye624", {**FOCALS, "k": (1, 2, 3, 4)}, "k: expected 6 finite numbers"),
    ("division", {"focal": 30, "k": "much"}, "k: expected a finite number, got 'much'"),
    ("scaramuzza", {"coefficients": (0.0, 0, 1e-3)}, r"coefficients\[0\]: expected a finite number < 0"),
    ("scaramuzza", {"coefficients": [-1.0] * 100_000}, "coefficients: expected at most 64 numbers, got 1000"),
    ("fishy", {}, "camera: expected one of equirectangular, .*pinhole; got 'fishy'"),
]


@pytest.mark.parametrize(("name", "arguments", "message"), REFUSED)
def test_parameters_outside_their_domain_are_refused(name, arguments, message):
    with pytest.raises(ArgumentError, match=f"^{message}"):
        cameras.create(name, **SIZE | arguments)
