"""Kalibr's ``camchain.yaml``: cameras ``cam0``, ``cam1``, ... with a model, intrinsics and a resolution.

Half pixel: Kalibr puts pixel centres at whole numbers, so its principal point is ours minus 0.5.
Carried, by Kalibr's name for them:

``pinhole-none``
    ``pinhole``, or ``scaramuzza`` with the same rays where fu and fv differ.
``pinhole-equi``
    ``kannala-brandt``. Kalibr itself reaches only rays with z > 0.
``omni-none``
    Mei's sphere model: ``x_s = X / |X|``, ``u = pu + fu x_s / (z_s + xi)``, ``v = pv + fv y_s / (z_s + xi)``.

    - ``fv = -fu < 0``, or ``fu = -fv < 0``: a picture in a mirror. ``catadioptric-planar`` (xi = 0),
      ``-hyperbolic`` (0 < xi < 1) and ``-parabolic`` (xi = 1), with ``fu = -eta focal``. Our frame
      looks at the mirror, Mei's z away from it; what turns one into the other is half a turn about x,
      ``X_mei = (x, -y, -z)``, hence the sign of fv. (About y, and fu, where that is the negative one.)
      Both positive would take a reflection of the world instead, which is no frame.
      The mirror's size is not carried, and no ray depends on it: a hyperboloid comes back with
      ``distance`` 1, a paraboloid with ``semi_latus_rectum`` 1.
      Mei's formula takes such numbers, but Kalibr's own programs refuse a negative focal length: for
      them flip the picture top to bottom, and write ``|fv|`` and ``height - 1 - pv``. The other way round,
      what they made of a mirror's picture has both positive: negate fv, and if the picture had been
      flipped top to bottom for them, turn pv back.
    - ``fu = fv > 0``: no mirror. xi = 0 is a ``pinhole`` and xi = 1 a ``fisheye-stereographic``
      of ``focal = fu / 2``; other xi are no model of ours.

Not carried: every other model, a limit ``fov_deg``, where a mirror ends (it follows from xi again). Poses,
topics and time shifts of a chain are not read and not written.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Any

import yaml

from omniscv.calibration.intrinsics import Intrinsics, lens, of_lens, of_perspective, perspective
from omniscv.calibration.parsing import field, mapping, numbers, shown, whole_number, within
from omniscv.cameras import Camera
from omniscv.cameras.fisheyes import FisheyeStereographic
from omniscv.cameras.kannala_brandt import KannalaBrandt
from omniscv.cameras.mirrors import (
    CatadioptricHyperbolic,
    CatadioptricParabolic,
    CatadioptricPlanar,
    SphereModel,
)
from omniscv.errors import ArgumentError

CENTER_SHIFT_PX = 0.5
"""Added to a principal point of Kalibr's."""

_NAME = re.compile(r"cam\d+")


