"""NVIDIA's camera models: the USD attributes of Isaac Sim, and NCore's f-theta cameras in JSON.

Half pixel: both put pixel centres at whole numbers, so their principal points are ours minus 0.5. NCore's
manual defines it so; for Isaac Sim it is taken from that definition, and for its two OpenCV models from
OpenCV: no renderer was run here.

``isaac``: a USD layer (text) whose prims ``Camera`` have ``omni:lensdistortion`` attributes. Carried:
``ftheta`` by its polynomial from pixel to angle, of degree 4 at most, without linear terms, ``maxFov`` from
``max_angle_deg``; ``pinhole`` without skew as ``opencvPinhole``; ``kannala-brandt`` without skew as
``opencvFisheye``, and ``fisheye-equidistant`` without the circle in which it ends. Programs hold these
attributes in 32-bit floats; the text has all digits.

``ncore``: ``ftheta`` with either polynomial as the reference. The other polynomial, which only approximates
the inverse, is not read, and fitted in writing.

Not carried: other models, a limit ``fov_deg``; the prims' transforms.

Source: docs.omniverse.nvidia.com, ``omni.usd.schema.omni_lens_distortion`` 1.0; nvidia.github.io/ncore,
sensor models.
"""

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from omniscv.arguments import number, numbers, one_of, shown, within
from omniscv.calibration.common import field, mapping, only_camera, whole_number
from omniscv.calibration.intrinsics import HALF_PIXEL, FormatModel, camera_of, fit_format, refuse_limit
from omniscv.cameras import Camera, FTheta, create
from omniscv.errors import ArgumentError

_PREFIX = "omni:lensdistortion:"
_PRIM = re.compile(r'\bdef\s+Camera\s+"([^"\n]{1,100})"')
_ATTRIBUTE = re.compile(
    rf"^[ \t]*(?:uniform[ \t]+)?\w+[ \t]+{_PREFIX}([\w:]{{1,60}})[ \t]*=[ \t]*(.{{1,200}}?)\s*$",
    re.MULTILINE,
)
_APIS = {
    "ftheta": "OmniLensDistortionFthetaAPI",
    "opencvPinhole": "OmniLensDistortionOpenCvPinholeAPI",
    "opencvFisheye": "OmniLensDistortionOpenCvFisheyeAPI",
}
_PLACE = ("fx", "fy", "cx", "cy")
_OPENCV = {
    "opencvPinhole": (*_PLACE, "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4"),
    "opencvFisheye": (*_PLACE, "k1", "k2", "k3", "k4"),
}
_MODELS = {
    "opencvPinhole": FormatModel("opencvPinhole", "pinhole", _OPENCV["opencvPinhole"]),
    "opencvFisheye": FormatModel("opencvFisheye", "kannala-brandt", _OPENCV["opencvFisheye"]),
}


# -- Isaac Sim ------------------------------------------------------------------------------------------


def read_isaac(layer: str) -> dict[str, Camera]:
    """Return the cameras of a USD layer by the names of their prims; ``cam0`` without a prim.

    Raises:
        ArgumentError: no ``omni:lensdistortion`` attributes, one missing or wrong, or another model.
    """
    found: dict[str, Camera] = {}
    for name, part in _prims(layer):
        given = dict(_ATTRIBUTE.findall(part))
        if given:
            with within(name):
                found[name] = _isaac_camera({key: value.strip("\"'") for key, value in given.items()})
    if not found:
        raise ArgumentError(f"expected attributes {_PREFIX}model = ..., got none")
    return found


def write_isaac(cameras: Mapping[str, Camera]) -> str:
    """Return a USD layer with a prim ``Camera`` for each camera.

    Raises:
        ArgumentError: a name that no prim can have, or a camera that Isaac Sim's models cannot carry.
    """
    lines = ["#usda 1.0"]
    for name, camera in cameras.items():
        with within(name):
            if not re.fullmatch(r"[A-Za-z_]\w{0,99}", name, re.ASCII):
                raise ArgumentError(f"name: expected letters, digits and _, got {shown(name)}")
            model, values = _isaac_values(camera)
        lines += ["", f'def Camera "{name}" (', f'    prepend apiSchemas = ["{_APIS[model]}"]', ")", "{"]
        lines.append(f'    token {_PREFIX}model = "{model}"')
        for key, value in values.items():
            kinds: dict[type[Any], str] = {tuple: "float2", list: "int2"}
            kind = kinds.get(type(value), "float")
            shown_value = f"({value[0]}, {value[1]})" if kind != "float" else str(value)
            lines.append(f"    {kind} {_PREFIX}{model}:{key} = {shown_value}")
        lines.append("}")
    return "\n".join(lines) + "\n"


