"""Kalibr's ``camchain.yaml``: cameras ``cam0``, ``cam1``, ... with models, intrinsics, resolutions, poses.

Half pixel: Kalibr puts pixel centres at whole numbers, so its principal point is ours minus 0.5. Carried:

``pinhole-none``, ``pinhole-radtan``
    ``pinhole``, with k1, k2, p1, p2.
``pinhole-equidistant``
    ``kannala-brandt``, and ``fisheye-equidistant`` without the circle in which it ends. Kalibr itself reaches
    only rays with z > 0.
``omni-none``, ``omni-radtan``
    ``unified``, Mei's sphere model: ``u = pu + fu x_s / (z_s + xi)``, ``v = pv + fv y_s / (z_s + xi)`` of the
    unit direction x_s; and ``fisheye-stereographic``, whose xi is 1, without the circle in which it ends.
    ``omni-none`` with ``fv = -fu < 0``, or ``fu = -fv < 0``, is the picture of a mirror:
    ``catadioptric-planar`` (xi = 0), ``-hyperbolic`` (0 < xi < 1) and ``-parabolic`` (xi = 1), with
    ``fu = -eta focal``. Our frame looks at the mirror, Mei's z away from it: half a turn about x,
    ``X_mei = (x, -y, -z)``, hence the sign of fv (about y, and fu, where that is the negative one).
    Kalibr's own programs refuse negative focal lengths: see docs/calibration.md. The mirror's size is not
    carried, and no ray depends on it: hyperboloids are read with ``distance`` 1, paraboloids with
    ``semi_latus_rectum`` 1.
``eucm-none``, ``ds-none``
    ``extended-unified`` and ``double-sphere``.

Rigs: a chain has each camera's pose relative to the one before it, ``T_cn_cnm1``, and ``timeshift_cam_imu``,
which is our time offset: the time at which an image was taken, in the IMU's time, minus its stamp. The first
camera is the rig's frame: see :meth:`Rig.seen_from`. ``T_cam_imu`` is ignored.

Not carried: every other model (of Kalibr's own, ``pinhole-fov``), skew, a limit ``fov_deg``, where a mirror
ends, topics.

Source: Kalibr, ``kalibr_common/ConfigReader.py``.
"""

import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import yaml

from omniscv.arguments import number, numbers, one_of, shown, within
from omniscv.calibration import intrinsics
from omniscv.calibration.intrinsics import HALF_PIXEL
from omniscv.cameras import Camera, CatadioptricHyperbolic, CatadioptricParabolic, CatadioptricPlanar
from omniscv.cameras.central_mirrors import SphereModel
from omniscv.cameras.rig import Rig, RigCamera
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.records import checked, mapping, record

_MODELS = intrinsics.format_models("""
pinhole-none        pinhole          fx fy cx cy
pinhole-radtan      pinhole          fx fy cx cy k1 k2 p1 p2
pinhole-equidistant kannala-brandt   fx fy cx cy k1 k2 k3 k4
omni-none           unified          xi fx fy cx cy
omni-radtan         unified          xi fx fy cx cy k1 k2 p1 p2
eucm-none           extended-unified alpha beta fx fy cx cy
ds-none             double-sphere    xi alpha fx fy cx cy
""")
"""``camera_model-distortion_model``: our model; its intrinsics, then its coefficients, in Kalibr's order."""

_NAME = re.compile(r"cam\d+")


@record
class _Entry:
    """A camera of a chain; the numbers are checked once the model is known."""

    camera_model: Any
    distortion_model: Any
    intrinsics: Any
    distortion_coeffs: Any
    resolution: tuple[int, int] = checked(intrinsics.image_size)


def read_kalibr(text: str) -> dict[str, Camera]:
    """Return the cameras of a chain by their names ``cam0``, ``cam1``, ...; their poses are ignored."""
    return {name: _camera(name, entry) for name, entry in _entries(text).items()}


def write_kalibr(cameras: Mapping[str, Camera]) -> str:
    """Return the chain of cameras named ``cam0``, ``cam1``, ...; intrinsics only."""
    return _dump({name: _entry(name, camera) for name, camera in cameras.items()})


def rig_from_kalibr(text: str) -> Rig:
    """Return the rig of a chain ``cam0``, ``cam1``, ... in the frame of ``cam0``."""
    entries = _entries(text)
    cameras = {name: _camera(name, entry) for name, entry in entries.items()}
    names = [f"cam{i}" for i in range(len(cameras))]
    if sorted(cameras) != sorted(names):
        raise ArgumentError(f"expected a chain {', '.join(names)}, got {shown(sorted(cameras))}")
    mounted: dict[str, RigCamera] = {}
    T_0_n = Pose(np.zeros(3), np.eye(3))
    for name in names:
        entry = entries[name]
        if mounted:
            if "T_cn_cnm1" not in entry:
                raise ArgumentError(f"{name}: missing key 'T_cn_cnm1', the pose in a chain")
            matrix = numbers(f"{name}.T_cn_cnm1", entry["T_cn_cnm1"], (4, 4))
            if matrix[3].tolist() != [0, 0, 0, 1]:
                wanted = "expected a last row [0, 0, 0, 1]"
                raise ArgumentError(f"{name}.T_cn_cnm1: {wanted}, got {shown(matrix[3])}")
            with within(f"{name}.T_cn_cnm1"):
                T_0_n = T_0_n @ Pose(matrix[:3, 3], matrix[:3, :3]).inverse()
        shift = number(f"{name}.timeshift_cam_imu", entry.get("timeshift_cam_imu", 0.0))
        mounted[name] = RigCamera(cameras[name], T_0_n, shift)
    return Rig(mounted)


