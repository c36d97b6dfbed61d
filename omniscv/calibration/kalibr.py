"""Kalibr's ``camchain.yaml``: cameras ``cam0``, ``cam1``, ... with models, intrinsics, resolutions, poses.

Rigs: a chain has each camera's pose relative to the one before it, ``T_cn_cnm1``, or relative to the IMU,
``T_cam_imu`` or ``T_imu_cam`` (OpenVINS); ``timeshift_cam_imu`` is our time offset: the time at which an
image was taken, in the IMU's time, minus its stamp. The first camera is the rig's frame: see
:meth:`Rig.seen_from`. A line delay is a rolling shutter.

Source: Kalibr, ``kalibr_common/ConfigReader.py``.
"""

import re
from collections.abc import Mapping

from omniscv.arguments import shown, within
from omniscv.calibration.documents import Content
from omniscv.calibration.forms import Entry, Form, matrix_of_pose, pose_of_matrix
from omniscv.calibration.intrinsics import check_first_is_origin
from omniscv.calibration.nodes import Values
from omniscv.calibration.table import PLAIN
from omniscv.cameras.rig import ORIGIN, RigCamera
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose

_COEFFICIENTS = "distortion_coeffs|distortion_coefficients"


class Kalibr(Form):
    """The row of Kalibr, with what no row says: chains."""

    def read(self, content: Content, size: tuple[int, int] | None = None) -> dict[str, Entry]:
        entries = super().read(content, size)
        nodes = self.nodes(content)
        of_body = {name: entry.pose for name, entry in entries.items()}
        first = "cam0"
        poses = {"cam0": ORIGIN}
        for i in range(1, len(nodes) + 1 if first in nodes else 0):
            name = f"cam{i}"
            before = poses.get(f"cam{i - 1}")
            T_body_0 = of_body[first]
            if name not in nodes:
                continue
            if before is not None and nodes[name].has("T_cn_cnm1"):
                with within(f"{name}.T_cn_cnm1"):
                    poses[name] = before @ pose_of_matrix(nodes[name].take("T_cn_cnm1")).inverse()
            elif T_body_0 is not None and (T_body_n := of_body[name]) is not None:
                poses[name] = T_body_0.inverse() @ T_body_n
        return {name: entry._replace(pose=poses.get(name)) for name, entry in entries.items()}

    def on_body(self, content: Content) -> dict[str, Entry]:
        return super().read(content)

    def write(self, cameras: Mapping[str, RigCamera], *, rig: bool = False, suffix: str = "") -> str:
        in_order = [f"cam{i}" for i in range(len(cameras))]
        if list(cameras) != in_order if rig else not all(re.fullmatch(r"cam\d+", name) for name in cameras):
            raise ArgumentError(f"name: expected cam0, cam1, ... in order, got {shown(list(cameras))}")
        if rig:
            check_first_is_origin(cameras, "Kalibr")
        return super().write(cameras, rig=rig)


def _chain(cameras: dict[str, Values]) -> Values:
    """Replace poses in the rig's frame by those relative to the camera before."""
    previous: Pose | None = None
    for values in cameras.values():
        if (matrix := values.pop("T_cam_imu", None)) is None:
            continue
        T_cam_rig = pose_of_matrix(matrix)
        if previous is not None:
            values["T_cn_cnm1"] = matrix_of_pose(T_cam_rig @ previous)
        previous = T_cam_rig.inverse()
    return dict(cameras)


KALIBR = Kalibr(
    "kalibr",
    "Kalibr, OpenVINS, TUM-VI",
    "camera_model|resolution distortion_coeffs intrinsics",
    f"""
    pinhole+none pinhole intrinsics=fx,fy,cx,cy {_COEFFICIENTS}=;0,0,0,0
    pinhole+radtan|none+radtan pinhole intrinsics=fx,fy,cx,cy {_COEFFICIENTS}=k1,k2,p1,p2;k3
    < pinhole+radtan|none+radtan pinhole intrinsics=fx,fy,cx,cy {_COEFFICIENTS}={PLAIN}
    pinhole+equidistant|none+equidistant kannala-brandt intrinsics=fx,fy,cx,cy {_COEFFICIENTS}=k1,k2,k3,k4
    pinhole+fov field-of-view intrinsics=fx,fy,cx,cy {_COEFFICIENTS}=omega;
    omni+none unified intrinsics=xi,fx,fy,cx,cy {_COEFFICIENTS}=;0,0,0,0
    omni+radtan unified intrinsics=xi,fx,fy,cx,cy {_COEFFICIENTS}=k1,k2,p1,p2
    eucm+none extended-unified intrinsics=alpha,beta,fx,fy,cx,cy {_COEFFICIENTS}=;0,0,0,0
    ds+none double-sphere intrinsics=xi,alpha,fx,fy,cx,cy {_COEFFICIENTS}=;0,0,0,0
    """,
    word="camera_model distortion_model",
    size="resolution",
    poses=(("T_cam_imu", "T_c_b"), ("T_imu_cam", "T_b_c")),
    time=("timeshift_cam_imu", 1.0),
    readout=(("line_delay_nanoseconds", 1e-9, True), ("line_delay", 1.0, True)),
    join=_chain,
    label="cam{0}",
    from_first=True,
    harmless="^t_cn_cnm1$",
)
