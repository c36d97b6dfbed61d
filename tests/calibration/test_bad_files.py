"""Text that does not follow its format is refused in one line that says what was expected."""

import json

import numpy as np
import pytest
from support.calibration_files import SAVED, TEXTS

from omniscv import calibration
from omniscv.errors import ArgumentError

GOOD = {
    "opencv-fisheye": TEXTS["opencv-fisheye"],
    "colmap": "1 PINHOLE 64 48 50 50 32 24",
    "ocamcalib": TEXTS["ocamcalib"],
    "isaac": calibration.dumps({"cam0": SAVED["ncore"]["cam0"]}, "isaac"),
}

REPLACED = {
    "opencv-fisheye": [
        ("image_width: 40", "image_length: 40", "missing key 'image_width'"),
        ("camera_matrix: !!opencv-matrix", "camera_matrix: 3 #", "expected YAML"),
        ("[ 15.,", "[ .Nan,", "camera_matrix: data: expected 9 finite"),
        ("[ 15.,", "[ -15.,", "fx: expected a finite number"),
        ("e-05 ]", "e-05, 0.1 ]", "distortion_coefficients: expected 0"),
        ("fisheye_model: 1", "fisheye_model: 0", "read the file as 'opencv'"),
    ],
    "colmap": [
        ("1 PINHOLE 64 48 50 50 32 24", "", "colmap: expected"),
        (" 48 50 50 32 24", "", "line 1: expected 'CAMERA_ID"),
        ("1 PINHOLE", "\n1 THIN_PRISM_FISHEYE", "1: MODEL: expected one of SIMPLE_PINHOLE"),
        ("PINHOLE 64 48 50 50 32 24", "EQUIRECTANGULAR 64 32 64 33", "the image size, 64 32"),
        ("32 24", "32 24\n01 PINHOLE 64 48 50 50 32 24", "line 2: expected each CAMERA_ID once"),
        ("PINHOLE 64 48 50 50 32 24", "DIVISION 64 48 40 41 32 24 -0.2", "focal lengths: expected two"),
    ],
    "ocamcalib": [
        ("3 -15", "99999999 -15", "polynomial: expected a whole number <= 1000000"),
        ("3 -15", "3 15", "coefficients\\[0\\]: expected a finite number < 0"),
        ('"e"\n\n', '"e"\n\n-', "affine: expected c > 0"),
        ('"e"\n\n', '"e"\n\n1 2 3 ', "image size"),
    ],
    "isaac": [
        ('"ftheta"', '"lut"', "model: expected one of ftheta"),
        ("opticalCenter = (19.5, 14.5)", "opticalCenter = (19.5)", "opticalCenter: expected 2 finite"),
        ("ftheta:k1", "ftheta:c1", "missing key 'k1'"),
        ("maxFov = 190.0", "maxFov = 400.0", "max_angle_deg: expected a finite number"),
        ("omni:lens", "omni:glass", "expected keys omni:lensdistortion"),
    ],
}  # fmt: skip
"""By format: a text, and what is replaced in it, by what, and the error's message."""


def refused(format, text, message):
    with pytest.raises(ArgumentError, match=message) as caught:
        calibration.loads(text, format)
    assert any(word in str(caught.value) for word in ("expected", "missing key", "unknown key"))
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 600


@pytest.mark.parametrize(
    ("format", "old", "new", "message"),
    [(format, *row) for format, rows in REPLACED.items() for row in rows],
    ids=str,
)
def test_changed_text_is_refused(format, old, new, message):
    assert old in GOOD[format]
    refused(format, GOOD[format].replace(old, new), message)


