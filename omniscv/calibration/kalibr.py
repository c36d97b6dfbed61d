"""Kalibr's ``camchain.yaml``: cameras ``cam0``, ``cam1``, ... with a model, intrinsics and a resolution.

Half pixel: Kalibr puts pixel centres at whole numbers, so its principal point is ours minus 0.5. Carried:

``pinhole-none``, ``pinhole-radtan``
    ``pinhole``, with k1, k2, p1, p2.
``pinhole-equidistant``
    ``kannala-brandt``, and ``fisheye-equidistant`` without the circle in which it ends. Kalibr itself reaches
    only rays with z > 0.
``omni-none``, ``omni-radtan``
    ``unified``, Mei's sphere model: ``u = pu + fu x_s / (z_s + xi)``, ``v = pv + fv y_s / (z_s + xi)`` of the
    unit direction x_s; and ``fisheye-stereographic``, whose xi is 1, without the circle in which it ends.
    ``omni-none`` with ``fv = -fu < 0``, or ``fu = -fv < 0``, is a picture in a mirror:
    ``catadioptric-planar`` (xi = 0), ``-hyperbolic`` (0 < xi < 1) and ``-parabolic`` (xi = 1), with
    ``fu = -eta focal``. Our frame looks at the mirror, Mei's z away from it: half a turn about x,
    ``X_mei = (x, -y, -z)``, hence the sign of fv (about y, and fu, where that is the negative one).
    docs/calibration.md: files of Kalibr's own programs, which refuse negative focal lengths. The mirror's
    size is not carried, and no ray depends on it: a hyperboloid comes back with ``distance`` 1, a paraboloid
    with ``semi_latus_rectum`` 1.
``eucm-none``, ``ds-none``
    ``extended-unified`` and ``double-sphere``.

Not carried: every other model (of Kalibr's own, ``pinhole-fov``), skew, a limit ``fov_deg``, where a mirror
ends, topics. Poses and time shifts are in :mod:`omniscv.calibration.rigs`.

Source: Kalibr, ``kalibr_common/ConfigReader.py``.
"""

import math
import re
from collections.abc import Mapping
from typing import Any

import yaml

from omniscv.arguments import numbers, shown, within
from omniscv.calibration.common import field, mapping, whole_number
from omniscv.calibration.intrinsics import HALF_PIXEL, FormatModel, camera_of, fit_format, read_numbers
from omniscv.cameras import Camera, central_mirrors
from omniscv.errors import ArgumentError

_TABLE = """
pinhole none        pinhole          fx fy cx cy
pinhole radtan      pinhole          fx fy cx cy k1 k2 p1 p2
pinhole equidistant kannala-brandt   fx fy cx cy k1 k2 k3 k4
omni    none        unified          xi fx fy cx cy
omni    radtan      unified          xi fx fy cx cy k1 k2 p1 p2
eucm    none        extended-unified alpha beta fx fy cx cy
ds      none        double-sphere    xi alpha fx fy cx cy
"""
_ROWS = [line.split() for line in _TABLE.strip().splitlines()]
_MODELS = {
    (name, distortion): FormatModel(f"{name}-{distortion}", model, tuple(names))
    for name, distortion, model, *names in _ROWS
}
"""(camera_model, distortion_model): our model; the intrinsics, then the coefficients in their order."""

_NAME = re.compile(r"cam\d+")


def read_kalibr(text: str) -> dict[str, Camera]:
    """Return the cameras of a camchain, by their names ``cam0``, ``cam1``, ...; their poses are not read.

    Raises:
        ArgumentError: not YAML, no camera in it, a key missing or of the wrong length, a number not
            finite, or parameters that no model of ours has.
    """
    chain = mapping(text)
    cameras = {}
    for name, entry in chain.items():
        if isinstance(name, str) and _NAME.fullmatch(name):
            with within(name):
                cameras[name] = _camera(entry)
    if not cameras:
        raise ArgumentError(f"expected cameras cam0, cam1, ..., got {shown(list(chain))}")
    return cameras


