"""NVIDIA's camera models: the USD attributes of Isaac Sim, and NCore's f-theta cameras in JSON.

Half pixel: both put pixel centres at whole numbers, so their principal points are ours minus 0.5. NCore's
manual defines it so. For Isaac Sim the same is assumed, as for OpenCV's models: no renderer was run here.

``isaac``: a USD layer (text) whose prims ``Camera`` have ``omni:lensdistortion`` attributes; their transforms
are not carried. ``ncore``: ``ftheta`` with either polynomial as the reference; the other one, an
approximation of the inverse, is ignored in reading, and fitted in writing. Rolling shutters are refused:
NCore has their times in the sequence, not with the lens.

Source: docs.omniverse.nvidia.com, ``omni.usd.schema.omni_lens_distortion`` 1.0; nvidia.github.io/ncore,
sensor models.
"""

import json
import re
from typing import Any

import numpy as np

from omniscv.arguments import one_of, shown, within, wrong
from omniscv.calibration.documents import Content, put_once
from omniscv.calibration.forms import Form, Layout, LensNumbers, Reading, Writing
from omniscv.calibration.keys import FISHEYE4, MATRIX, RADTAN8, Model, array, scalar, scalars
from omniscv.calibration.nodes import Node, Values, mappings
from omniscv.cameras import Camera, FTheta
from omniscv.errors import ArgumentError

# -- Isaac Sim ------------------------------------------------------------------------------------------

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


def _prims(content: Content) -> dict[str, Values]:
    """Return the attributes of a USD layer's cameras by the names of their prims; ``cam0`` without a prim."""
    cameras: dict[str, Values] = {}
    layer = _COMMENT.sub(" ", content.text)
    if _PREFIX not in layer:
        return cameras
    texts = _PRIM.split(layer)  # before the first prim; then name and text of every prim
    for name, text in zip(["cam0", *texts[1::2]], texts[::2], strict=True):
        with within(name):
            values = _attributes(text)
            if values:
                cameras[name] = values
    return cameras


def _attributes(text: str) -> Values:
    """Return the attributes of a prim by name, without the prefix of its model."""
    attributes: Values = {}
    matches = _ATTRIBUTE.findall(text)
    for key, value in matches:
        put_once(attributes, key, value.strip("\"'"))
    if text.count(_PREFIX) != len(matches):
        raise ArgumentError(f"expected attributes 'TYPE {_PREFIX}NAME = VALUE', got others")
    if not attributes:
        return {}
    model = one_of("model", attributes.get("model"), _APIS)
    values: Values = {}
    for name, value in attributes.items():
        key = name.removeprefix(f"{model}:")
        if ":" in key or "." in key:
            raise ArgumentError(f"{key}: expected attributes of {model} without time samples, got it")
        values[key] = value
    return values


def _layer(cameras: dict[str, Values]) -> str:
    """Return a USD layer with a prim ``Camera`` for each camera."""
    lines = ["#usda 1.0"]
    for name, values in cameras.items():
        if not re.fullmatch(r"[A-Za-z_]\w{0,99}", name, re.ASCII):
            raise ArgumentError(f"name: expected letters, digits and _, got {shown(name)}")
        model = values.pop("model")
        if model != "ftheta":
            values["imageSize"] = [values.pop("nominalWidth"), values.pop("nominalHeight")]
        lines += ["", f'def Camera "{name}" (', f'    prepend apiSchemas = ["{_APIS[model]}"]', ")", "{"]
        lines.append(f'    token {_PREFIX}model = "{model}"')
        for key, value in values.items():
            usd_type = {"opticalCenter": "float2", "imageSize": "int2"}.get(key, "float")
            text = f"({value[0]}, {value[1]})" if isinstance(value, list) else value
            lines.append(f"    {usd_type} {_PREFIX}{model}:{key} = {text}")
        lines.append("}")
    return "\n".join(lines) + "\n"


