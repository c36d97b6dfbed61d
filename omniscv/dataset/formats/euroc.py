"""EuRoC's folder ``mav0``, also called the ASL format: images of a rig, its IMU, and the true state.

::

    mav0/body.yaml
    mav0/cam0/{data.csv, sensor.yaml, data/NANOSECONDS.png}     cam1, ... in the order of their names
    mav0/imu0/{data.csv, sensor.yaml}
    mav0/state_groundtruth_estimate0/{data.csv, sensor.yaml}    at the IMU's times

The body ``B`` is the IMU. ``T_BS`` in a ``sensor.yaml`` is the pose of the sensor on it. Images are stamped
with the time at which they show the world, so a camera's time offset is in its stamps. The models and numbers
of cameras are Kalibr's (:mod:`omniscv.calibration.kalibr`), pixel centres at whole numbers; EuRoC's own is
``pinhole`` with ``radial-tangential``. ``cameras.txt`` has the dataset's name of each camera.
"""

from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from omniscv.calibration.kalibr import KALIBR
from omniscv.cameras import Camera
from omniscv.cameras.rig import RigCamera
from omniscv.dataset.exporting import Format, register
from omniscv.dataset.formats.kalibr import Kalibr
from omniscv.dataset.pictures import write_color
from omniscv.dataset.sequences import by_camera
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.geometry import Pose
from omniscv.records import NoOptions
from omniscv.sensor.imu import ImuSamples, ImuTrack
from omniscv.storage.local import write_text

_DISTORTION = {"radtan": "radial-tangential"}
_IMU = "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1]," + (
    "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]"
)
_STATE = (
    "#timestamp,p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z [],"
    + ",".join(
        f"{name}_{axis} [{unit}]"
        for name, unit in (("v_RS_R", "m s^-1"), ("b_w_RS_S", "rad s^-1"), ("b_a_RS_S", "m s^-2"))
        for axis in "xyz"
    )
)


def nanoseconds(seconds: float) -> int:
    """Return the nearest whole nanoseconds."""
    return round(Fraction(seconds) * 10**9)


def track_of(frames: Sequence[Frame]) -> ImuTrack:
    """Return the IMU of timed frames.

    Raises:
        ArgumentError: a frame without a time, or a dataset without an IMU.
    """
    for frame in frames:
        if frame.imu is None or frame.time is None:
            raise ArgumentError(
                "expected frames with times and an IMU, got some without; give 'imu' in the job"
            )
    assert frames[0].imu is not None
    return frames[0].imu


def on_body(track: ImuTrack, frame: Frame) -> Pose:
    """Return ``T_body_cam`` of a frame's camera."""
    assert frame.time is not None
    return track.camera_on_body(frame.pose, frame.time)


@register
class Euroc(Format):
    """See the module."""

    name = "euroc"
    needs = ("lit", "imu")

    def refuses(self, camera: Camera) -> str | None:
        return Kalibr().refuses(camera)

    def write(self, frames: Sequence[Frame], out: Path, options: NoOptions) -> list[Path]:
        track, root, written = track_of(frames), out / "mav0", []
        sequences = by_camera(frames)
        for i, mine in enumerate(sequences.values()):
            folder, rows = root / f"cam{i}", []
            for frame in mine:
                stamp = nanoseconds(frame.time or 0.0)
                written.append(write_color(folder / "data" / f"{stamp}.png", frame))
                rows.append((stamp, f"{stamp}.png"))
            written.append(_csv(folder / "data.csv", "#timestamp [ns],filename", rows))
            written.append(_sensor(folder, "camera", on_body(track, mine[0]), _camera(mine)))
        samples = track.samples()
        stamps = [nanoseconds(time) for time in samples.times.tolist()]
        measured = np.hstack([samples.angular_velocity, samples.specific_force]).tolist()
        rows = [(stamp, *row) for stamp, row in zip(stamps, measured, strict=True)]
        states = [(stamp, *row) for stamp, row in zip(stamps, _states(samples), strict=True)]
        body, truth = Pose(np.zeros(3), np.eye(3)), root / "state_groundtruth_estimate0"
        return [
            *written,
            _csv(root / "imu0" / "data.csv", _IMU, rows),
            _sensor(root / "imu0", "imu", body, imu_parameters(track)),
            _csv(truth / "data.csv", _STATE, states),
            _sensor(truth, "visual-inertial", body, {}),
            write_text(root / "body.yaml", "comment: the frame of imu0\n"),
            write_text(root / "cameras.txt", "".join(f"cam{i} {name}\n" for i, name in enumerate(sequences))),
        ]


def imu_parameters(track: ImuTrack) -> dict[str, Any]:
    """Return the rate, and the largest densities of any axis, as EuRoC's and Kalibr's files have them."""
    parameters: dict[str, Any] = {"rate_hz": track.imu.rate}
    for name, errors in (("gyroscope", track.imu.gyroscope), ("accelerometer", track.imu.accelerometer)):
        parameters[f"{name}_noise_density"] = max(errors.noise_density)
        parameters[f"{name}_random_walk"] = max(errors.random_walk)
    return parameters


def _camera(frames: Sequence[Frame]) -> dict[str, Any]:
    entry = yaml.safe_load(KALIBR.write({"cam0": RigCamera(frames[0].camera)}))["cam0"]
    times = [frame.time or 0.0 for frame in frames]
    rate = (len(times) - 1) / (times[-1] - times[0]) if len(times) > 1 else 0.0
    return {
        "rate_hz": rate,
        "resolution": entry["resolution"],
        "camera_model": entry["camera_model"],
        "intrinsics": entry["intrinsics"],
        "distortion_model": _DISTORTION.get(entry["distortion_model"], entry["distortion_model"]),
        "distortion_coefficients": entry["distortion_coeffs"],
    }


def _sensor(folder: Path, kind: str, pose: Pose, keys: Mapping[str, Any]) -> Path:
    """Write ``sensor.yaml``."""
    rows = [*np.column_stack([pose.rotation, pose.position]).ravel().tolist(), 0.0, 0.0, 0.0, 1.0]
    content = {"sensor_type": kind, "T_BS": {"cols": 4, "rows": 4, "data": rows}, **keys}
    return write_text(
        folder / "sensor.yaml", yaml.safe_dump(content, sort_keys=False, default_flow_style=None)
    )


def _states(samples: ImuSamples) -> list[list[float]]:
    quaternions = Rotation.from_matrix(samples.rotations).as_quat(canonical=True, scalar_first=True)
    columns = samples.positions_w, quaternions, samples.velocities_w, samples.gyro_bias, samples.accel_bias
    return np.hstack(columns).tolist()  # type: ignore[no-any-return]


def _csv(path: Path, header: str, rows: Iterable[Sequence[Any]]) -> Path:
    return write_text(path, "\n".join([header, *(",".join(map(str, row)) for row in rows)]) + "\n")