def _prims(layer: str) -> Iterator[tuple[str, str]]:
    """Name and text of every prim; what comes before the first one is ``cam0``'s."""
    name, start = "cam0", 0
    for prim in _PRIM.finditer(layer):
        yield name, layer[start : prim.start()]
        name, start = prim[1], prim.end()
    yield name, layer[start:]


def _isaac_camera(given: Mapping[str, str]) -> Camera:
    model = one_of("model", field(given, "model"), _APIS)
    own = {key.partition(":")[2]: value for key, value in given.items() if key.startswith(f"{model}:")}
    if model == "ftheta":
        c = [number(f"k{i}", field(own, f"k{i}")) for i in range(5)]
        center = numbers("opticalCenter", field(own, "opticalCenter").strip("()").split(","), (2,))
        size = [_pixels(key, field(own, key)) for key in ("nominalWidth", "nominalHeight")]
        most = number("maxFov", own.get("maxFov", 360.0), above=0, most=360) / 2
        return _ftheta(size, center, c, "pixel-to-angle", None if most == 180 else most)
    words = field(own, "imageSize").strip("()").split(",")
    if len(words) != 2:
        raise ArgumentError(f"imageSize: expected (width, height), got {shown(own['imageSize'])}")
    width, height = (_pixels("imageSize", each) for each in words)
    values = {key: number(key, own.get(key, 0.0)) for key in _OPENCV[model]}
    values["cx"], values["cy"] = values["cx"] + HALF_PIXEL, values["cy"] + HALF_PIXEL
    return camera_of(_MODELS[model].model, width, height, values)


def _isaac_values(camera: Camera) -> tuple[str, dict[str, Any]]:
    cx, cy = (camera.center - HALF_PIXEL).tolist()
    if isinstance(camera, FTheta):
        refuse_limit(camera)
        c = camera.polynomial.tolist()
        if camera.reference != "pixel-to-angle" or any(c[5:]) or camera.linear.tolist() != [1, 0, 0]:
            wanted = "a polynomial from pixel to angle of degree 4 at most, without linear terms"
            got = f"{camera.reference}, {shown(c)}, linear {shown(camera.linear)}"
            raise ArgumentError(f"Isaac: expected {wanted}, got ftheta: {got}")
        most = 360.0 if camera.max_angle_deg is None else 2 * camera.max_angle_deg
        values = {"nominalWidth": camera.width, "nominalHeight": camera.height, "opticalCenter": (cx, cy)}
        return "ftheta", values | {"maxFov": most} | {f"k{i}": [*c, 0, 0, 0][i] for i in range(5)}
    found = fit_format(camera, _MODELS.values(), HALF_PIXEL)
    if found is None:
        raise ArgumentError(f"Isaac: expected ftheta, pinhole or kannala-brandt, unskewed, got {camera.name}")
    row, numbers_of = found
    return row.name, {"imageSize": [camera.width, camera.height]} | dict(
        zip(row.numbers, numbers_of, strict=True)
    )


def _pixels(key: str, value: str) -> int:
    """A size, which f-theta's attributes hold as floats."""
    return whole_number(key, int(found) if (found := number(key, value.strip())).is_integer() else value)


# -- NCore ----------------------------------------------------------------------------------------------

_REFERENCES = {"ANGLE_TO_PIXELDIST": "angle-to-pixel", "PIXELDIST_TO_ANGLE": "pixel-to-angle"}
_POLYNOMIALS = {
    "ANGLE_TO_PIXELDIST": "angle_to_pixeldist_poly",
    "PIXELDIST_TO_ANGLE": "pixeldist_to_angle_poly",
}
_DEGREE = 5


