"""Kalibr's ``camchain.yaml``: cameras ``cam0``, ``cam1``, ... with models, intrinsics, resolutions, poses.

Rigs: a chain has each camera's pose relative to the one before it, ``T_cn_cnm1``, or relative to the IMU,
``T_cam_imu`` or ``T_imu_cam`` (OpenVINS); ``timeshift_cam_imu`` is our time offset: the time at which an
image was taken, in the IMU's time, minus its stamp. The first camera is the rig's frame: see
:meth:`Rig.seen_from`. A line delay is a rolling shutter.

Source: Kalibr, ``kalibr_common/ConfigReader.py``.
"""

import re
from collections.abc import Mapping
from dataclasses import replace

from omniscv.arguments import shown, within
from omniscv.calibration.documents import Content
from omniscv.calibration.forms import (
    Entry,
    Form,
    Layout,
    PoseMatrix,
    Readout,
    TimeOffset,
    Writing,
    matrix_of_pose,
    pose_of_matrix,
)
from omniscv.calibration.intrinsics import check_first_is_origin
from omniscv.calibration.keys import (
    FISHEYE4,
    MATRIX,
    RADTAN4,
    RADTAN5,
    Key,
    Model,
    ModelName,
    Number,
    Word,
    array,
)
from omniscv.calibration.nodes import Node, Values
from omniscv.calibration.table import distortion
from omniscv.cameras.rig import ORIGIN, RigCamera
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose

_COEFFICIENTS = ("distortion_coeffs", "distortion_coefficients")


class Kalibr(Form):
    """Kalibr's form, in which each camera's pose is relative to the camera before."""

    def read(self, content: Content, size: tuple[int, int] | None = None) -> dict[str, Entry]:
        """Return the cameras of a file by name, with their poses in the frame of ``cam0``.

        Args:
            content: the file.
            size: width and height of the images, px, where the file does not hold them.
        """
        entries = super().read(content, size)
        poses = self._in_first(entries, self.nodes(content))
        for name, entry in entries.items():
            entries[name] = entry._replace(pose=poses.get(name))
        return entries

    @staticmethod
    def _in_first(entries: Mapping[str, Entry], nodes: Mapping[str, Node]) -> dict[str, Pose]:
        """Return poses in the frame of ``cam0`` by name: along the chain, else by the body that has both."""
        poses = {"cam0": ORIGIN}
        if "cam0" not in nodes:
            return poses
        T_body_0 = entries["cam0"].pose
        for i in range(1, len(nodes) + 1):
            name = f"cam{i}"
            if name not in nodes:
                continue
            T_0_before = poses.get(f"cam{i - 1}")
            T_body_n = entries[name].pose
            if T_0_before is not None and nodes[name].has("T_cn_cnm1"):
                with within(f"{name}.T_cn_cnm1"):
                    poses[name] = T_0_before @ pose_of_matrix(nodes[name].take("T_cn_cnm1")).inverse()
            elif T_body_0 is not None and T_body_n is not None:
                poses[name] = T_body_0.inverse() @ T_body_n
        return poses

    def on_body(self, content: Content) -> dict[str, Entry]:
        """Return the cameras of a file by name, with their poses on the IMU."""
        return super().read(content)

    def write(self, cameras: Mapping[str, RigCamera], *, rig: bool = False, suffix: str = "") -> str:
        """Return the text of a chain.

        Args:
            cameras: by the names ``cam0``, ``cam1``, ...; in this order where they are a rig.
            rig: whether poses and time offsets are written, of a rig in the frame of its first camera.
            suffix: of the file's name, which does not matter.
        """
        if rig:
            is_named = list(cameras) == [f"cam{i}" for i in range(len(cameras))]
        else:
            is_named = all(re.fullmatch(r"cam\d+", name) for name in cameras)
        if not is_named:
            raise ArgumentError(f"name: expected cam0, cam1, ... in order, got {shown(list(cameras))}")
        if rig:
            check_first_is_origin(cameras, "Kalibr")
        return super().write(cameras, rig=rig)


def _chain(cameras: dict[str, Values]) -> Values:
    """Replace poses in the rig's frame by those relative to the camera before."""
    previous: Pose | None = None
    for values in cameras.values():
        matrix = values.pop("T_cam_imu", None)
        if matrix is None:
            continue
        T_cam_rig = pose_of_matrix(matrix)
        if previous is not None:
            values["T_cn_cnm1"] = matrix_of_pose(T_cam_rig @ previous)
        previous = T_cam_rig.inverse()
    return dict(cameras)


_NO_DISTORTION = array(_COEFFICIENTS, 0, 0, 0, 0, counts=(0, 4))
_RADTAN: tuple[Word, ...] = (("pinhole", "radtan"), ("none", "radtan"))


def _model(
    name: ModelName, words: tuple[Word, ...], intrinsics: tuple[Number, ...], coefficients: Key
) -> Model:
    """Return a model by our name, Kalibr's words, the numbers of its intrinsics, and the key of the
    others."""
    return Model(name, (array("intrinsics", *intrinsics), coefficients), words)


def _coefficients(*numbers: Number) -> Key:
    """Return the key of coefficients that are all there."""
    return array(_COEFFICIENTS, *numbers)


KALIBR = Kalibr(
    "kalibr",
    "Kalibr, OpenVINS, TUM-VI",
    marks=(("camera_model", "resolution"), "distortion_coeffs", "intrinsics"),
    layout=Layout(
        models=(
            _model("pinhole", (("pinhole", "none"),), MATRIX, _NO_DISTORTION),
            _model(
                "pinhole",
                _RADTAN,
                MATRIX,
                array(_COEFFICIENTS, *RADTAN5, counts=(4, 5)),
            ),
            replace(_model("pinhole", _RADTAN, MATRIX, distortion(_COEFFICIENTS)), read_only=True),
            _model(
                "kannala-brandt",
                (("pinhole", "equidistant"), ("none", "equidistant")),
                MATRIX,
                _coefficients(*FISHEYE4),
            ),
            _model("field-of-view", (("pinhole", "fov"),), MATRIX, _coefficients("omega")),
            _model("unified", (("omni", "none"),), ("xi", *MATRIX), _NO_DISTORTION),
            _model(
                "unified",
                (("omni", "radtan"),),
                ("xi", *MATRIX),
                _coefficients(*RADTAN4),
            ),
            _model("extended-unified", (("eucm", "none"),), ("alpha", "beta", *MATRIX), _NO_DISTORTION),
            _model("double-sphere", (("ds", "none"),), ("xi", "alpha", *MATRIX), _NO_DISTORTION),
        ),
        word=("camera_model", "distortion_model"),
        size=("resolution",),
        poses=(PoseMatrix("T_cam_imu", "T_c_b"), PoseMatrix("T_imu_cam", "T_b_c")),
        time=TimeOffset("timeshift_cam_imu"),
        readouts=(
            Readout("line_delay_nanoseconds", 1e-9, is_of_line=True),
            Readout("line_delay", is_of_line=True),
        ),
        harmless="^t_cn_cnm1$",
    ),
    writing=Writing(join=_chain, label="cam{0}", from_first=True),
)
