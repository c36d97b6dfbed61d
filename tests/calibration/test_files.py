"""Loading and saving: formats told by content, cameras refused, and files that somebody broke."""

from pathlib import Path

import numpy as np
import pytest
from support.same_rays import DIRECTION_TOLERANCE, assert_same_rays

from omniscv import calibration, cameras
from omniscv.errors import ArgumentError

SIZE = {"width": 40, "height": 30}
LENS = cameras.create(
    "kannala-brandt", **SIZE, fx=15.0, fy=15.5, cx=20.25, cy=14.0, k=[0.1, -0.02, 0.0, 1e-5]
)
BENT = cameras.create("scaramuzza", **SIZE, coefficients=[-15.0, 0.0, 0.01], affine=(1.01, 0.001, -0.002))
PINHOLE = cameras.create("pinhole", **SIZE, focal=25.0, center=(19, 16))
SPHERE = cameras.create("equirectangular", **SIZE)
MIRROR = cameras.create("catadioptric-parabolic", **SIZE, semi_latus_rectum=0.1, focal=200.0)

DISTORTED = cameras.create(
    "pinhole", **SIZE, fx=25.0, fy=26.0, cx=19.5, cy=15.0, distortion=(-0.2, 0.03, 1e-3, -2e-3, 0.01)
)
MEI = cameras.create("unified", **SIZE, fx=20.0, fy=21.0, xi=1.1, distortion=(0.01, 0, 1e-3, 0), skew=0.01)
DOUBLE = cameras.create("double-sphere", **SIZE, fx=15.0, fy=16.0, xi=-0.2, alpha=0.6)
ELLIPSOID = cameras.create("extended-unified", **SIZE, fx=15.0, fy=16.0, alpha=0.6, beta=1.1)
ARIA = cameras.create(
    "fisheye624", width=640, height=480, fx=240.0, fy=240.0, k=(0.01, -2e-3, 0, 0, 0, 0), p=(1e-4, 2e-4)
)
THETA = cameras.create(
    "ftheta", **SIZE, polynomial=(0, 0.05, 0, 1e-6, 0), reference="pixel-to-angle", max_angle_deg=95
)

SAVED = {
    "json": {"cam0": MIRROR},
    "opencv": {"cam0": DISTORTED},
    "opencv-fisheye": {"cam0": LENS},
    "opencv-omnidir": {"cam0": MEI},
    "kalibr": {"cam0": LENS, "cam1": PINHOLE, "cam2": MIRROR, "cam3": DOUBLE, "cam4": ELLIPSOID},
    "colmap": {"1": LENS, "5": PINHOLE, "6": SPHERE, "7": DISTORTED, "8": ELLIPSOID},
    "ocamcalib": {"cam0": BENT},
    "aria": {"camera-slam-left": ARIA},
    "isaac": {"front": LENS, "rear": PINHOLE, "roof": THETA},
    "ncore": {"cam0": THETA},
}
NAMES = {"colmap": "1", "aria": "camera-slam-left"}
"""What a camera can be called in a format; in others cam0."""


def text_of(format: str, folder: Path) -> str:
    path = folder / "saved"
    calibration.save(path, SAVED[format], format)
    return path.read_text(encoding="utf-8")


@pytest.fixture(scope="module", params=calibration.formats())
def saved(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    """A format, and a file of it."""
    return request.param, text_of(request.param, tmp_path_factory.mktemp("saved"))


def assert_clear(error: pytest.ExceptionInfo[ArgumentError]) -> None:
    """One line, short enough to read, that says what was expected."""
    message = str(error.value)
    assert "expected" in message or "missing key" in message
    assert "\n" not in message
    assert len(message) < 600


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_the_format_is_told_by_the_content(
    saved: tuple[str, str], newline: str, mark: str, tmp_path: Path
) -> None:
    format, text = saved
    path = tmp_path / "whatever"
    path.write_bytes((mark + text.replace("\n", newline)).encode())
    read = calibration.load(path)
    assert list(read) == list(SAVED[format])
    for name, camera in SAVED[format].items():
        assert_same_rays(camera, read[name])


@pytest.mark.parametrize("text", ["", "hello", "{}", "camera_model: x\n#polynomial coefficients"])
def test_what_looks_like_no_format_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ArgumentError, match="give format") as error:
        calibration.load(path)
    assert_clear(error)
    assert str(path) in str(error.value)


