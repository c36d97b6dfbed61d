"""Kalibr's ``camchain.yaml``: cameras ``cam0``, ``cam1``, ... with a model, intrinsics and a resolution.

Half pixel: Kalibr puts pixel centres at whole numbers, so its principal point is ours minus 0.5. Carried:

``pinhole-none``
    ``pinhole``, or ``scaramuzza`` with the same rays where fu and fv differ.
``pinhole-equi``
    ``kannala-brandt``. Kalibr itself reaches only rays with z > 0.
``omni-none``
    Mei's sphere model: ``x_s = X / |X|``, ``u = pu + fu x_s / (z_s + xi)``, ``v = pv + fv y_s / (z_s + xi)``.

    - ``fv = -fu < 0``, or ``fu = -fv < 0``: a picture in a mirror. ``catadioptric-planar`` (xi = 0),
      ``-hyperbolic`` (0 < xi < 1) and ``-parabolic`` (xi = 1), with ``fu = -eta focal``. Our frame
      looks at the mirror, Mei's z away from it: half a turn about x, ``X_mei = (x, -y, -z)``, hence the
      sign of fv (about y, and fu, where that is the negative one). docs/calibration.md: files of Kalibr's
      own programs, which refuse negative focal lengths.
      The mirror's size is not carried, and no ray depends on it: a hyperboloid comes back with
      ``distance`` 1, a paraboloid with ``semi_latus_rectum`` 1.
    - ``fu = fv > 0``: no mirror. xi = 0 is a ``pinhole`` and xi = 1 a ``fisheye-stereographic``
      of ``focal = fu / 2``; other xi are no model of ours.

Not carried: every other model, a limit ``fov_deg``, where a mirror ends, poses, topics, time shifts.
"""

import math
import re
from collections.abc import Mapping
from typing import Any

import yaml

from omniscv.arguments import numbers, shown, within
from omniscv.calibration.common import (
    HALF_PIXEL,
    camera_of,
    field,
    intrinsics_of,
    mapping,
    whole_number,
)
from omniscv.cameras import Camera, FisheyeStereographic, mirrors
from omniscv.errors import ArgumentError

_MODELS = {("pinhole", "none"): (4, 0), ("pinhole", "equidistant"): (4, 4), ("omni", "none"): (5, 0)}
"""(camera_model, distortion_model): how many intrinsics and coefficients they have."""

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
    intrinsics, k = (
        numbers(key, field(entry, key), (count,)).tolist()
        for key, count in zip(("intrinsics", "distortion_coeffs"), _MODELS[model], strict=True)
    )
    resolution = field(entry, "resolution")
    if not isinstance(resolution, list) or len(resolution) != 2:
        raise ArgumentError(f"resolution: expected [width, height], got {shown(resolution)}")
    width, height = (whole_number(f"resolution[{i}]", size) for i, size in enumerate(resolution))
    if model[0] == "omni":
        return _omni(width, height, *intrinsics)
    return camera_of(width, height, intrinsics + k, HALF_PIXEL)


def _omni(width: int, height: int, xi: float, fu: float, fv: float, pu: float, pv: float) -> Camera:
    got = f"xi = {xi:.15g}, fu = {fu:.15g}, fv = {fv:.15g}"
    if abs(fu) != abs(fv) or max(fu, fv) <= 0:
        raise ArgumentError(
            "intrinsics: expected focal lengths of one size, of which at least one is positive (our sphere "
            f"models stretch no axis), got {got}"
        )
    focal, center = abs(fu), (pu + HALF_PIXEL, pv + HALF_PIXEL)
    if fu == fv:
        if xi == 0:
            return camera_of(width, height, (focal, focal, *center))
        if xi == 1:
            return FisheyeStereographic(width, height, focal=focal / 2, center=center)
        raise ArgumentError(
            "intrinsics: expected xi = 0 or 1 where both focal lengths are positive; if the picture is a "
            f"mirror's, negate fv; got {got}"
        )
    if not 0 <= xi <= 1:
        raise ArgumentError(f"intrinsics: expected 0 <= xi <= 1 for a mirror's picture, got xi = {xi:.15g}")
    if xi == 0:
        return mirrors.CatadioptricPlanar(width, height, focal=focal, center=center)
    if xi == 1:
        return mirrors.CatadioptricParabolic(width, height, 1.0, focal=focal, center=center)
    # focal is -eta f here; xi = d / D and -eta = 2p / D with D^2 = d^2 + (2p)^2; we take d = 1.
    minus_eta = math.sqrt((1 - xi) * (1 + xi))
    return mirrors.CatadioptricHyperbolic(
        width, height, 1.0, minus_eta / xi, focal=focal / minus_eta, center=center
    )


def _entry(camera: Camera) -> dict[str, Any]:
    intrinsics, k = _sphere_intrinsics(camera), []
    if intrinsics is None and (found := intrinsics_of(camera, HALF_PIXEL)):
        intrinsics, k = found[:4], found[4:]
    if intrinsics is None:
        raise ArgumentError(
            "Kalibr: expected pinhole, kannala-brandt, fisheye-stereographic or a central mirror, got "
            f"{camera.name}"
        )
    return {
        "camera_model": "omni" if len(intrinsics) == 5 else "pinhole",
        "intrinsics": intrinsics,
        "distortion_model": "equidistant" if k else "none",
        "distortion_coeffs": k,
        "resolution": [camera.width, camera.height],
    }


def _sphere_intrinsics(camera: Camera) -> list[float] | None:
    """xi, fu, fv, pu, pv of a camera that Mei's model describes; None for another one."""
    center = (camera.center - HALF_PIXEL).tolist()
    if isinstance(camera, FisheyeStereographic):
        return [1.0, 2 * camera.focal, 2 * camera.focal, *center]
    if not isinstance(camera, mirrors.SphereModel):
        return None
    if isinstance(camera, mirrors.CatadioptricHyperbolic) and camera.xi == 1:
        raise ArgumentError(
            "Kalibr: expected a hyperboloid whose xi differs from a paraboloid's, got one whose xi rounds "
            f"to 1: distance {camera.distance!r}, semi_latus_rectum {camera.semi_latus_rectum!r}"
        )
    focal = -camera.eta * camera.focal
    return [camera.xi, focal, -focal, *center]
