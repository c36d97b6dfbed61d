"""NVIDIA's camera models: the USD attributes of Isaac Sim, and NCore's f-theta cameras in JSON.

Half pixel: both put pixel centres at whole numbers, so their principal points are ours minus 0.5. NCore's
manual defines it so. For Isaac Sim the same is assumed, as for OpenCV's models: no renderer was run here.

``isaac``: a USD layer (text) whose prims ``Camera`` have ``omni:lensdistortion`` attributes. Carried:
``ftheta`` by its polynomial from pixel to angle, of degree 4 at most, without linear terms, ``maxFov`` from
``max_angle_deg``; ``pinhole`` without skew as ``opencvPinhole``; ``kannala-brandt`` without skew as
``opencvFisheye``, and ``fisheye-equidistant`` without the circle in which it ends. Programs hold these
attributes in 32-bit floats; the text has all digits.

``ncore``: ``ftheta`` with either polynomial as the reference. The other polynomial, an approximation of the
inverse, is ignored in reading, and fitted in writing.

Not carried: other models, a limit ``fov_deg``; the prims' transforms.

Source: docs.omniverse.nvidia.com, ``omni.usd.schema.omni_lens_distortion`` 1.0; nvidia.github.io/ncore,
sensor models.
"""

import json
import logging
import re
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from omniscv.arguments import number, numbers, one_of, shown, within
from omniscv.calibration import intrinsics
from omniscv.calibration.documents import put_once
from omniscv.calibration.forms import Form, Node, plain, unread_keys
from omniscv.calibration.intrinsics import HALF_PIXEL
from omniscv.cameras import Camera, FTheta, create
from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.records import checked, key_of, read, record

_log = logging.getLogger("omniscv")

_PREFIX = "omni:lensdistortion:"
_PRIM = re.compile(r'\bdef\s+Camera\s+"([^"\n]{1,100})"')
_COMMENT = re.compile(r"/\*.*?\*/|#[^\n]*", re.DOTALL)
_ATTRIBUTE = re.compile(
    rf"{_PREFIX}([\w:.]{{1,80}})\s*=\s*(\([^()]*\)|\"[^\"\n]*\"|\{{[^{{}}]*\}}|[^\s;(){{}}]+)"
)
_APIS = {
    "ftheta": "OmniLensDistortionFthetaAPI",
    "opencvPinhole": "OmniLensDistortionOpenCvPinholeAPI",
    "opencvFisheye": "OmniLensDistortionOpenCvFisheyeAPI",
}
_ROWS = Form(
    "isaac",
    "",
    "model",
    """
    opencvPinhole pinhole fx fy cx cy k1? k2? p1? p2? k3? k4? k5? k6? s1? s2? s3? s4?
    opencvFisheye kannala-brandt fx fy cx cy k1? k2? k3? k4?
    """,
    word="model",
    size="imageSize",
)


# -- Isaac Sim ------------------------------------------------------------------------------------------


def read_isaac(layer: str) -> dict[str, Camera]:
    """Return the cameras of a USD layer by the names of their prims; ``cam0`` without a prim."""
    cameras: dict[str, Camera] = {}
    texts = _PRIM.split(_COMMENT.sub(" ", layer))  # before the first prim; then name and text of every prim
    for name, text in zip(["cam0", *texts[1::2]], texts[::2], strict=True):
        with within(name):
            attributes: dict[str, str] = {}
            for key, value in _ATTRIBUTE.findall(text):
                put_once(attributes, key, value.strip("\"'"))
            if text.count(_PREFIX) != len(_ATTRIBUTE.findall(text)):
                raise ArgumentError(f"expected attributes 'TYPE {_PREFIX}NAME = VALUE', got others")
            if attributes:
                cameras[name] = _isaac_camera(attributes)
    if not cameras:
        raise ArgumentError(f"expected attributes {_PREFIX}model = ..., got none")
    return cameras


