"""Rigs in files: ours as JSON, Kalibr's chain, COLMAP's ``cameras.txt`` and ``rigs.txt``, Aria's devices.

Kalibr's chain has each camera's pose against the one before it, ``T_cn_cnm1``, and its ``timeshift_cam_imu``:
what its images were taken at, in the IMU's time, less their stamps; that is our time offset. COLMAP has poses
of sensors in the rig, and no times. In both the first camera is the rig's frame: see :meth:`Rig.seen_from`.
Kalibr's ``T_cam_imu`` is not read: a rig's pose is its first camera's, not the IMU's.
"""

import json
from os import PathLike
from pathlib import Path
from typing import Literal

import numpy as np
import yaml

from omniscv.arguments import number, numbers, one_of, shown, within
from omniscv.calibration import aria, colmap, kalibr
from omniscv.calibration.common import field, mapping, whole_number
from omniscv.cameras.rig import Rig, RigCamera
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.storage import bounded

RigFormat = Literal["json", "kalibr", "colmap", "aria"]


def load_rig(path: str | PathLike[str]) -> Rig:
    """Return the rig of a file: JSON (or YAML) as :meth:`Rig.to_dict` gives it, a chain of Kalibr, or a
    folder with COLMAP's ``cameras.txt`` and ``rigs.txt``; or the calibration of an Aria device.

    Raises:
        ArgumentError: the file cannot be read or is none of these; the message starts with the path.
    """
    path = Path(path)
    with within(path):
        if path.is_dir():
            return rig_from_colmap(*(bounded.read_text(path / name) for name in _COLMAP_FILES))
        text = bounded.read_text(path)
        data = mapping(text)
        if "CameraCalibrations" in data:
            return aria.rig_from_aria(text)
        return Rig.from_dict(data) if "cameras" in data else rig_from_kalibr(text)


def save_rig(path: str | PathLike[str], rig: Rig, format: RigFormat) -> None:
    """Write a rig: a file, or for ``colmap`` two files in a folder that is made if it is not there.

    Raises:
        ArgumentError: an unknown format, a rig that it cannot carry, or a file that cannot be written.
    """
    path = Path(path)
    with within(path):
        if one_of("format", format, (*_WRITERS, "colmap")) == "colmap":
            texts = dict(zip((path / name for name in _COLMAP_FILES), rig_to_colmap(rig), strict=True))
        else:
            texts = {path: _WRITERS[format](rig)}
        try:
            for file, text in texts.items():
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_text(text, encoding="utf-8")
        except OSError as cause:
            raise ArgumentError(f"expected a file that can be written, got {cause}") from cause


# -- Kalibr --------------------------------------------------------------------------------------------


def rig_from_kalibr(text: str) -> Rig:
    """Return the rig of a chain ``cam0``, ``cam1``, ... in the frame of ``cam0``.

    Raises:
        ArgumentError: as :func:`omniscv.calibration.read_kalibr`, or a camera after ``cam0`` without a pose.
    """
    cameras, chain = kalibr.read_kalibr(text), mapping(text)
    names = [f"cam{i}" for i in range(len(cameras))]
    if sorted(cameras) != sorted(names):
        raise ArgumentError(f"expected a chain {', '.join(names)}, got {shown(sorted(cameras))}")
    found: dict[str, RigCamera] = {}
    T_0_n = Pose(np.zeros(3), np.eye(3))
    for name in names:
        with within(name):
            if found:
                T_0_n = T_0_n @ _rigid("T_cn_cnm1", field(chain[name], "T_cn_cnm1")).inverse()
            shift = number("timeshift_cam_imu", chain[name].get("timeshift_cam_imu", 0.0))
            found[name] = RigCamera(cameras[name], T_0_n, shift)
    return Rig(found)