ISAAC = Form(
    "isaac",
    "Isaac Sim: USD as text",
    marks=(f"{_PREFIX}model",),
    layout=Layout(
        models=(
            Model(
                "ftheta-inverse",
                words=("ftheta",),
                keys=(
                    array("opticalCenter", "cx", "cy"),
                    scalar("k0", "c0"),
                    scalar("k1", "c1"),
                    scalar("k2", "c2"),
                    scalar("k3", "c3"),
                    scalar("k4", "c4"),
                    scalar("maxFov", "fov", optional=True),
                ),
            ),
            Model(
                "pinhole",
                words=("opencvPinhole",),
                keys=(
                    *scalars(*MATRIX),
                    *scalars(*RADTAN8, optional=True),
                    *scalars("s1", "s2", "s3", "s4", optional=True),
                ),
            ),
            Model(
                "kannala-brandt",
                words=("opencvFisheye",),
                keys=(
                    *scalars(*MATRIX),
                    *scalars(*FISHEYE4, optional=True),
                ),
            ),
        ),
        word=("model",),
        size=("nominalWidth", "nominalHeight"),
    ),
    reading=Reading(split=_prims, sparse=True),
    writing=Writing(join=dict, dump=_layer),
    refused="values that change with time",
)


# -- NCore ----------------------------------------------------------------------------------------------

_DEGREE = 5  # of polynomials
_POLYNOMIALS = {
    "ANGLE_TO_PIXELDIST": "angle_to_pixeldist_poly",
    "PIXELDIST_TO_ANGLE": "pixeldist_to_angle_poly",
}


def _parameters(content: Content) -> dict[str, Any]:
    """Return the parameters of NCore's camera as ``cam0``; ArgumentError for another model than f-theta."""
    cameras = {}
    for node in mappings(content, ("camera_model_parameters.reference_poly", "reference_poly")):
        one_of("camera_model_type", node.take("camera_model_type", "ftheta"), ("ftheta",))
        values = dict(node.take("camera_model_parameters", node.values))
        values.pop("camera_model_type", None)
        cameras["cam0"] = values
    return cameras


def _without_times(node: Node, lens: LensNumbers) -> LensNumbers:
    """Refuse rolling shutters, and leave the other polynomial unread."""
    shutter = node.take("shutter_type", "GLOBAL")
    if "ROLLING" in str(shutter):
        wanted = "GLOBAL (the file has no read-out time; write GLOBAL to take the lens without its shutter)"
        raise wrong("shutter_type", wanted, shutter)
    for name in _POLYNOMIALS.values():
        node.take(name, None)
    return lens


def _with_inverse(values: Values) -> str:
    """Return the text of a camera, with the other polynomial."""
    word = values["reference_poly"]
    model, numbers = NCORE.model(Node(values), (word,))
    (other,) = _POLYNOMIALS.keys() - {word}
    width, height = values["resolution"]
    camera = NCORE.camera(model, LensNumbers(numbers, width, height))
    parameters = values | {_POLYNOMIALS[other]: _inverse(camera)}
    return json.dumps({"camera_model_type": "ftheta", "camera_model_parameters": parameters}, indent=1)


def _inverse(camera: Camera) -> list[float]:
    """Return 0, c1, ... c5 that approximate the inverse of a camera's polynomial in its image."""
    assert isinstance(camera, FTheta)
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


_COUNTS = (2, 3, 4, 5, 6)
_COMMON = (
    array("principal_point", "cx", "cy"),
    scalar("max_angle", "rad"),
    array("linear_cde", "lc", "ld", "le", optional=True),
)
NCORE = Form(
    "ncore",
    "NVIDIA NCore",
    marks=("reference_poly",),
    layout=Layout(
        models=(
            Model(
                "ftheta",
                words=("ANGLE_TO_PIXELDIST",),
                keys=(
                    array("angle_to_pixeldist_poly", "c0", "c1", "c2", "c3", "c4", "c5", counts=_COUNTS),
                    *_COMMON,
                ),
            ),
            Model(
                "ftheta-inverse",
                words=("PIXELDIST_TO_ANGLE",),
                keys=(
                    array("pixeldist_to_angle_poly", "c0", "c1", "c2", "c3", "c4", "c5", counts=_COUNTS),
                    *_COMMON,
                ),
            ),
        ),
        word=("reference_poly",),
        size=("resolution",),
    ),
    reading=Reading(split=_parameters, finish=_without_times),
    writing=Writing(dump=_with_inverse, constant={"shutter_type": "GLOBAL"}),
    refused="the windshield, tangential coefficients, rolling shutters",
)