def write_isaac(cameras: Mapping[str, Camera]) -> str:
    """Return a USD layer with a prim ``Camera`` for each camera."""
    lines = ["#usda 1.0"]
    for name, camera in cameras.items():
        with within(name):
            if not re.fullmatch(r"[A-Za-z_]\w{0,99}", name, re.ASCII):
                raise ArgumentError(f"name: expected letters, digits and _, got {shown(name)}")
            values = _ftheta_values(camera) if isinstance(camera, FTheta) else _ROWS.values_of(camera)
        model = values.pop("model")
        lines += ["", f'def Camera "{name}" (', f'    prepend apiSchemas = ["{_APIS[model]}"]', ")", "{"]
        lines.append(f'    token {_PREFIX}model = "{model}"')
        for key, value in values.items():
            usd_type = {"opticalCenter": "float2", "imageSize": "int2"}.get(key, "float")
            text = f"({value[0]}, {value[1]})" if isinstance(value, list) else value
            lines.append(f"    {usd_type} {_PREFIX}{model}:{key} = {text}")
        lines.append("}")
    return "\n".join(lines) + "\n"


def _pixels(name: str, value: object) -> int:
    """Return a number of pixels, which may be given as a float."""
    size = number(name, value)
    return intrinsics.whole_number(name, int(size) if size.is_integer() else value)


def _pair(name: str, value: object) -> list[float]:
    words = [word.strip() for word in str(value).strip("()").split(",")]
    if len(words) != 2:
        raise ArgumentError(f"{name}: expected (x, y), got {shown(value)}")
    pair: list[float] = numbers(name, words, (2,)).tolist()
    return pair


@record(eq=False)
class _IsaacFTheta:
    """The attributes of f-theta, whose sizes are floats."""

    width: int = checked(_pixels, key="nominalWidth")
    height: int = checked(_pixels, key="nominalHeight")
    center: Any = checked(_pair, key="opticalCenter")
    k0: float = checked(number)
    k1: float = checked(number)
    k2: float = checked(number)
    k3: float = checked(number)
    k4: float = checked(number)
    max_fov_deg: float = checked(number, above=0, most=360, default=360.0, key="maxFov")


def _isaac_camera(attributes: Mapping[str, str]) -> Camera:
    model = one_of("model", attributes.get("model"), _APIS)
    values: dict[str, Any] = {key.removeprefix(f"{model}:"): value for key, value in attributes.items()}
    others = [key for key in values if ":" in key or "." in key]
    if others:
        raise ArgumentError(f"{others[0]}: expected attributes of {model} without time samples, got this one")
    if model != "ftheta":
        return _ROWS.entry(Node(values), None).camera
    f = read(_IsaacFTheta, {key: value for key, value in values.items() if key != "model"})
    limit = None if f.max_fov_deg == 360 else f.max_fov_deg / 2
    return _ftheta([f.width, f.height], f.center, [f.k0, f.k1, f.k2, f.k3, f.k4], "pixel-to-angle", limit)


def _ftheta_values(camera: FTheta) -> dict[str, Any]:
    intrinsics.refuse_limit(camera)
    c = camera.polynomial.tolist()
    if camera.reference != "pixel-to-angle" or any(c[5:]) or camera.linear.tolist() != [1, 0, 0]:
        expected = "a polynomial from pixel to angle of degree 4 at most, without linear terms"
        got = f"{camera.reference}, {shown(c)}, linear {shown(camera.linear)}"
        raise ArgumentError(f"Isaac: expected {expected}, got ftheta: {got}")
    most = 360.0 if camera.max_angle_deg is None else 2 * camera.max_angle_deg
    values = {"model": "ftheta", "nominalWidth": camera.width, "nominalHeight": camera.height}
    values |= {"opticalCenter": (camera.center - HALF_PIXEL).tolist(), "maxFov": most}
    return values | {f"k{i}": [*c, 0, 0, 0][i] for i in range(5)}


# -- NCore ----------------------------------------------------------------------------------------------

_REFERENCES = {"ANGLE_TO_PIXELDIST": "angle-to-pixel", "PIXELDIST_TO_ANGLE": "pixel-to-angle"}
_DEGREE = 5


@record(eq=False)
class _NCore:
    """NCore's parameters, a polynomial and its approximate inverse."""

    size: list[int] = checked(
        lambda name, value: [_pixels(name, size) for size in numbers(name, value, (2,)).tolist()],
        key="resolution",
    )
    reference: str = checked(one_of, words=tuple(_REFERENCES), key="reference_poly")
    center: Array = checked(numbers, shape=(2,), key="principal_point")
    max_angle: float = checked(number, above=0)
    linear: Array = checked(
        numbers, shape=(3,), default_factory=lambda: np.array([1.0, 0.0, 0.0]), key="linear_cde"
    )
    pixeldist_to_angle_poly: Any = None
    angle_to_pixeldist_poly: Any = None


