"""Formats of SLAM and visual odometry: trajectories, Kalibr's chains, EuRoC's folders, TUM's mono folders."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from omniscv.calibration.forms import matrix_of_pose
from omniscv.calibration.kalibr import KALIBR
from omniscv.calibration.table import DSO
from omniscv.cameras import Camera, Lidar, PushBroom, RollingShutter
from omniscv.cameras.rig import Rig, RigCamera
from omniscv.dataset.exporting import Format, register
from omniscv.dataset.pictures import without_limit, write_color, write_pixels
from omniscv.dataset.sequences import by_camera, rigs, timed, trajectory
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.geometry import Array, Pose
from omniscv.geometry.trajectory import NS
from omniscv.geometry.trajectory_files import write_euroc, write_kitti, write_kitti_times, write_tum
from omniscv.records import NoOptions, checked, mapping, optional, record
from omniscv.sensor import Sensor, optics
from omniscv.sensor.imu import ImuTrack
from omniscv.storage.local import write_text

_WRITERS = {"tum": write_tum, "kitti": write_kitti, "times": write_kitti_times, "euroc": write_euroc}
"""By the suffix of a file, the function that returns its text."""


@register
class Poses(Format):
    """Trajectories of each camera: ``CAMERA.tum``, ``CAMERA.euroc``, ``CAMERA.kitti`` with ``CAMERA.times``.

    The formats are those of :mod:`omniscv.geometry.trajectory_files`. Poses are in the order of their times,
    or of the frames' keys if a frame has no time; then they are numbered from 0. TUM and EuRoC hold poses in
    the world frame; KITTI's are relative to the first one. Of a camera that moves while its lines are read,
    the pose is that of its time. ``CAMERA.keys`` names the frame of every line.
    """

    name = "poses"

    def refuses(self, camera: Camera) -> str | None:
        if camera.central or isinstance(camera, Lidar | PushBroom | RollingShutter):
            return None
        return f"expected a central camera, got {camera.name}, whose rays have several origins"

    def write(self, frames: Sequence[Frame], out: Path, options: NoOptions) -> list[Path]:
        """Write the trajectories of ``frames`` into ``out``; ``options`` are none.

        ArgumentError: two frames of a camera have one time.
        """
        written = []
        for camera_name, sequence in by_camera(frames).items():
            poses = trajectory(sequence)
            for suffix, to_text in _WRITERS.items():
                written.append(write_text(out / f"{camera_name}.{suffix}", to_text(poses)))
            keys = "".join(f"{frame.key}\n" for frame in sequence)
            written.append(write_text(out / f"{camera_name}.keys", keys))
        return written


_SAMPLES = 33
"""Rows and columns of the pixels whose directions are compared."""


@register
class Kalibr(Format):
    """Kalibr's ``camchain.yaml``: the cameras of a rig, each with its pose relative to the one before it.

    Each of several rigs (:mod:`omniscv.dataset.sequences`) has a file, ``camchain-CAMERA.yaml`` by its first
    camera. The cameras are ``cam0``, ``cam1``, ... in the order of their names, which ``rostopic`` holds.
    ``cam_overlaps`` lists the cameras that see some of the same directions. A dataset with an IMU has one
    chain, with each camera's pose on the IMU, ``T_cam_imu``; images are stamped with the time that they show,
    so ``timeshift_cam_imu`` is 0.
    """

    name = "kalibr"

    def refuses(self, camera: Camera) -> str | None:
        try:
            KALIBR.values_of(camera)
        except ArgumentError as cause:
            return str(cause)
        return None

    def write(self, frames: Sequence[Frame], out: Path, options: NoOptions) -> list[Path]:
        """Write the chain of each rig of ``frames`` into ``out``; ``options`` are none."""
        if frames and frames[0].imu is not None and timed(frames):
            track = frames[0].imu
            on_imu = {}
            for name, (first, *_) in by_camera(frames).items():
                on_imu[name] = RigCamera(first.camera, track.on_body(first))
            return [write_text(out / "camchain.yaml", _chain(Rig(on_imu), on_imu=True))]
        chains = [found.rig for found in rigs(frames)]
        written = []
        for rig in chains:
            suffix = f"-{next(iter(rig.cameras))}" if len(chains) > 1 else ""
            written.append(write_text(out / f"camchain{suffix}.yaml", _chain(rig)))
        return written


def _chain(rig: Rig, on_imu: bool = False) -> str:
    """Return Kalibr's chain of a rig; ``on_imu``: the rig's frame is that of its IMU."""
    seen = rig.seen_from(next(iter(rig.cameras))) if on_imu else rig
    numbered = {f"cam{number}": mounted for number, mounted in enumerate(seen.cameras.values())}
    chain = yaml.safe_load(KALIBR.write(numbered, rig=True))
    for entry, (camera_name, mounted) in zip(chain.values(), rig.cameras.items(), strict=True):
        if on_imu:
            entry |= {"T_cam_imu": matrix_of_pose(mounted.pose.inverse()), "timeshift_cam_imu": 0.0}
        entry["rostopic"] = f"/{camera_name}"
        entry["cam_overlaps"] = _overlaps(rig, mounted)
    return yaml.safe_dump(chain, sort_keys=False, default_flow_style=None)


def _overlaps(rig: Rig, mounted: RigCamera) -> list[int]:
    """Return the numbers of the other cameras of a rig that see a point of this one's image, far away."""
    columns = np.linspace(0, mounted.camera.width, _SAMPLES)
    rows = np.linspace(0, mounted.camera.height, _SAMPLES)
    rays = mounted.camera.unproject(np.stack(np.meshgrid(columns, rows), axis=-1))
    directions = rays.directions[rays.valid]
    overlaps = []
    for number, other in enumerate(rig.cameras.values()):
        R_other_camera = other.pose.rotation.T @ mounted.pose.rotation
        if other is not mounted and other.camera.project(directions @ R_other_camera.T)[1].any():
            overlaps.append(number)
    return overlaps


