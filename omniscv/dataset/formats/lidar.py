"""Point clouds of a ``lidar``: KITTI's folders, and PCD of the Point Cloud Library.

``kitti_lidar``, with the labels of SemanticKITTI: those of one ``lidar``::

    velodyne/000000.bin      float32 x y z r: X ahead, Y left, Z up, metres; r the intensity, or 0
    seconds/000000.bin       float32 seconds of each point since the scan's time: the axes are those of then
    labels/000000.label      uint32 class + 65536 * instance of each point, if the frames have labels
    doubt/000000.bin         uint8 of each point: 1 where its label or depth may be wrong
    poses.txt, times.txt     the sensor's, in camera axes, relative to the first one; seconds
    calib.txt                Tr, from the sensor's axes to those of the camera (x right, y down, z forward)

Only returns are points. Class 0 is SemanticKITTI's "unlabeled".

``pcd``, PCD 0.7: ``KEY.pcd`` of each frame, binary and organised as the image is.

Points are in the sensor's axes (X ahead, Y left, Z up), NaN where a pixel has none; ``VIEWPOINT`` is the
sensor's pose in the world, relative to the x y z of a line ``# origin`` if there is one: readers have it as
float32, which cannot hold coordinates of the real world, such as UTM's. Fields: ``x y z``, and as the frames
have them ``intensity``, ``ring``, ``time``, ``label``, ``class``, ``doubt``: see
:func:`omniscv.truth.point_cloud.sweep`.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import flag
from omniscv.cameras import Camera
from omniscv.dataset.exporting import Format, PointOptions, register
from omniscv.dataset.sequences import by_camera, near_origin, timed, trajectory
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.geometry import R_LEVEL, Pose
from omniscv.geometry.trajectory_files import write_kitti, write_kitti_times
from omniscv.records import checked, record
from omniscv.storage.local import write_bytes, write_text
from omniscv.truth.point_cloud import lidar_of, sweep


@record
class LidarOptions(PointOptions):
    """Options of formats of point clouds."""

    intensity: bool = checked(
        flag, default=False, help="colour times the cosine of incidence, a stand-in; needs lit and normals"
    )


@register
class KittiLidar(Format):
    """See the module."""

    name = "kitti_lidar"
    needs = ("depth",)
    options = LidarOptions

    def refuses(self, camera: Camera) -> str | None:
        return None if lidar_of(camera) else f"expected a lidar, got {camera.name}"

    def check_options(self, options: LidarOptions, cameras: Mapping[str, Camera]) -> None:
        """Raise ArgumentError, whatever the ``options``, for several ``cameras``: they share files."""
        if len(cameras) > 1:
            advice = "export each into its own 'out'"
            raise ArgumentError(f"expected one lidar, got {', '.join(cameras)}; {advice}")

    def write(self, frames: Sequence[Frame], out: Path, options: LidarOptions) -> list[Path]:
        """Write the scans of ``frames``, their poses, times and axes into ``out``.

        ``options`` say which returns are points, and whether they have an intensity.
        """
        written: list[Path] = []
        for scans in by_camera(frames).values():
            for number, frame in enumerate(scans):
                points = sweep(frame, options.max_relative_error, options.intensity)
                written += _write_scan(points[np.isfinite(points["x"])], out, f"{number:06d}")
            poses = trajectory(scans)
            written.append(write_text(out / "poses.txt", write_kitti(poses)))
            written.append(write_text(out / "calib.txt", _calibration()))
            if timed(scans):
                written.append(write_text(out / "times.txt", write_kitti_times(poses)))
        return written


def _write_scan(points: NDArray[np.void], out: Path, stem: str) -> list[Path]:
    """Write the files of a scan's points, in the axes of the sensor, each into its own folder."""
    fields = points.dtype.names or ()
    values = np.zeros((len(points), 4), "<f4")
    for column, name in enumerate(("x", "y", "z", "intensity")):
        if name in fields:
            values[:, column] = points[name]
    seconds = points["time"].astype("<f4")
    written = [
        write_bytes(out / "velodyne" / f"{stem}.bin", values.tobytes()),
        write_bytes(out / "seconds" / f"{stem}.bin", seconds.tobytes()),
    ]
    if "label" in fields:
        classes = points["class"] if "class" in fields else 0
        labels = ((points["label"].astype("<u4") << 16) | classes).astype("<u4")
        written.append(write_bytes(out / "labels" / f"{stem}.label", labels.tobytes()))
    if "doubt" in fields:
        written.append(write_bytes(out / "doubt" / f"{stem}.bin", points["doubt"].tobytes()))
    return written


def _calibration() -> str:
    """Return ``calib.txt``: placeholders for the cameras P0 to P3, and Tr from sensor to camera axes."""
    matrices = {f"P{number}": np.eye(3, 4) for number in range(4)}
    matrices["Tr"] = np.column_stack([R_LEVEL.T, np.zeros(3)])
    lines = []
    for name, matrix in matrices.items():
        numbers = " ".join(f"{value:.12e}" for value in matrix.ravel())
        lines.append(f"{name}: {numbers}\n")
    return "".join(lines)


@register
class Pcd(Format):
    """See the module."""

    name = "pcd"
    needs = ("depth",)
    options = LidarOptions

    def write(self, frames: Sequence[Frame], out: Path, options: LidarOptions) -> list[Path]:
        """Write a cloud of each of ``frames`` into ``out``.

        ``options`` say which returns are points, and whether they have an intensity.
        """
        written = []
        origin, frames = near_origin(frames)
        comment = "# origin {:.0f} {:.0f} {:.0f}\n".format(*origin) if origin.any() else ""
        for frame in frames:
            points = sweep(frame, options.max_relative_error, options.intensity)
            content = (comment + _header(points, frame.pose)).encode() + points.tobytes()
            written.append(write_bytes(out / f"{frame.key}.pcd", content))
        return written


def _header(points: NDArray[np.void], pose: Pose) -> str:
    """Return the header of a PCD file of points (H, W), of a sensor whose camera has a pose."""
    height, width = points.shape
    x, y, z, w = Pose(pose.position, pose.rotation @ R_LEVEL.T).quaternion()
    names = points.dtype.names or ()
    types = [points.dtype[name] for name in names]
    header: dict[str, Sequence[Any]] = {
        "VERSION": [0.7],
        "FIELDS": names,
        "SIZE": [type.itemsize for type in types],
        "TYPE": [type.kind.upper() for type in types],
        "COUNT": [1] * len(types),
        "WIDTH": [width],
        "HEIGHT": [height],
        "VIEWPOINT": [*pose.position.tolist(), w, x, y, z],
        "POINTS": [width * height],
        "DATA": ["binary"],
    }
    lines = []
    for name, values in header.items():
        lines.append(f"{name} {' '.join(map(str, values))}\n")
    return "".join(lines)