F62 = [240.0, 320.5, 239.25, *[0.0] * 8]
TURN = {"Translation": [0, 0, 0], "UnitQuaternion": [0, [0, 0, 0]]}
CHANGED_KEYS = {
    "aria": [
        ({"Projection": {"Name": "Spherical", "Params": []}}, "Projection.Name: expected one of"),
        ({"Projection": {"Name": "Fisheye62", "Params": [*F62, 0]}}, "Projection.Params: expected 11 finite"),
        ({"T_Device_Camera": {"Translation": [0, 0, 0]}}, "T_Device_Camera: missing key 'T_Device_C"),
        ({"T_Device_Camera": TURN}, "T_Device_Camera: quaternion: expected one of length 1"),
    ],
    "ncore": [
        ({"reference_poly": "BOTH"}, "reference_poly: expected one of"),
        ({"resolution": [64.5, 48]}, "resolution: expected a whole number"),
        ({"pixeldist_to_angle_poly": [1, 2]}, "polynomial: expected \\(0, c1"),
    ],
    "kalibr": [
        ({"camera_model": "omni", "intrinsics": [0.9, -30, -30, 29, 23]}, "cam0: fx: expected a finite num"),
        ({"camera_model": "omni", "intrinsics": [1.3, 30, -30, 29, 23]}, "cam0: fy: expected a finite num"),
        ({"distortion_model": "division"}, "cam0: .*pinhole-none.*pinhole-fov"),
        ({"camera_model": "omni", "distortion_model": "equidistant"}, "pinhole-none.*omni-equidistant"),
    ],
}  # fmt: skip
CHAIN = {"camera_model": "pinhole", "intrinsics": [30.0, 30.0, 29.5, 23.25], "resolution": [61, 48]}
CHAIN |= {"distortion_model": "none", "distortion_coeffs": [], "T_cam_imu": np.eye(4).tolist()}


CAMERAS = {"kalibr": "cam0", "aria": "CameraCalibrations", "ncore": "camera_model_parameters"}


@pytest.mark.parametrize(
    ("format", "changes", "message"),
    [(format, *row) for format, rows in CHANGED_KEYS.items() for row in rows],
)
def test_changed_keys_are_refused(format, changes, message):
    document = {"cam0": dict(CHAIN)} if format == "kalibr" else json.loads(TEXTS[format])
    keys = document[CAMERAS[format]]
    (keys[0] if format == "aria" else keys).update(changes)
    refused(format, json.dumps(document), message)


ENTRY = "cam0: {{camera_model: pinhole, distortion_model: none, distortion_coeffs: [], "
ENTRY += "resolution: {}, intrinsics: {}}}"
XML = "<opencv_storage><camera_matrix>1 2</camera_matrix><image_width>6</image_width></opencv_storage>"


@pytest.mark.parametrize(
    "text",
    [
        *(ENTRY.format("[4, 3]", f"[{value}, 1, 1, 1]") for value in (".nan", "true", "[1]", "2026-01-01")),
        *(ENTRY.format(size, "[1, 1, 1, 1]") for size in ("[4, 3.5]", "[0, 3]", "[4]")),
        "cam0: {camera_model: [pinhole], distortion_model: {none: none}}",
        "cam0: pinhole",
        '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>',
        '<?p <!-- ?><!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>',
        "<opencv_storage><camera_matrix>",
        XML,
        "1" * 300,  # took hours: each digit began another number of DSO's
        "\n" * 100_000,  # minutes: each line began the blanks before a key
        "<" + "<!--" * 100_000,  # minutes: each comment was looked for to the end
    ],
)
def test_hostile_text_is_refused(text):
    for format in ("kalibr", "opencv"):
        refused(format, text, "expected|missing key")
    if "DOCTYPE" in text:
        refused("opencv", text, "without <!DOCTYPE")


OURS = "omniscv: 1, model: pinhole, width: 64, height: 48"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (f"{{{OURS}, 'fx': 1e308, 'fy': 9}}", "fx: expected"),
        (f"{{{OURS}, 'focal': 9, 'center': [1e9, 2]}}", "cx"),
        ('{"fx": ' + "9" * 5000 + "}", "too long a number"),
        ('{"fx": 500, "fy": 500, "cx": , "cy": 24, "width": 64, "height": 48}', "a key without a value"),
        (
            "# oST version 5.0 parameters\n\n[image]\n\nwidth\n64\n\nheight\n48\n\n[a]\n\ncamera matrix\n"
            "50 0 32\n0 50 24\n0 0 1\n\ndistortion\nnull 0.2 0 0 0\n\nrectification\n1 0 0\n0 1 0\n0 0 1\n\n"
            "projection\n50 0 32 0\n0 50 24 0\n0 0 1 0\n",
            "distortion_coefficients: expected 5 finite numbers",
        ),
    ],
)
def test_what_was_wrong_in_silence_is_refused(text, says):
    with pytest.raises(ArgumentError, match=says):
        calibration.loads(text)