_EVEN = 2  # times between frames, which show that they are even
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
    """EuRoC's folder ``mav0``, also called the ASL format: images of a rig, its IMU, and the true state.

    ::

        mav0/body.yaml
        mav0/cam0/{data.csv, sensor.yaml, data/NANOSECONDS.png}     cam1, ... in the order of their names
        mav0/imu0/{data.csv, sensor.yaml}
        mav0/state_groundtruth_estimate0/{data.csv, sensor.yaml}    at the IMU's times

    The body ``B`` is the IMU. ``T_BS`` in a ``sensor.yaml`` is the pose of the sensor on it. Images are
    stamped with the time at which they show the world, so a camera's time offset is in its stamps. The models
    and numbers of cameras are Kalibr's (:mod:`omniscv.calibration.kalibr`), pixel centres at whole numbers;
    EuRoC's own is ``pinhole`` with ``radial-tangential``. ``cameras.txt`` has the dataset's name of each
    camera.
    """

    name = "euroc"
    needs = ("lit", "imu")

    def refuses(self, camera: Camera) -> str | None:
        return Kalibr().refuses(without_limit(camera))

    def write(self, frames: Sequence[Frame], out: Path, options: NoOptions) -> list[Path]:
        """Write the images of ``frames``, their IMU and its state into ``out/mav0``; ``options`` are none.

        ArgumentError: they have no IMU, or no times.
        """
        track = track_of(frames)
        root = out / "mav0"
        written = list[Path]()
        names = ""
        for number, (name, sequence) in enumerate(by_camera(frames).items()):
            folder = root / f"cam{number}"
            names += f"cam{number} {name}\n"
            table = "#timestamp [ns],filename\n"
            for frame in sequence:
                stamp = frame.time_ns or 0
                written.append(write_color(folder / "data" / f"{stamp:019d}.png", frame))
                table += f"{stamp},{stamp:019d}.png\n"
            written.append(write_text(folder / "data.csv", table))
            written.append(_sensor(folder, "camera", track.on_body(sequence[0]), _camera(sequence, track)))
        samples = track.samples()
        body = Pose(np.zeros(3), np.eye(3))
        quaternions = Rotation.from_matrix(samples.rotations).as_quat(canonical=True, scalar_first=True)
        biases = samples.gyro_bias, samples.accel_bias
        states = samples.positions_w, quaternions, samples.velocities_w, *biases
        noise: dict[str, Any] = {"rate_hz": track.imu.rate}
        for name, errors in (("gyroscope", track.imu.gyroscope), ("accelerometer", track.imu.accelerometer)):
            noise[f"{name}_noise_density"] = max(errors.noise_density)  # files have one for all axes
            noise[f"{name}_random_walk"] = max(errors.random_walk)
        imu = root / "imu0"
        state = root / "state_groundtruth_estimate0"
        return [
            *written,
            _csv(imu, _MEASURED, samples.times_ns, samples.angular_velocity, samples.specific_force),
            _sensor(imu, "imu", body, noise),
            _csv(state, _STATES, samples.times_ns, *states),
            _sensor(state, "visual-inertial", body, {}),
            write_text(root / "body.yaml", "comment: the frame of imu0\n"),
            write_text(root / "cameras.txt", names),
        ]