def test_a_file_that_cannot_be_read_or_written_is_refused(tmp_path: Path) -> None:
    for call in (
        lambda: calibration.load(tmp_path / "missing"),
        lambda: calibration.load(tmp_path),
        lambda: calibration.save(tmp_path / "missing" / "file", {"1": PINHOLE}, "colmap"),
    ):
        with pytest.raises(ArgumentError) as error:
            call()
        assert_clear(error)
    path = tmp_path / "binary"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ArgumentError, match="text file"):
        calibration.load(path)


def test_unknown_formats_and_no_cameras_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match="format: expected one of json, opencv, opencv-fisheye"):
        calibration.save(tmp_path / "file", {"cam0": LENS}, "ros")
    with pytest.raises(ArgumentError, match="cameras: expected at least one"):
        calibration.save(tmp_path / "file", {}, "kalibr")
    assert not (tmp_path / "file").exists()


LENSES = {"pinhole", "kannala-brandt"}
CARRIED = {
    "json": set(cameras.names()),
    "opencv": {"pinhole"},
    "opencv-fisheye": {"kannala-brandt"},
    "opencv-omnidir": {"unified"},
    "kalibr": {
        *LENSES,
        "unified",
        "extended-unified",
        "double-sphere",
        "catadioptric-parabolic",
        "catadioptric-hyperbolic",
        "catadioptric-planar",
    },
    "colmap": {*LENSES, "extended-unified", "fisheye624", "division", "equirectangular"},
    "ocamcalib": {"scaramuzza"},
    "aria": {"kannala-brandt", "fisheye624"},
    "isaac": {*LENSES},
    "ncore": {"ftheta"},
}
AS_ANOTHER = {
    "opencv-fisheye": {"fisheye-equidistant": "kannala-brandt"},
    "opencv-omnidir": {"fisheye-stereographic": "unified"},
    "kalibr": {"fisheye-equidistant": "kannala-brandt", "fisheye-stereographic": "unified"},
    "colmap": {"fisheye-equidistant": "kannala-brandt", "fisheye-stereographic": "extended-unified"},
    "aria": {"fisheye-equidistant": "kannala-brandt"},
    "isaac": {"fisheye-equidistant": "kannala-brandt"},
}
"""Special cases of other models, as which they come back, without the circle in which they end."""


def typical(model: str, format: str) -> cameras.Camera:
    """A camera of a model without a limit, of the size that the format wants."""
    size = {"width": 640, "height": 480} if format == "aria" else SIZE
    data = {**cameras.model(model).example(40).to_dict(), **size}
    if model == "unified" and format == "colmap":
        data["distortion"] = [0.0, 0.0, 0.0, 0.0]
    middle = {
        "cx": size["width"] / 2,
        "cy": size["height"] / 2,
        "center": [size["width"] / 2, size["height"] / 2],
    }
    data |= {key: value for key, value in middle.items() if key in data}
    return cameras.from_dict({key: value for key, value in data.items() if key != "fov_deg"})


@pytest.mark.parametrize("format", calibration.formats())
@pytest.mark.parametrize("model", cameras.names())
def test_every_model_is_carried_exactly_or_refused(model: str, format: str, tmp_path: Path) -> None:
    """Walks the registry: a model added later must say where it goes."""
    camera, name, path = typical(model, format), NAMES.get(format, "cam0"), tmp_path / "file"
    other = AS_ANOTHER.get(format, {}).get(model)
    if model in CARRIED[format] or other:
        calibration.save(path, {name: camera}, format)
        again = calibration.load(path)[name]
        assert again.name == (other or model)
        if other is None:
            assert_same_rays(camera, again)
        valid = camera.valid()
        assert again.valid()[valid].all()
        apart = camera.unproject().directions[valid] - again.unproject().directions[valid]
        assert np.abs(apart).max() < DIRECTION_TOLERANCE
    elif not (format == "colmap" and model == "unified"):
        with pytest.raises(ArgumentError, match=f"{name}: .*got .*{model}") as error:
            calibration.save(path, {name: camera}, format)
        assert_clear(error)
        assert not path.exists()


def test_an_undistorted_sphere_model_goes_as_the_extended_one() -> None:
    plain = cameras.create("unified", **SIZE, fx=30.0, fy=31.0, cx=19.0, cy=15.5, xi=1.2)
    read = calibration.read_colmap(calibration.write_colmap({"1": plain}))["1"]
    assert read.name == "extended-unified"
    assert_same_rays(plain, read)
    with pytest.raises(ArgumentError, match=r"1: COLMAP: .*got unified"):
        calibration.write_colmap({"1": MEI})


SKEWED = {"pinhole": {}, "kannala-brandt": {}, "extended-unified": {"alpha": 0.6, "beta": 1.1}}