def rig_to_kalibr(rig: Rig) -> str:
    """Return the chain of a rig whose cameras are named ``cam0``, ``cam1``, ... in this order."""
    if list(rig.cameras) != [f"cam{i}" for i in range(len(rig.cameras))]:
        raise ArgumentError(
            f"Kalibr: expected cameras cam0, cam1, ... in order, got {shown(list(rig.cameras))}"
        )
    intrinsics.check_first_is_origin(rig, "Kalibr")
    shifted = any(mounted.time_offset for mounted in rig.cameras.values())
    chain = {}
    previous: Pose | None = None
    for name, mounted in rig.cameras.items():
        chain[name] = entry = _entry(name, mounted.camera)
        if previous is not None:
            T_n_m = mounted.pose.inverse() @ previous
            rows = np.column_stack([T_n_m.rotation, T_n_m.position]).tolist()
            entry["T_cn_cnm1"] = [*rows, [0.0, 0.0, 0.0, 1.0]]
        if shifted:
            entry["timeshift_cam_imu"] = mounted.time_offset
        previous = mounted.pose
    return _dump(chain)


def _entries(text: str) -> dict[str, dict[str, Any]]:
    """Return the entries of a chain that are cameras."""
    chain = intrinsics.parse_mapping(text)
    entries = {name: mapping(name, entry) for name, entry in chain.items() if _NAME.fullmatch(name)}
    if not entries:
        raise ArgumentError(f"expected cameras cam0, cam1, ..., got {shown(list(chain))}")
    return entries


def _dump(chain: dict[str, Any]) -> str:
    return yaml.safe_dump(chain, sort_keys=False, default_flow_style=None)


def _camera(name: str, entry: dict[str, Any]) -> Camera:
    data = intrinsics.read_known(_Entry, entry, name)
    with within(name):
        model = one_of(
            "camera_model-distortion_model", f"{data.camera_model}-{data.distortion_model}", _MODELS
        )
        row = _MODELS[model]
        split = row.numbers.index("cy") + 1
        lens = numbers("intrinsics", data.intrinsics, (split,)).tolist()
        terms = numbers("distortion_coeffs", data.distortion_coeffs, (len(row.numbers) - split,)).tolist()
        values = intrinsics.read_numbers(row, [*lens, *terms], HALF_PIXEL)
        width, height = data.resolution
        if row.name == "omni-none" and min(values["fx"], values["fy"]) < 0:
            return _mirror(width, height, **values)
        return intrinsics.camera_of(row.model, width, height, values)


def _mirror(width: int, height: int, xi: float, fx: float, fy: float, cx: float, cy: float) -> Camera:
    if fx != -fy or not 0 <= xi <= 1:
        raise ArgumentError(
            "intrinsics: expected fu = -fv and 0 <= xi <= 1 for a mirror's picture, got "
            f"xi = {xi:.15g}, fu = {fx:.15g}, fv = {fy:.15g}"
        )
    focal, center = abs(fx), (cx, cy)
    if xi == 0:
        return CatadioptricPlanar(width, height, focal=focal, center=center)
    if xi == 1:
        return CatadioptricParabolic(width, height, 1.0, focal=focal, center=center)
    # focal is -eta f here; xi = d / D and -eta = 2p / D with D^2 = d^2 + (2p)^2; we take d = 1.
    minus_eta = math.sqrt((1 - xi) * (1 + xi))
    return CatadioptricHyperbolic(width, height, 1.0, minus_eta / xi, focal=focal / minus_eta, center=center)


def _entry(name: str, camera: Camera) -> dict[str, Any]:
    if not _NAME.fullmatch(name):
        raise ArgumentError(f"name: expected cam0, cam1, ..., got {shown(name)}")
    known = ", ".join(dict.fromkeys(row.model for row in _MODELS.values()))
    expected = f"Kalibr: expected {known}, unskewed, or a central mirror"
    with within(name):
        if isinstance(camera, SphereModel):
            row, values = _MODELS["omni-none"], _mirror_values(camera)
        else:
            row, values = intrinsics.write_numbers(camera, _MODELS.values(), HALF_PIXEL, expected)
    split = row.numbers.index("cy") + 1
    model, distortion = row.name.split("-")
    return {
        "camera_model": model,
        "intrinsics": values[:split],
        "distortion_model": distortion,
        "distortion_coeffs": values[split:],
        "resolution": [camera.width, camera.height],
    }


def _mirror_values(camera: SphereModel) -> list[float]:
    """Return xi, fu, fv, pu, pv of a mirror's picture."""
    if isinstance(camera, CatadioptricHyperbolic) and camera.xi == 1:
        raise ArgumentError(
            "Kalibr: expected a hyperboloid whose xi differs from a paraboloid's, got one whose xi rounds "
            f"to 1: distance {camera.distance!r}, semi_latus_rectum {camera.semi_latus_rectum!r}"
        )
    focal = -camera.eta * camera.focal
    return [camera.xi, focal, -focal, *(camera.center - HALF_PIXEL).tolist()]