def read_ncore(document: str) -> dict[str, Camera]:
    """Return the camera, named ``cam0``, of NCore's f-theta parameters in JSON."""
    data = intrinsics.parse_mapping(document)
    one_of("camera_model_type", data.get("camera_model_type", "ftheta"), ("ftheta",))
    node = Node(data.get("camera_model_parameters", data))
    f = intrinsics.read_known(_NCore, node.values)
    node.used = {plain(key_of(field)) for field in fields(_NCore)} | {"cameramodeltype"}
    unread_keys(node, "^shuttertype$")
    if "ROLLING" in str(shutter := node.take("shutter_type", "GLOBAL")):
        _log.warning("shutter_type: %s: its read-out time is not in the file; read as a global one", shutter)
    key = f"{f.reference.lower()}_poly"
    polynomial = numbers(key, getattr(f, key), (None,))
    max_angle_deg = float(np.degrees(f.max_angle))
    limit = None if abs(max_angle_deg - 180) < 1e-9 else max_angle_deg
    reference = _REFERENCES[f.reference]
    return {"cam0": _ftheta(f.size, f.center, polynomial.tolist(), reference, limit, f.linear.tolist())}


def write_ncore(cameras: Mapping[str, Camera]) -> str:
    """Return the JSON of one ``ftheta`` camera; its name is not carried."""
    with intrinsics.only_camera(cameras, "NCore") as camera:
        if not isinstance(camera, FTheta):
            raise ArgumentError(f"NCore: expected a camera ftheta, got {camera.name}")
        intrinsics.refuse_limit(camera)
        if camera.polynomial[_DEGREE + 1 :].any():
            got = len(camera.polynomial) - 1
            raise ArgumentError(f"polynomial: expected degree {_DEGREE} at most, got {got}")
    exact = (camera.polynomial.tolist() + [0.0] * _DEGREE)[: _DEGREE + 1]
    by_angle = camera.reference == "angle-to-pixel"
    inverse = _inverse(camera)
    most = 180.0 if camera.max_angle_deg is None else camera.max_angle_deg
    parameters = {
        "resolution": [camera.width, camera.height],
        "shutter_type": "GLOBAL",
        "principal_point": (camera.center - HALF_PIXEL).tolist(),
        "reference_poly": "ANGLE_TO_PIXELDIST" if by_angle else "PIXELDIST_TO_ANGLE",
        "pixeldist_to_angle_poly": inverse if by_angle else exact,
        "angle_to_pixeldist_poly": exact if by_angle else inverse,
        "max_angle": float(np.radians(most)),
        "linear_cde": camera.linear.tolist(),
    }
    return json.dumps({"camera_model_type": "ftheta", "camera_model_parameters": parameters}, indent=1)


def _inverse(camera: FTheta) -> list[float]:
    """Return 0, c1, ... c5 that approximate the inverse of a camera's polynomial in its image."""
    rays = camera.unproject()
    x, y, z = rays.directions[rays.valid].T
    last = np.arctan2(np.hypot(x, y), z).max(initial=1e-3)
    if camera.reference == "pixel-to-angle":
        c, d, e = camera.linear
        offsets = np.linalg.solve([[c, d], [e, 1.0]], (camera.pixels()[rays.valid] - camera.center).T)
        last = np.hypot(*offsets).max(initial=1.0)
    argument = np.linspace(0, last, 400)
    value = np.polynomial.polynomial.polyval(argument, camera.polynomial)
    powers = value[:, None] ** np.arange(1, _DEGREE + 1)
    scale = np.abs(powers).max(axis=0)
    scale[scale == 0] = 1
    inverse = np.linalg.lstsq(powers / scale, argument, rcond=None)[0] / scale
    return [0.0, *inverse.tolist()]


def _ftheta(
    size: list[int],
    center: Any,
    polynomial: list[float],
    reference: str,
    max_angle_deg: float | None,
    linear: list[float] | None = None,
) -> Camera:
    cx, cy = (np.asarray(center) + HALF_PIXEL).tolist()
    terms: dict[str, Any] = {"polynomial": polynomial, "reference": reference, "linear": linear or [1, 0, 0]}
    return create("ftheta", *size, cx=cx, cy=cy, max_angle_deg=max_angle_deg, **terms)