def write_kalibr(cameras: Mapping[str, Camera]) -> str:
    """Return the camchain of cameras named ``cam0``, ``cam1``, ...; intrinsics only.

    Raises:
        ArgumentError: another name, or a camera that Kalibr's models cannot carry.
    """
    chain = {}
    for name, camera in cameras.items():
        if not _NAME.fullmatch(name):
            raise ArgumentError(f"name: expected cam0, cam1, ..., got {shown(name)}")
        with within(name):
            chain[name] = _entry(camera)
    return yaml.safe_dump(chain, sort_keys=False, default_flow_style=None)


def _camera(entry: object) -> Camera:
    model = field(entry, "camera_model"), field(entry, "distortion_model")
    if model not in list(_MODELS):
        known = ", ".join(map("-".join, _MODELS))
        raise ArgumentError(f"camera_model, distortion_model: expected one of {known}, got {shown(model)}")
    row = _MODELS[model]
    of_lens = row.numbers.index("cy") + 1
    counts = {"intrinsics": of_lens, "distortion_coeffs": len(row.numbers) - of_lens}
    values: list[float] = []
    for key, count in counts.items():
        values += numbers(key, field(entry, key), (count,)).tolist()
    resolution = field(entry, "resolution")
    if not isinstance(resolution, list) or len(resolution) != 2:
        raise ArgumentError(f"resolution: expected [width, height], got {shown(resolution)}")
    width, height = (whole_number(f"resolution[{i}]", size) for i, size in enumerate(resolution))
    read = read_numbers(row, values, HALF_PIXEL)
    if row.name == "omni-none" and min(read["fx"], read["fy"]) < 0:
        return _mirror(width, height, **read)
    return camera_of(row.model, width, height, read)


def _mirror(width: int, height: int, xi: float, fx: float, fy: float, cx: float, cy: float) -> Camera:
    if fx != -fy or not 0 <= xi <= 1:
        raise ArgumentError(
            "intrinsics: expected fu = -fv and 0 <= xi <= 1 for a mirror's picture, got "
            f"xi = {xi:.15g}, fu = {fx:.15g}, fv = {fy:.15g}"
        )
    focal, center = abs(fx), (cx, cy)
    if xi == 0:
        return central_mirrors.CatadioptricPlanar(width, height, focal=focal, center=center)
    if xi == 1:
        return central_mirrors.CatadioptricParabolic(width, height, 1.0, focal=focal, center=center)
    # focal is -eta f here; xi = d / D and -eta = 2p / D with D^2 = d^2 + (2p)^2; we take d = 1.
    minus_eta = math.sqrt((1 - xi) * (1 + xi))
    return central_mirrors.CatadioptricHyperbolic(
        width, height, 1.0, minus_eta / xi, focal=focal / minus_eta, center=center
    )


def _entry(camera: Camera) -> dict[str, Any]:
    if isinstance(camera, central_mirrors.SphereModel):
        row, values = _MODELS["omni", "none"], _mirror_values(camera)
    elif found := fit_format(camera, _MODELS.values(), HALF_PIXEL):
        row, values = found
    else:
        known = ", ".join(dict.fromkeys(row.model for row in _MODELS.values()))
        raise ArgumentError(f"Kalibr: expected {known}, unskewed, or a central mirror, got {camera.name}")
    of_lens = row.numbers.index("cy") + 1
    model, distortion = row.name.split("-")
    return {
        "camera_model": model,
        "intrinsics": values[:of_lens],
        "distortion_model": distortion,
        "distortion_coeffs": values[of_lens:],
        "resolution": [camera.width, camera.height],
    }


def _mirror_values(camera: central_mirrors.SphereModel) -> list[float]:
    """xi, fu, fv, pu, pv of a mirror's picture."""
    if isinstance(camera, central_mirrors.CatadioptricHyperbolic) and camera.xi == 1:
        raise ArgumentError(
            "Kalibr: expected a hyperboloid whose xi differs from a paraboloid's, got one whose xi rounds "
            f"to 1: distance {camera.distance!r}, semi_latus_rectum {camera.semi_latus_rectum!r}"
        )
    focal = -camera.eta * camera.focal
    return [camera.xi, focal, -focal, *(camera.center - HALF_PIXEL).tolist()]
