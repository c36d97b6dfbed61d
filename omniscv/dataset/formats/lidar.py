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
        """Refuse several sensors: their files would have the same names."""
        if len(cameras) > 1:
            got = f"got {', '.join(cameras)}; export each into its own 'out'"
            raise ArgumentError(f"expected one lidar, {got}")

    def write(self, frames: Sequence[Frame], out: Path, options: LidarOptions) -> list[Path]:
        written: list[Path] = []
        for mine in by_camera(frames).values():
            for i, frame in enumerate(mine):
                points = sweep(frame, options.max_relative_error, options.intensity)
                points = points[np.isfinite(points["x"])]
                values = np.zeros((len(points), 4), "<f4")
                for column, name in enumerate(("x", "y", "z", "intensity")):
                    values[:, column] = points[name] if name in points.dtype.fields else 0
                of_scan = {"velodyne": values, "seconds": points["time"].astype("<f4")}
                if "label" in points.dtype.fields:
                    classes = points["class"] if "class" in points.dtype.fields else 0
                    labels = (points["label"].astype("<u4") << 16) | classes
                    of_scan["labels"] = labels.astype("<u4")
                if "doubt" in points.dtype.fields:
                    of_scan["doubt"] = points["doubt"]
                for name, array in of_scan.items():
                    suffix = "label" if name == "labels" else "bin"
                    written.append(write_bytes(out / name / f"{i:06d}.{suffix}", array.tobytes()))
            axes = np.column_stack([R_LEVEL.T, np.zeros(3)])
            rows = {**{f"P{i}": np.eye(3, 4) for i in range(4)}, "Tr": axes}
            numbers = {name: " ".join(f"{value:.12e}" for value in row.ravel()) for name, row in rows.items()}
            poses = trajectory(mine)
            calib = "".join(f"{name}: {row}\n" for name, row in numbers.items())
            contents = {"poses": write_kitti(poses), "calib": calib}
            if timed(mine):
                contents["times"] = write_kitti_times(poses)
            written += [write_text(out / f"{name}.txt", text) for name, text in contents.items()]
        return written


@register
class Pcd(Format):
    """See the module."""

    name = "pcd"
    needs = ("depth",)
    options = LidarOptions

    def write(self, frames: Sequence[Frame], out: Path, options: LidarOptions) -> list[Path]:
        written = []
        (origin, frames) = near_origin(frames)
        comment = "# origin {:.0f} {:.0f} {:.0f}\n".format(*origin) if origin.any() else ""
        for frame in frames:
            points = sweep(frame, options.max_relative_error, options.intensity)
            height, width = points.shape
            x, y, z, w = Pose(frame.pose.position, frame.pose.rotation @ R_LEVEL.T).quaternion()
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
                "VIEWPOINT": [*frame.pose.position.tolist(), w, x, y, z],
                "POINTS": [width * height],
                "DATA": ["binary"],
            }
            text = "".join(f"{name} {' '.join(map(str, values))}\n" for name, values in header.items())
            content = (comment + text).encode() + points.tobytes()
            written.append(write_bytes(out / f"{frame.key}.pcd", content))
        return written