def rig_to_kalibr(rig: Rig) -> str:
    """Return the chain of a rig whose cameras are named ``cam0``, ``cam1``, ... in this order.

    Raises:
        ArgumentError: other names, a first camera that is not the rig's frame, or as
            :func:`omniscv.calibration.write_kalibr`.
    """
    if list(rig.cameras) != [f"cam{i}" for i in range(len(rig.cameras))]:
        raise ArgumentError(
            f"Kalibr: expected cameras cam0, cam1, ... in order, got {shown(list(rig.cameras))}"
        )
    _check_reference(rig, "Kalibr")
    chain = yaml.safe_load(kalibr.write_kalibr({name: each.camera for name, each in rig.cameras.items()}))
    shifted = any(each.time_offset for each in rig.cameras.values())
    before: Pose | None = None
    for name, mounted in rig.cameras.items():
        if before is not None:
            T_n_m = mounted.pose.inverse() @ before
            rows = np.column_stack([T_n_m.rotation, T_n_m.position]).tolist()
            chain[name]["T_cn_cnm1"] = [*rows, [0.0, 0.0, 0.0, 1.0]]
        if shifted:
            chain[name]["timeshift_cam_imu"] = mounted.time_offset
        before = mounted.pose
    return yaml.safe_dump(chain, sort_keys=False, default_flow_style=None)


def _rigid(name: str, value: object) -> Pose:
    matrix = numbers(name, value, (4, 4))
    if matrix[3].tolist() != [0, 0, 0, 1]:
        raise ArgumentError(f"{name}: expected a last row [0, 0, 0, 1], got {shown(matrix[3])}")
    with within(name):
        return Pose(matrix[:3, 3], matrix[:3, :3])


# -- COLMAP --------------------------------------------------------------------------------------------

_COLMAP_FILES = ("cameras.txt", "rigs.txt")


def rig_from_colmap(cameras: str, rigs: str) -> Rig:
    """Return the rig of a ``cameras.txt`` and a ``rigs.txt`` with one rig, in the frame of its reference.

    Raises:
        ArgumentError: another number of rigs, a sensor that is no camera or has no pose, a line that does
            not follow the format, or as :func:`omniscv.calibration.read_colmap`.
    """
    known = colmap.read_colmap(cameras)
    lines = [words for line in rigs.splitlines() if (words := line.partition("#")[0].split())]
    if len(lines) != 1 or len(lines[0]) < 4:
        raise ArgumentError(
            f"rigs.txt: expected one line 'RIG_ID NUM_SENSORS CAMERA ID ...', got {shown(lines)}"
        )
    _, count, *words = lines[0]
    found: dict[str, RigCamera] = {}
    while words:
        (kind, name), words = words[:2], words[2:]
        pose = Pose(np.zeros(3), np.eye(3))
        with within(f"rigs.txt: sensor {name}"):
            if kind != "CAMERA" or name not in known or name in found:
                raise ArgumentError(f"expected each sensor a CAMERA of cameras.txt, got {shown(kind)}")
            if found:
                if words[:1] != ["1"]:
                    raise ArgumentError(f"expected HAS_POSE 1, got {shown(words[:1])}")
                pose, words = colmap.pose_of(words[1:8]), words[8:]
            found[name] = RigCamera(known[name], pose)
    if len(found) != whole_number("NUM_SENSORS", count):
        raise ArgumentError(f"rigs.txt: NUM_SENSORS: expected {len(found)}, the sensors there, got {count}")
    return Rig(found)


def rig_to_colmap(rig: Rig) -> tuple[str, str]:
    """Return ``cameras.txt`` and ``rigs.txt`` of a rig whose cameras are named by whole numbers, their ids.

    Raises:
        ArgumentError: other names, a first camera that is not the rig's frame, time offsets, or as
            :func:`omniscv.calibration.write_colmap`.
    """
    _check_reference(rig, "COLMAP")
    if late := next((name for name, each in rig.cameras.items() if each.time_offset), None):
        got = rig.cameras[late].time_offset
        raise ArgumentError(f"{late}: time_offset: expected 0, as COLMAP carries none, got {got:.15g}")
    cameras = colmap.write_colmap({name: each.camera for name, each in rig.cameras.items()})
    return cameras, colmap.rig_line(1, {int(name): each.pose for name, each in rig.cameras.items()}) + "\n"


def _check_reference(rig: Rig, program: str) -> None:
    name, first = next(iter(rig.cameras.items()))
    off = max(np.abs(first.pose.position).max(), np.abs(first.pose.rotation - np.eye(3)).max())
    if off > 1e-12:
        raise ArgumentError(
            f"{program}: expected a rig in the frame of its first camera, got one elsewhere; save "
            f"rig.seen_from({name!r})"
        )


_WRITERS = {
    "json": lambda rig: json.dumps(rig.to_dict(), indent=1),
    "kalibr": rig_to_kalibr,
    "aria": aria.rig_to_aria,
}
