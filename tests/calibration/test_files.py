"""Loading and saving: formats are recognised by content, cameras are carried exactly or refused."""

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from support.calibration_files import LENS, PINHOLE, SAVED, SIZE
from support.same_rays import DIRECTION_TOLERANCE, assert_same_rays

from omniscv import calibration, cameras
from omniscv.calibration.files import FORMS
from omniscv.errors import ArgumentError

WRITTEN = [name for name, form in FORMS.items() if form.written]


def named(format: str) -> str:
    return "camera-slam-left" if format == "aria" else FORMS[format].writing.name_of("cam0")


def assert_clear(error: pytest.ExceptionInfo[ArgumentError]) -> None:
    """One line, short enough to read, that says what was expected."""
    message = str(error.value)
    assert "expected" in message or "missing key" in message
    assert "\n" not in message
    assert len(message) < 600


def test_a_file_that_cannot_be_read_or_written_or_recognised_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "file"
    for text in ("", "hello", "{}", "camera_model: x"):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(ArgumentError, match=r"give format|none of their keys") as error:
            calibration.load(path)
        assert_clear(error)
        assert str(path) in str(error.value)
    for call in (
        lambda: calibration.load(tmp_path / "missing"),
        lambda: calibration.load(tmp_path),
        lambda: calibration.save(tmp_path, {"1": PINHOLE}, "colmap"),
    ):
        with pytest.raises(ArgumentError) as error:
            call()
        assert_clear(error)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ArgumentError, match="text file"):
        calibration.load(path)
    path.unlink()
    with pytest.raises(ArgumentError, match="format: expected one of json, camodocal"):
        calibration.save(path, {"cam0": LENS}, "rso")
    with pytest.raises(ArgumentError, match="cameras: expected at least one"):
        calibration.save(path, {}, "kalibr")
    for format in set(FORMS) - set(WRITTEN):
        with pytest.raises(ArgumentError, match=f"expected one that is written; {format} is only read"):
            calibration.dumps({"cam0": LENS}, format)
    assert not path.exists()


AS_ANOTHER = {
    "fisheye-equidistant": {"kannala-brandt"},
    "fisheye-stereographic": {"unified", "extended-unified"},
    "unified": {"extended-unified"},  # without distortion
}
"""Special cases of other models, as which they come back, without the circle in which they end."""

MIDDLE = {**SIZE, "cx": 19.25, "cy": 15.5}
TRAVELLERS = [
    cameras.create("pinhole", **MIDDLE, fx=31.5, fy=30.25),
    cameras.create("pinhole", **MIDDLE, fx=31.0, fy=31.0, distortion=(-0.1, 0.02, 1e-3, -2e-3, 0.003)),
    cameras.create("kannala-brandt", **MIDDLE, fx=15.0, fy=15.5, k=[0.1, -0.02, 0.01, -1e-3]),
    cameras.create("unified", **MIDDLE, fx=20.0, fy=21.0, xi=1.1, distortion=(0.01, 0, 1e-3, 0)),
    cameras.create("extended-unified", **MIDDLE, fx=15.0, fy=16.0, alpha=0.6, beta=1.1),
    cameras.create("double-sphere", **MIDDLE, fx=15.0, fy=16.0, xi=-0.2, alpha=0.6),
    cameras.create("division", **MIDDLE, focal=15.0, k=-0.2),
    cameras.create("ftheta", **MIDDLE, polynomial=(0, 14.0, 0.5, -0.3, 0.1)),
    cameras.create("equirectangular", width=40, height=20),
]


def typical(model: str, format: str) -> cameras.Camera:
    """A camera of a model without a limit, of the size that the format wants."""
    data = {**cameras.model(model).example(40).to_dict(), **SIZE}
    if model == "unified" and format == "colmap":
        data["distortion"] = [0.0, 0.0, 0.0, 0.0]
    middle = {"cx": 20.0, "cy": 15.0, "center": [20.0, 15.0]}
    data |= {key: value for key, value in middle.items() if key in data}
    return cameras.from_dict({key: value for key, value in data.items() if key != "fov_deg"})


@pytest.mark.parametrize("format", WRITTEN)
def test_every_model_is_carried_exactly_or_refused(format: str) -> None:
    """Walks the registry: a model added later must say where it goes."""
    for model in cameras.names():
        camera = typical(model, format)
        name = named(format)
        others = AS_ANOTHER.get(model, set()) & {*FORMS[format].written}
        bent = model == "unified" and model not in FORMS[format].written
        limited = (model, format) in (("ftheta", "woodscape"), ("ftheta", "isaac"))
        lost = bent or limited or not (model in FORMS[format].written or others)
        if lost and (format, model) != ("colmap", "unified"):
            with pytest.raises(ArgumentError, match=f"got .*{model}") as error:
                calibration.dumps({name: camera}, format)
            assert_clear(error)
            continue
        text = calibration.dumps({name: camera}, format)
        (again,) = calibration.loads(text, format).values()
        assert again.name in {model} | others
        if again.name == model:
            assert_same_rays(camera, again)
        valid = camera.valid()
        assert again.valid()[valid].all()
        apart = camera.unproject().directions[valid] - again.unproject().directions[valid]
        assert np.abs(apart).max() < DIRECTION_TOLERANCE


@pytest.mark.parametrize("every", [False, pytest.param(True, marks=pytest.mark.soak)])
def test_a_lens_goes_from_each_form_to_another(every: bool) -> None:
    """Names are lost where a form has none; numbers and rays are not. Every pair, or each form twice."""
    pairs = 0
    for lens in TRAVELLERS:
        texts = {}
        for form in WRITTEN:
            if lens.name in FORMS[form].written:
                with suppress(ArgumentError):
                    texts[form] = calibration.dumps({named(form): lens}, form)
        pixels = lens.pixels()[::3, ::3].reshape(-1, 2)
        rays = lens.unproject(pixels)
        forms = list(texts)
        for i, one in enumerate(forms):
            named_by = one if one == "opencv-fisheye" else None  # others are recognised
            (read,) = calibration.loads(texts[one], named_by).values()
            for other in forms if every else [forms[i - 1]]:
                again = calibration.dumps({named(other): read}, other)
                (back,) = calibration.loads(again, other).values()
                projected, _ = back.project(rays.directions[rays.valid])
                np.testing.assert_allclose(projected, pixels[rays.valid], rtol=0, atol=1e-9)
                pairs += 1
    assert pairs > (300 if every else 50)


@pytest.mark.parametrize("format", SAVED)
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


def test_a_chain_of_kalibr_keeps_its_names() -> None:
    first = cameras.Pinhole(61, 48)
    second = cameras.Unified(61, 48, 40.0, 40.0, xi=0.7)
    again = calibration.loads(calibration.dumps({"cam1": first, "cam0": second}, "kalibr"), "kalibr")
    assert {name: camera.name for name, camera in again.items()} == {"cam1": "pinhole", "cam0": "unified"}
    with pytest.raises(ArgumentError, match="cam0, cam1"):
        calibration.dumps({"left": first}, "kalibr")