def _camera(frames: Sequence[Frame], track: ImuTrack) -> dict[str, Any]:
    """Return the keys of a camera's ``sensor.yaml``.

    Its rate is that of the frames; of frames at uneven times, as a limited dataset has them, that of the
    rig's poses.
    """
    entry = yaml.safe_load(KALIBR.write({"cam0": RigCamera(without_limit(frames[0].camera))}))["cam0"]
    entry["distortion_coefficients"] = entry.pop("distortion_coeffs")
    if entry["distortion_model"] == "radtan":
        entry["distortion_model"] = "radial-tangential"
    between_ns = np.diff([frame.time_ns or 0 for frame in frames])
    if len(between_ns) < _EVEN or np.ptp(between_ns) > 0.01 * between_ns.min():
        between_ns = np.diff(track.path.times_ns or ())
    return {"rate_hz": NS / float(np.mean(between_ns)) if len(between_ns) else 0.0, **entry}


def _sensor(folder: Path, kind: str, pose: Pose, keys: Mapping[str, Any]) -> Path:
    rows = [*np.column_stack([pose.rotation, pose.position]).ravel().tolist(), 0.0, 0.0, 0.0, 1.0]
    content = {"sensor_type": kind, "T_BS": {"cols": 4, "rows": 4, "data": rows}, **keys}
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None)
    return write_text(folder / "sensor.yaml", text)


def _csv(folder: Path, units: Mapping[str, str], times: NDArray[np.int64], *columns: Array) -> Path:
    """Write ``data.csv`` of vectors at times.

    Args:
        folder: into which the file is written.
        units: of the vectors, by their names; names of quaternions begin with ``q``.
        times: (N,) ns.
        columns: of each vector, (N, 3), or (N, 4) of a quaternion.
    """
    names = ["#timestamp [ns]"]
    for name, unit in units.items():
        for axis in "wxyz" if name.startswith("q") else "xyz":
            names.append(f"{name}_{axis} [{unit}]")
    lines = [",".join(names)]
    for stamp, row in zip(times.tolist(), np.hstack(columns).tolist(), strict=True):
        lines.append(",".join(map(str, (stamp, *row))))
    return write_text(folder / "data.csv", "\n".join(lines) + "\n")


@record
class TumMonoOptions:
    """Options of the format."""

    sensor: Mapping[str, Any] | None = checked(
        optional(mapping), default=None, help="the job's sensor, whose exposure and shading are written"
    )


@register
class TumMono(Format):
    """Photometric calibration as in TUM's monocular visual odometry datasets, which DSO reads.

    Each camera has a folder of its pictures behind the sensor, in the order of their times::

        CAMERA/images/00000.png ...   the layer 'sensor'
        CAMERA/times.txt              a line for each picture: number, seconds, milliseconds of exposure
        CAMERA/pcalib.txt             light, 0 to 255, of each code: the inverse of sRGB
        CAMERA/vignette.png           16 bits: the sensor's shading, or white
        CAMERA/camera.txt             the lens, where DSO has its model
    """

    name = "tum_mono"
    needs = ("sensor",)
    keys = ("sensor",)
    options = TumMonoOptions

    def check_options(self, options: TumMonoOptions, cameras: Mapping[str, Camera]) -> None:
        """Raise ArgumentError, whatever the ``cameras``, if the sensor of ``options`` is shaded by a file."""
        if options.sensor is not None and isinstance(options.sensor.get("shading"), Mapping):
            wanted = "expected natural shading or a table, got a file, which is the vignette"
            raise ArgumentError(f"tum_mono: {wanted}; leave the format out")

    def write(self, frames: Sequence[Frame], out: Path, options: TumMonoOptions) -> list[Path]:
        """Write a folder for each camera of ``frames`` into ``out``; ``options`` have the job's sensor."""
        sensor = Sensor(**(options.sensor or {}))
        written = []
        for name, sequence in by_camera(frames).items():
            folder = out / name
            camera = sequence[0].camera
            times = []
            for index, frame in enumerate(sequence):
                number = f"{index:05d}"
                time_ns = index * NS if frame.time_ns is None else frame.time_ns
                written.append(write_pixels(folder / "images" / f"{number}.png", frame.layer("sensor")))
                times.append((number, time_ns, sensor.exposure_s))
            shares = np.ones((camera.height, camera.width))
            if sensor.shading is not None:
                shares = np.asarray(optics.shading(camera, sensor.shading), np.float64)
            lens = without_limit(camera.base if isinstance(camera, RollingShutter) else camera)
            with suppress(ArgumentError):  # DSO has no such model
                written.append(write_text(folder / "camera.txt", DSO.write({name: RigCamera(lens)})))
            written += [
                optics.write_times(folder / optics.TIMES, times),
                optics.write_response(folder / optics.RESPONSE, "srgb"),
                optics.write_vignette(folder / optics.VIGNETTE, shares),
            ]
        return written
