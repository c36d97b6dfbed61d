"""A bag of ROS 2, ``bag/``: MCAP, or SQLite with ``storage: sqlite3``; the extra ``ros`` writes it.

``/CAMERA/image/compressed``
    ``CompressedImage`` of each frame with colours.
``/CAMERA/camera_info``
    ``CameraInfo``, where ROS has the model: plumb_bob, rational_polynomial, equidistant.
``/CAMERA/points``
    ``PointCloud2`` of each frame of a ``lidar``, its returns only.
``/imu``
    ``Imu`` in the frame ``body``, with the true orientation.
``/odom``
    ``Odometry``, the true state of ``body`` in ``world``.
``/tf``, ``/tf_static``
    The same poses, and where the sensors are on the body.

The frame of a camera is ``CAMERA`` (x right, y down, z forward), that of a LiDAR X ahead, Y left, Z up. Types
are those of ROS 2 Humble. Messages are in the order of their times.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from omniscv.arguments import one_of
from omniscv.calibration.opencv import to_opencv, to_opencv_fisheye
from omniscv.cameras import Camera
from omniscv.dataset.exporting import Format, register
from omniscv.dataset.formats.euroc import nanoseconds, on_body, track_of
from omniscv.dataset.formats.kitti_lidar import LidarOptions
from omniscv.dataset.pictures import without_limit, write_color
from omniscv.dataset.sequences import by_camera
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.geometry import R_LEVEL, Array, Pose
from omniscv.records import checked, record
from omniscv.truth.point_cloud import lidar_of, sweep

Storage = Literal["mcap", "sqlite3"]
_DATATYPES = {"<f4": 7, "<u2": 4}  # of PointField
Message = tuple[int, str, Any]
"""Nanoseconds, topic, message."""


@record
class BagOptions(LidarOptions):
    """Options of the format."""

    storage: Storage = checked(one_of, words=("mcap", "sqlite3"), default="mcap", help="mcap or sqlite3")


@register
class Rosbag2(Format):
    """See the module."""

    name = "rosbag2"
    options = BagOptions

    def needs_of(self, cameras: Mapping[str, Camera]) -> Sequence[str]:
        scans = [lidar_of(camera) is not None for camera in cameras.values()]
        return ["imu", *(["depth"] if any(scans) else []), *([] if all(scans) else ["lit"])]

    def refuses(self, camera: Camera) -> str | None:
        _rosbags()
        return None

    def write(self, frames: Sequence[Frame], out: Path, options: BagOptions) -> list[Path]:
        rosbag2, typesys = _rosbags()
        store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
        plugin = rosbag2.StoragePlugin[options.storage.upper()]
        messages = sorted(_Messages(store.types, frames, out, options), key=lambda message: message[:2])
        with rosbag2.Writer(out / "bag", version=9, storage_plugin=plugin) as writer:
            topics: dict[str, Any] = {}
            for stamp, topic, message in messages:
                kind = message.__msgtype__
                if topic not in topics:
                    topics[topic] = writer.add_connection(topic, kind, typestore=store)
                writer.write(topics[topic], stamp, store.serialize_cdr(message, kind))
        return sorted((out / "bag").iterdir())


def _rosbags() -> tuple[Any, Any]:
    try:
        from rosbags import rosbag2, typesys
    except ImportError:
        raise ArgumentError("expected the package rosbags; install omniscv[ros]") from None
    return rosbag2, typesys


def _camera_info(camera: Camera) -> dict[str, Any] | None:
    """Return the numbers of ``CameraInfo``; None where ROS has no such model."""
    for fisheye, convert in ((True, to_opencv_fisheye), (False, to_opencv)):
        try:
            K, D = convert(without_limit(camera))
        except ArgumentError:
            continue
        if fisheye and K[0, 1]:
            return None  # OpenCV's skew of fisheyes is no part of the message
        model = "equidistant" if fisheye else "plumb_bob" if len(D) <= 5 else "rational_polynomial"
        D = np.concatenate([D, np.zeros(1)]) if len(D) == 4 and not fisheye else D
        P = np.column_stack([K, np.zeros(3)])
        size = {"height": camera.height, "width": camera.width, "binning_x": 0, "binning_y": 0}
        matrices = {"d": D, "k": K.ravel(), "r": np.eye(3).ravel(), "p": P.ravel()}
        return {**size, "distortion_model": model, **matrices}
    return None


class _Messages:
    """The messages of a bag."""

    def __init__(self, types: Any, frames: Sequence[Frame], out: Path, options: BagOptions) -> None:
        self._types, self._frames, self._out, self._options = types, frames, out, options
        self._track = track_of(frames)

    def _make(self, kind: str, **fields: Any) -> Any:
        return self._types[kind.replace("/", "/msg/")](**fields)

    def _header(self, stamp: int, frame: str) -> Any:
        time = self._make("builtin_interfaces/Time", sec=stamp // 10**9, nanosec=stamp % 10**9)
        return self._make("std_msgs/Header", stamp=time, frame_id=frame)

    def _xyz(self, values: Array, kind: str = "Vector3") -> Any:
        return self._make(f"geometry_msgs/{kind}", **dict(zip("xyz", values.tolist(), strict=True)))

    def _turn(self, rotation: Array) -> Any:
        xyzw = Rotation.from_matrix(rotation).as_quat(canonical=True).tolist()
        return self._make("geometry_msgs/Quaternion", **dict(zip("xyzw", xyzw, strict=True)))

    def _transform(self, stamp: int, parent: str, child: str, pose: Pose) -> Any:
        of_pose = {"translation": self._xyz(pose.position), "rotation": self._turn(pose.rotation)}
        transform, header = self._make("geometry_msgs/Transform", **of_pose), self._header(stamp, parent)
        stamped = "geometry_msgs/TransformStamped"
        return self._make(stamped, header=header, child_frame_id=child, transform=transform)

    def __iter__(self) -> Iterator[Message]:
        sequences = by_camera(self._frames)
        first = min(nanoseconds(frame.time or 0.0) for frame in self._frames)
        static = [self._mounted(first, name, mine[0]) for name, mine in sequences.items()]
        yield first, "/tf_static", self._make("tf2_msgs/TFMessage", transforms=static)
        for name, mine in sequences.items():
            info = _camera_info(mine[0].camera)
            for frame in mine:
                header = self._header(stamp := nanoseconds(frame.time or 0.0), name)
                if lidar_of(frame.camera):
                    yield stamp, f"/{name}/points", self._cloud(header, frame)
                elif "lit" in frame.files:
                    yield stamp, f"/{name}/image/compressed", self._image(header, frame)
                    if info is not None:
                        roi = self._make(
                            "sensor_msgs/RegionOfInterest",
                            **dict.fromkeys(("x_offset", "y_offset", "height", "width"), 0),
                            do_rectify=False,
                        )
                        message = self._make("sensor_msgs/CameraInfo", header=header, roi=roi, **info)
                        yield stamp, f"/{name}/camera_info", message
        yield from self._inertial()

    def _mounted(self, stamp: int, name: str, frame: Frame) -> Any:
        pose = on_body(self._track, frame)
        if lidar_of(frame.camera):
            pose = Pose(pose.position, pose.rotation @ R_LEVEL.T)
        return self._transform(stamp, "body", name, pose)

    def _image(self, header: Any, frame: Frame) -> Any:
        path = write_color(self._out / "picture.png", frame)
        data = np.frombuffer(path.read_bytes(), np.uint8)
        path.unlink()
        return self._make("sensor_msgs/CompressedImage", header=header, format="png", data=data)

    def _cloud(self, header: Any, frame: Frame) -> Any:
        table = sweep(frame, self._options.max_relative_error, self._options.intensity)
        points = table[np.isfinite(table["x"])]
        fields = [
            self._make(
                "sensor_msgs/PointField", name=name, offset=offset, datatype=_DATATYPES[type.str], count=1
            )
            for name, (type, offset) in points.dtype.fields.items()
        ]
        step = points.dtype.itemsize
        size = {"height": 1, "width": len(points), "point_step": step, "row_step": step * len(points)}
        data = np.frombuffer(points.tobytes(), np.uint8)
        flags = {"is_bigendian": False, "is_dense": True}
        return self._make("sensor_msgs/PointCloud2", header=header, fields=fields, data=data, **size, **flags)

    def _inertial(self) -> Iterator[Message]:
        samples = self._track.samples()
        rates = self._track.path.motions(samples.times).rates @ self._track.imu.pose.rotation
        unknown, none = np.zeros(9), np.zeros(36)
        for i, time in enumerate(samples.times.tolist()):
            stamp, rotation = nanoseconds(time), samples.rotations[i]
            yield (
                stamp,
                "/imu",
                self._make(
                    "sensor_msgs/Imu",
                    header=self._header(stamp, "body"),
                    orientation=self._turn(rotation),
                    orientation_covariance=unknown,
                    angular_velocity=self._xyz(samples.angular_velocity[i]),
                    angular_velocity_covariance=unknown,
                    linear_acceleration=self._xyz(samples.specific_force[i]),
                    linear_acceleration_covariance=unknown,
                ),
            )
            position = self._xyz(samples.positions_w[i], "Point")
            pose = self._make("geometry_msgs/Pose", position=position, orientation=self._turn(rotation))
            linear = self._xyz(
                rotation.T @ samples.velocities_w[i]
            )  # of the child's frame, as ROS defines it
            twist = self._make("geometry_msgs/Twist", linear=linear, angular=self._xyz(rates[i]))
            yield (
                stamp,
                "/odom",
                self._make(
                    "nav_msgs/Odometry",
                    header=self._header(stamp, "world"),
                    child_frame_id="body",
                    pose=self._make("geometry_msgs/PoseWithCovariance", pose=pose, covariance=none),
                    twist=self._make("geometry_msgs/TwistWithCovariance", twist=twist, covariance=none),
                ),
            )
            moved = self._transform(stamp, "world", "body", Pose(samples.positions_w[i], rotation))
            yield stamp, "/tf", self._make("tf2_msgs/TFMessage", transforms=[moved])