@pytest.mark.parametrize("format", ["opencv", "kalibr", "colmap", "aria", "isaac"])
@pytest.mark.parametrize("model", SKEWED)
def test_skew_is_not_lost_silently(model: str, format: str) -> None:
    size = {"width": 640, "height": 480} if format == "aria" else SIZE
    camera = cameras.create(model, **size, fx=20.0, fy=20.0, skew=0.01, **SKEWED[model])
    write = getattr(calibration, f"write_{format}")
    with pytest.raises(ArgumentError, match=f"got {model}"):
        write({NAMES.get(format, "cam0"): camera})


@pytest.mark.parametrize("format", calibration.formats()[1:])
def test_a_limit_of_the_field_of_view_is_not_lost_silently(format: str, tmp_path: Path) -> None:
    name, camera = next(iter(SAVED[format].items()))
    limited = cameras.from_dict({**camera.to_dict(), "fov_deg": 60.0})
    with pytest.raises(ArgumentError, match="fov_deg: expected a camera without this limit"):
        calibration.save(tmp_path / "file", {name: limited}, format)


@pytest.mark.parametrize(
    "format", ["json", "opencv", "opencv-fisheye", "opencv-omnidir", "ocamcalib", "ncore"]
)
def test_formats_of_one_camera_refuse_two(format: str, tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match="holds one camera, got 2"):
        calibration.save(tmp_path / "file", {"cam0": LENS, "cam1": LENS}, format)


# A few bytes that stand for 10^9 values, nesting beyond Python's stack, a number beyond its digits, ...
BOMB = "a0: &a0 [1, 1]\n" + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 10))
ENTRY = (
    "{{camera_model: pinhole, distortion_model: none, distortion_coeffs: [], resolution: {}, intrinsics: {}}}"
)


@pytest.mark.parametrize(
    "text",
    [
        BOMB + "cam0: " + ENTRY.format("[4, 3]", "*a9"),
        BOMB + "cam0: *a9",
        "[" * 100_000,
        "cam0: " + ENTRY.format("[4, 3]", "[" + "9" * 5000 + ", 1, 1, 1]"),
        "cam0: " + ENTRY.format("[4, 3]", "[.nan, 1, 1, 1]"),
        "cam0: " + ENTRY.format("[4, 3]", "[true, 1, 1, 1]"),
        "cam0: " + ENTRY.format("[4, 3]", "[[1], [2], 1, 1]"),
        "cam0: " + ENTRY.format("[4, 3]", "[2026-01-01, 1, 1, 1]"),
        "cam0: " + ENTRY.format("[4, 3]", "null"),
        "cam0: " + ENTRY.format("[4, 3.5]", "[1, 1, 1, 1]"),
        "cam0: " + ENTRY.format("[0, 3]", "[1, 1, 1, 1]"),
        "cam0: " + ENTRY.format("[4]", "[1, 1, 1, 1]"),
        "cam0: {camera_model: [pinhole], distortion_model: {none: none}}",
        "cam0: pinhole",
        "- cam0",
        "cam0: !!python/object/apply:os.system [exit]",
    ],
)
def test_hostile_yaml_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(ArgumentError) as error:
        calibration.read_kalibr(text)
    assert_clear(error)
    with pytest.raises(ArgumentError) as error:
        calibration.read_opencv_fisheye(text)
    assert_clear(error)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("image_width: 40", "image_length: 40", "missing key 'image_width'"),
        ("camera_matrix: !!opencv-matrix", "camera_matrix: 3 #", "expected YAML"),
        ("[ 15.,", "[ .Nan,", "camera_matrix: data: expected 9 finite"),
        ("[ 15.,", "[ -15.,", "fx: expected a finite number > 0"),
        ("e-05 ]", "e-05, 0.1 ]", "distortion_coefficients: data: expected 4 finite"),
    ],
)
def test_a_bad_opencv_file_is_refused(old: str, new: str, message: str, tmp_path: Path) -> None:
    text = text_of("opencv-fisheye", tmp_path)
    assert old in text
    with pytest.raises(ArgumentError, match=message) as error:
        calibration.read_opencv_fisheye(text.replace(old, new))
    assert_clear(error)


@pytest.mark.parametrize("key", ["model", "camera_model", "distortion_model"])
def test_a_word_for_the_lens_in_a_file_of_opencv(key, tmp_path):
    """Other formats have these keys, too, but not the first line and the tags that OpenCV writes."""
    text = text_of("opencv-fisheye", tmp_path).replace("fisheye_model: 1", f"{key}: fisheye")
    assert key in text
    (tmp_path / "lens.yml").write_text(text)
    assert_same_rays(calibration.load(tmp_path / "lens.yml")["cam0"], LENS)
