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

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from omniscv.calibration.kalibr import KALIBR
from omniscv.cameras import Camera
from omniscv.cameras.rig import RigCamera
from omniscv.dataset.exporting import Format, register
from omniscv.dataset.formats.kalibr import Kalibr
from omniscv.dataset.pictures import without_limit, write_color
from omniscv.dataset.sequences import by_camera, timed
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.geometry import Array, Pose
from omniscv.records import NoOptions
from omniscv.sensor.imu import ImuTrack
from omniscv.storage.local import write_text

_STATES = {
    "p_RS_R": "m", "q_RS": "", "v_RS_R": "m s^-1", "b_w_RS_S": "rad s^-1", "b_a_RS_S": "m s^-2",
}  # fmt: skip
_MEASURED = {"w_RS_S": "rad s^-1", "a_RS_S": "m s^-2"}


def track_of(frames: Sequence[Frame]) -> ImuTrack:
    """Return the IMU of frames with times; ArgumentError for others, or a dataset without an IMU."""
    track = frames[0].imu if frames else None
    if track is None or not timed(frames):
        raise ArgumentError("expected frames with times and an IMU, got others; give 'imu' in the job")
    return track


@register
class Euroc(Format):
    """See the module."""

    name = "euroc"
    needs = ("lit", "imu")

    def refuses(self, camera: Camera) -> str | None:
        return Kalibr().refuses(without_limit(camera))

    def write(self, frames: Sequence[Frame], out: Path, options: NoOptions) -> list[Path]:
        track, root, written, names = track_of(frames), out / "mav0", list[Path](), ""
        for i, (name, mine) in enumerate(by_camera(frames).items()):
            folder, names = root / f"cam{i}", f"{names}cam{i} {name}\n"
            pictures = [f"{frame.time_ns or 0:019d}.png" for frame in mine]
            for picture, frame in zip(pictures, mine, strict=True):
                written.append(write_color(folder / "data" / picture, frame))
            rows = "".join(
                f"{frame.time_ns or 0},{picture}\n" for picture, frame in zip(pictures, mine, strict=True)
            )
            written.append(write_text(folder / "data.csv", f"#timestamp [ns],filename\n{rows}"))
            written.append(_sensor(folder, "camera", track.on_body(mine[0]), _camera(mine)))
        samples, body = track.samples(), Pose(np.zeros(3), np.eye(3))
        quaternions = Rotation.from_matrix(samples.rotations).as_quat(canonical=True, scalar_first=True)
        biases = samples.gyro_bias, samples.accel_bias
        states = samples.positions_w, quaternions, samples.velocities_w, *biases
        noise: dict[str, Any] = {"rate_hz": track.imu.rate}
        for name, errors in (("gyroscope", track.imu.gyroscope), ("accelerometer", track.imu.accelerometer)):
            noise[f"{name}_noise_density"] = max(errors.noise_density)  # files have one for all axes
            noise[f"{name}_random_walk"] = max(errors.random_walk)
        imu, state = root / "imu0", root / "state_groundtruth_estimate0"
        return [
            *written,
            _csv(imu, _MEASURED, samples.times_ns, samples.angular_velocity, samples.specific_force),
            _sensor(imu, "imu", body, noise),
            _csv(state, _STATES, samples.times_ns, *states),
            _sensor(state, "visual-inertial", body, {}),
            write_text(root / "body.yaml", "comment: the frame of imu0\n"),
            write_text(root / "cameras.txt", names),
        ]


def _camera(frames: Sequence[Frame]) -> dict[str, Any]:
    entry = yaml.safe_load(KALIBR.write({"cam0": RigCamera(without_limit(frames[0].camera))}))["cam0"]
    entry["distortion_coefficients"] = entry.pop("distortion_coeffs")
    if entry["distortion_model"] == "radtan":
        entry["distortion_model"] = "radial-tangential"
    span = (frames[-1].time or 0.0) - (frames[0].time or 0.0)
    return {"rate_hz": (len(frames) - 1) / span if span else 0.0, **entry}


def _sensor(folder: Path, kind: str, pose: Pose, keys: Mapping[str, Any]) -> Path:
    rows = [*np.column_stack([pose.rotation, pose.position]).ravel().tolist(), 0.0, 0.0, 0.0, 1.0]
    content = {"sensor_type": kind, "T_BS": {"cols": 4, "rows": 4, "data": rows}, **keys}
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None)
    return write_text(folder / "sensor.yaml", text)


def _csv(folder: Path, units: Mapping[str, str], times: NDArray[np.int64], *columns: Array) -> Path:
    axes = {name: "wxyz" if name.startswith("q") else "xyz" for name in units}
    names = [f"{name}_{axis} [{unit}]" for name, unit in units.items() for axis in axes[name]]
    rows = zip(times.tolist(), np.hstack(columns).tolist(), strict=True)
    lines = [",".join(["#timestamp [ns]", *names])]
    lines += [",".join(map(str, (stamp, *row))) for stamp, row in rows]
    return write_text(folder / "data.csv", "\n".join(lines) + "\n")