def read_ncore(document: str) -> dict[str, Camera]:
    """Return the camera, named ``cam0``, of NCore's f-theta parameters in JSON.

    Raises:
        ArgumentError: a key is missing or holds something else, or no camera has these parameters.
    """
    data = mapping(document)
    data = data.get("camera_model_parameters", data)
    size = numbers("resolution", field(data, "resolution"), (2,)).tolist()
    reference = one_of("reference_poly", field(data, "reference_poly"), _REFERENCES)
    key = _POLYNOMIALS[reference]
    polynomial = numbers(key, field(data, key), (None,)).tolist()
    center = numbers("principal_point", field(data, "principal_point"), (2,))
    linear = numbers("linear_cde", data.get("linear_cde", [1, 0, 0]), (3,))
    most = float(np.degrees(number("max_angle", field(data, "max_angle"), above=0)))
    most = 180.0 if abs(most - 180) < 1e-9 else most
    sizes = [_pixels("resolution", str(each)) for each in size]
    limit = None if most == 180 else most
    return {"cam0": _ftheta(sizes, center, polynomial, _REFERENCES[reference], limit, linear.tolist())}


def write_ncore(cameras: Mapping[str, Camera]) -> str:
    """Return the JSON of one ``ftheta`` camera; its name is not carried.

    Raises:
        ArgumentError: not exactly one camera, another model, a limit ``fov_deg``, or a polynomial of degree
            above 5.
    """
    name, camera = only_camera(cameras, "NCore")
    with within(name):
        if not isinstance(camera, FTheta):
            raise ArgumentError(f"NCore: expected a camera ftheta, got {camera.name}")
        refuse_limit(camera)
        if camera.polynomial[_DEGREE + 1 :].any():
            got = len(camera.polynomial) - 1
            raise ArgumentError(f"polynomial: expected degree {_DEGREE} at most, got {got}")
    own = (camera.polynomial.tolist() + [0.0] * _DEGREE)[: _DEGREE + 1]
    by_angle = camera.reference == "angle-to-pixel"
    other = _inverse(camera)
    most = 180.0 if camera.max_angle_deg is None else camera.max_angle_deg
    parameters = {
        "resolution": [camera.width, camera.height],
        "shutter_type": "GLOBAL",
        "principal_point": (camera.center - HALF_PIXEL).tolist(),
        "reference_poly": "ANGLE_TO_PIXELDIST" if by_angle else "PIXELDIST_TO_ANGLE",
        "pixeldist_to_angle_poly": other if by_angle else own,
        "angle_to_pixeldist_poly": own if by_angle else other,
        "max_angle": float(np.radians(most)),
        "linear_cde": camera.linear.tolist(),
    }
    return json.dumps({"camera_model_type": "ftheta", "camera_model_parameters": parameters}, indent=1)


def _inverse(camera: FTheta) -> list[float]:
    """Coefficients 0, c1, ... c5 of the inverse of a camera's polynomial, nearest over what it sees."""
    rays = camera.unproject()
    theta = np.arctan2(np.hypot(*np.moveaxis(rays.directions[rays.valid][:, :2], -1, 0)),
                       rays.directions[rays.valid][:, 2])  # fmt: skip
    own = np.linspace(0, theta.max(initial=1e-3), 400)
    c, d, e = camera.linear
    if camera.reference == "pixel-to-angle":
        offsets = np.linalg.solve([[c, d], [e, 1.0]], (camera.pixels()[rays.valid] - camera.center).T)
        own = np.linspace(0, np.hypot(*offsets).max(initial=1.0), 400)
    x, y = np.polynomial.polynomial.polyval(own, camera.polynomial), own
    powers = x[:, None] ** np.arange(1, _DEGREE + 1)
    scale = np.abs(powers).max(axis=0)
    scale[scale == 0] = 1
    found = np.linalg.lstsq(powers / scale, y, rcond=None)[0] / scale
    return [0.0, *found.tolist()]


def _ftheta(
    size: list[int],
    center: Any,
    polynomial: list[float],
    reference: str,
    max_angle_deg: float | None,
    linear: list[float] | None = None,
) -> Camera:
    cx, cy = (np.asarray(center) + HALF_PIXEL).tolist()
    given: dict[str, Any] = {"polynomial": polynomial, "reference": reference, "linear": linear or [1, 0, 0]}
    return create("ftheta", *size, cx=cx, cy=cy, max_angle_deg=max_angle_deg, **given)


def looks_like_isaac(document: str) -> bool:
    """Return whether a text has Isaac Sim's attributes."""
    return _ATTRIBUTE.search(document) is not None