def read_kalibr(text: str) -> dict[str, Camera]:
    """The cameras of a camchain, by their names ``cam0``, ``cam1``, ...; their poses are not read.

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
    """The camchain of cameras named ``cam0``, ``cam1``, ...; intrinsics only.

    Raises:
        ArgumentError: another name, or a camera that Kalibr's models cannot carry.
    """
    chain = {}
    for name, camera in cameras.items():
        if not _NAME.fullmatch(name):
            raise ArgumentError(f"name: Kalibr calls its cameras cam0, cam1, ..., got {shown(name)}")
        with within(name):
            chain[name] = _entry(camera)
    return yaml.safe_dump(chain, sort_keys=False, default_flow_style=None)


def _camera(entry: object) -> Camera:
    models = [field(entry, key) for key in ("camera_model", "distortion_model")]
    for (camera_model, distortion_model), (count, coefficients, build) in _MODELS.items():
        if models == [camera_model, distortion_model]:
            intrinsics = numbers("intrinsics", field(entry, "intrinsics"), count)
            k = numbers("distortion_coeffs", field(entry, "distortion_coeffs"), coefficients)
            intrinsics[-2:] = (value + CENTER_SHIFT_PX for value in intrinsics[-2:])
            return build(*_resolution(entry), intrinsics, k)
    known = ", ".join(map("-".join, _MODELS))
    raise ArgumentError(f"camera_model, distortion_model: expected one of {known}, got {shown(models)}")


def _resolution(entry: object) -> tuple[int, int]:
    value = field(entry, "resolution")
    if not isinstance(value, list) or len(value) != 2:
        raise ArgumentError(f"resolution: expected [width, height], got {shown(value)}")
    return whole_number("resolution[0]", value[0]), whole_number("resolution[1]", value[1])


def _pinhole(width: int, height: int, intrinsics: list[float], k: list[float]) -> Camera:
    return perspective(width, height, Intrinsics(*intrinsics))


def _lens(width: int, height: int, intrinsics: list[float], k: list[float]) -> Camera:
    return lens(width, height, Intrinsics(*intrinsics), k)


def _omni(width: int, height: int, intrinsics: list[float], k: list[float]) -> Camera:
    xi, fu, fv, *center = intrinsics
    got = f"xi = {xi:.15g}, fu = {fu:.15g}, fv = {fv:.15g}"
    if abs(fu) != abs(fv) or max(fu, fv) <= 0:
        raise ArgumentError(
            "intrinsics: expected focal lengths of one size, of which at least one is positive (our sphere "
            f"models stretch no axis), got {got}"
        )
    focal = abs(fu)
    if fu != fv:
        return _mirror(width, height, xi, focal, center)
    if xi == 0:
        return perspective(width, height, Intrinsics(focal, focal, *center))
    if xi == 1:
        return FisheyeStereographic(width, height, focal=focal / 2, center=center)
    raise ArgumentError(
        "intrinsics: expected xi = 0 or 1 where both focal lengths are positive; if the picture is a "
        f"mirror's, negate fv; got {got}"
    )


def _mirror(width: int, height: int, xi: float, minus_eta_focal: float, center: list[float]) -> SphereModel:
    if not 0 <= xi <= 1:
        raise ArgumentError(f"intrinsics: expected 0 <= xi <= 1 for a mirror's picture, got xi = {xi:.15g}")
    if xi == 0:
        return CatadioptricPlanar(width, height, focal=minus_eta_focal, center=center)
    if xi == 1:
        return CatadioptricParabolic(
            width, height, semi_latus_rectum=1.0, focal=minus_eta_focal, center=center
        )
    # xi = d / D and -eta = 2p / D with D^2 = d^2 + (2p)^2; we take d = 1.
    minus_eta = math.sqrt((1 - xi) * (1 + xi))
    return CatadioptricHyperbolic(
        width,
        height,
        distance=1.0,
        semi_latus_rectum=minus_eta / xi,
        focal=minus_eta_focal / minus_eta,
        center=center,
    )


_MODELS: dict[tuple[str, str], tuple[int, int, Callable[[int, int, list[float], list[float]], Camera]]] = {
    ("pinhole", "none"): (4, 0, _pinhole),
    ("pinhole", "equidistant"): (4, 4, _lens),
    ("omni", "none"): (5, 0, _omni),
}
"""(camera_model, distortion_model): how many intrinsics and coefficients, and the camera they make."""


def _entry(camera: Camera) -> dict[str, Any]:
    camera_model, intrinsics, distortion_model, k = _numbers_of(camera)
    intrinsics[-2:] = (value - CENTER_SHIFT_PX for value in intrinsics[-2:])
    return {
        "camera_model": camera_model,
        "intrinsics": [float(value) for value in intrinsics],
        "distortion_model": distortion_model,
        "distortion_coeffs": k,
        "resolution": [camera.width, camera.height],
    }


def _numbers_of(camera: Camera) -> tuple[str, list[float], str, list[float]]:
    """The models and their numbers, pixel centres at .5."""
    if isinstance(camera, KannalaBrandt):
        given, k = of_lens(camera)
        return "pinhole", list(given), "equidistant", k
    if isinstance(camera, FisheyeStereographic):
        return "omni", [1.0, 2 * camera.focal, 2 * camera.focal, *camera.center.tolist()], "none", []
    if isinstance(camera, SphereModel):
        if isinstance(camera, CatadioptricHyperbolic) and camera.xi == 1:
            raise ArgumentError(
                "Kalibr: expected a hyperboloid that xi tells from a paraboloid, got one whose xi rounds "
                f"to 1: distance {camera.distance:.15g}, semi_latus_rectum {camera.semi_latus_rectum:.15g}"
            )
        focal = -camera.eta * camera.focal
        return "omni", [camera.xi, focal, -focal, *camera.center.tolist()], "none", []
    straight = of_perspective(camera)
    if straight is not None:
        return "pinhole", list(straight), "none", []
    raise ArgumentError(
        "Kalibr: expected pinhole, kannala-brandt, fisheye-stereographic or a central mirror, got "
        f"{camera.name}"
    )
