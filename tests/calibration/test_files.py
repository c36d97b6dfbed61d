"""Loading and saving: formats are recognised by content, cameras are carried exactly or refused."""

from pathlib import Path

import numpy as np
import pytest
from support.calibration_files import LENS, MEI, PINHOLE, SAVED, SIZE, TEXTS
from support.same_rays import DIRECTION_TOLERANCE, assert_same_rays

from omniscv import calibration, cameras
from omniscv.errors import ArgumentError

NAMES = {"colmap": "1", "aria": "camera-slam-left"}
"""What a camera can be called in a format; in others cam0."""


def assert_clear(error: pytest.ExceptionInfo[ArgumentError]) -> None:
    """One line, short enough to read, that says what was expected."""
    message = str(error.value)
    assert "expected" in message or "missing key" in message
    assert "\n" not in message
    assert len(message) < 600


@pytest.mark.parametrize(("newline", "mark"), [("\n", ""), ("\r\n", "\ufeff")])
@pytest.mark.parametrize("format", SAVED)
def test_formats_are_recognised_by_content(format: str, newline: str, mark: str, tmp_path: Path) -> None:
    path = tmp_path / "whatever"
    path.write_bytes((mark + TEXTS[format].replace("\n", newline)).encode())
    read = calibration.load(path)
    assert list(read) == list(SAVED[format])
    for name, camera in SAVED[format].items():
        assert_same_rays(camera, read[name])


@pytest.mark.parametrize("text", ["", "hello", "{}", "camera_model: x\n#polynomial coefficients"])
def test_unrecognised_text_is_refused(text: str, tmp_path: Path) -> None:
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
        lambda: calibration.save(tmp_path, {"1": PINHOLE}, "colmap"),
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


def test_undistorted_unified_is_written_as_extended_unified() -> None:
    plain = cameras.create("unified", **SIZE, fx=30.0, fy=31.0, cx=19.0, cy=15.5, xi=1.2)
    read = calibration.loads(calibration.dumps({"1": plain}, "colmap"), "colmap")["1"]
    assert read.name == "extended-unified"
    assert_same_rays(plain, read)
    with pytest.raises(ArgumentError, match=r"1: COLMAP: .*got unified"):
        calibration.dumps({"1": MEI}, "colmap")


@pytest.mark.parametrize("format", calibration.formats())
def test_limits_skew_and_second_cameras_are_not_lost_silently(format: str, tmp_path: Path) -> None:
    name, camera = next(iter(SAVED[format].items()))
    wrong = []
    if format != "json":
        limited = cameras.from_dict({**camera.to_dict(), "fov_deg": 60.0})
        wrong.append(({name: limited}, "fov_deg: expected a camera without this limit"))
    if format in ("opencv", "kalibr", "colmap", "aria", "isaac"):
        size = {"width": camera.width, "height": camera.height, "fx": 20.0, "fy": 20.0, "skew": 0.01}
        skewed = cameras.create("pinhole", **size), cameras.create("kannala-brandt", **size)
        skewed += (cameras.create("extended-unified", **size, alpha=0.6, beta=1.1),)
        wrong += [({name: lens}, f"got {lens.name}") for lens in skewed]
    if format not in ("kalibr", "colmap", "aria", "isaac"):
        wrong.append(({"cam0": LENS, "cam1": LENS}, "holds one camera, got 2"))
    for lenses, message in wrong:
        with pytest.raises(ArgumentError, match=message):
            calibration.save(tmp_path / "file", lenses, format)
