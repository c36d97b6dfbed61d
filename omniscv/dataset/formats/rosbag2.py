"""A bag of ROS 2 Humble, ``bag/``: MCAP, or SQLite with ``storage: sqlite3``; the extra ``ros`` writes it.

docs/slam.md has its topics. Messages are in the order of their times. Depth without a surface is +inf in
``32FC1``, 0 in ``16UC1``; clouds have returns only.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from omniscv.arguments import flag
from omniscv.calibration.opencv import to_opencv, to_opencv_fisheye
from omniscv.cameras import Camera, RollingShutter
from omniscv.dataset.exporting import Format, register
from omniscv.dataset.formats.lidar import LidarOptions
from omniscv.dataset.formats.slam import track_of
from omniscv.dataset.pictures import without_limit, write_color
from omniscv.dataset.sequences import by_camera
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.geometry import R_LEVEL, Array
from omniscv.records import checked, record, word
from omniscv.sensor.imu import ImuTrack
from omniscv.truth.point_cloud import lidar_of, sweep

Storage = Literal["mcap", "sqlite3"]
Depth = Literal["none", "32FC1", "16UC1"]
_DATATYPES = {"<f4": 7, "<u2": 4, "|u1": 2}  # of PointField
Message = tuple[int, str, str, dict[str, Any]]
"""Nanoseconds, topic, type and fields; fields that are not given are 0 or empty."""


@record
class BagOptions(LidarOptions):
    """Options of the format."""

    storage: Storage = word(Storage, default="mcap", help="mcap or sqlite3")
    depth: Depth = word(Depth, default="none", help="depth images of cameras: none, 32FC1 or 16UC1")
    labels: bool = checked(flag, default=False, help="images of labels")


@register
class Rosbag2(Format):
    """See the module."""

    name = "rosbag2"
    options = BagOptions

    def needs_of(self, cameras: Mapping[str, Camera], options: Any) -> Sequence[str]:
        """Return what the messages of ``cameras`` need: the IMU, depth for a lidar, colours for others, and
        the layers that ``options`` name."""
        scans = [lidar_of(camera) is not None for camera in cameras.values()]
        needs = ["imu"]
        if any(scans) or options.depth != "none":
            needs.append("depth")
        if not all(scans):
            needs.append("lit")
        if options.labels:
            needs.append("labels")
        return needs

    def refuses(self, camera: Camera) -> str | None:
        _rosbags()
        return None

    def write(self, frames: Sequence[Frame], out: Path, options: BagOptions) -> list[Path]:
        """Write the messages of ``frames`` and of the IMU into ``out/bag``, as ``options`` say."""
        rosbag2, typesys = _rosbags()
        store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
        plugin = rosbag2.StoragePlugin[options.storage.upper()]
        topics = dict[str, Any]()
        track = track_of(frames)
        messages = [*_of_frames(track, frames, out, options), *_of_imu(track)]
        with rosbag2.Writer(out / "bag", version=9, storage_plugin=plugin) as writer:
            for stamp, topic, kind, fields in sorted(messages, key=lambda message: message[:2]):
                kind = kind.replace("/", "/msg/")
                if topic not in topics:
                    topics[topic] = writer.add_connection(topic, kind, typestore=store)
                writer.write(topics[topic], stamp, store.serialize_cdr(_message(store, kind, fields), kind))
        return sorted((out / "bag").iterdir())


def _rosbags() -> tuple[Any, Any]:
    try:
        from rosbags import rosbag2, typesys
    except ImportError:
        raise ArgumentError("expected the package rosbags; install omniscv[ros]") from None
    return rosbag2, typesys


def _message(store: Any, kind: str, given: Mapping[str, Any]) -> Any:
    """Return a message of nested fields; fields that are not given are 0 or empty."""

    def convert(node: Any, description: Any, value: Any) -> Any:
        """Return a ``value`` as a field has it whose kind is ``node``, and its type ``description``."""
        if node.name == "NAME":
            return _message(store, description, {} if value is None else value)
        if node.name == "BASE":
            if value is not None:
                return value
            return "" if description[0] == "string" else 0
        (item_node, item), count = description
        if item_node.name == "NAME":
            items = () if value is None else value
            return [convert(item_node, item, entry) for entry in items]
        return np.zeros(count, item[0]) if value is None else np.asarray(value, item[0]).ravel()

    values = {}
    for name, (node, description) in store.fielddefs[kind][1]:
        values[name] = convert(node, description, given.get(name))
    return store.types[kind](**values)


def _header(stamp: int, frame: str) -> dict[str, Any]:
    return {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": frame}


def _xyz(values: Array) -> dict[str, float]:
    return dict(zip("xyzw", values.tolist(), strict=False))


def _turn(rotation: Array) -> dict[str, float]:
    return _xyz(Rotation.from_matrix(rotation).as_quat(canonical=True))


def _transform(stamp: int, parent: str, child: str, position: Array, rotation: Array) -> dict[str, Any]:
    transform = {"translation": _xyz(position), "rotation": _turn(rotation)}
    return {"header": _header(stamp, parent), "child_frame_id": child, "transform": transform}


def _of_frames(track: ImuTrack, frames: Sequence[Frame], out: Path, options: BagOptions) -> Iterator[Message]:
    static = []
    for name, sequence in by_camera(frames).items():
        first = sequence[0]
        lens = first.camera.base if isinstance(first.camera, RollingShutter) else first.camera
        pose = track.on_body(first)
        info = _camera_info(lens)
        is_lidar = lidar_of(first.camera) is not None
        rotation = pose.rotation @ R_LEVEL.T if is_lidar else pose.rotation
        static.append(_transform(_stamp(first), "body", name, pose.position, rotation))
        for frame in sequence:
            stamp = _stamp(frame)
            header = {"header": _header(stamp, name)}
            if is_lidar:
                cloud = _cloud(sweep(frame, options.max_relative_error, options.intensity))
                yield stamp, f"/{name}/points", "sensor_msgs/PointCloud2", header | cloud
                continue
            picture = write_color(out / "picture.png", frame)
            image = {"format": "png", "data": np.fromfile(picture, np.uint8)}
            picture.unlink()
            yield stamp, f"/{name}/image/compressed", "sensor_msgs/CompressedImage", header | image
            if info:
                yield stamp, f"/{name}/camera_info", "sensor_msgs/CameraInfo", header | info
            for topic, pixels in _pixels(frame, lens, options):
                yield stamp, f"/{name}/{topic}/image", "sensor_msgs/Image", header | _image(pixels)
    yield min(map(_stamp, frames)), "/tf_static", "tf2_msgs/TFMessage", {"transforms": static}


def _stamp(frame: Frame) -> int:
    """Return the time of a frame, ns; 0 without one."""
    return frame.time_ns or 0


def _pixels(frame: Frame, lens: Camera, options: BagOptions) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the topics of further images, and their pixels."""
    if options.labels:
        yield "labels", frame.layer("labels")
    if options.depth == "none":
        return
    depth = frame.layer("depth")
    ahead = lens.unproject().directions[..., 2]
    planar = lens.central and bool((ahead[lens.valid()] > 0).all())
    metres = np.where(depth > 0, depth * np.where(planar, ahead, 1.0), np.nan).astype(np.float32)
    if options.depth == "16UC1":
        mm = np.rint(1000 * metres)
        metres = np.where((mm > 0) & (mm < 1 << 16), mm, 0).astype(np.uint16)
    yield "depth" if planar else "range", metres


def _image(pixels: NDArray[Any]) -> dict[str, Any]:
    height, width = pixels.shape
    encoding = "32FC1" if pixels.dtype == np.float32 else "16UC1"
    size = {"height": height, "width": width, "step": width * pixels.itemsize}
    return {**size, "encoding": encoding, "data": np.frombuffer(pixels.tobytes(), np.uint8)}


def _camera_info(camera: Camera) -> dict[str, Any]:
    """Return the numbers of ``CameraInfo``; none where ROS has no such model."""
    for fisheye, convert in ((True, to_opencv_fisheye), (False, to_opencv)):
        try:
            K, D = convert(without_limit(camera))
        except ArgumentError:
            continue
        if fisheye and K[0, 1]:
            break  # OpenCV's skew of fisheyes is no part of the message
        if not fisheye and len(D) <= 4:
            D = np.append(D, 0.0)
        if fisheye:
            model = "equidistant"
        elif len(D) == 5:
            model = "plumb_bob"
        else:
            model = "rational_polynomial"
        size = {"height": camera.height, "width": camera.width, "distortion_model": model}
        return {**size, "d": D, "k": K, "r": np.eye(3), "p": np.column_stack([K, np.zeros(3)])}
    return {}


def _cloud(table: Any) -> dict[str, Any]:
    points = table[np.isfinite(table["x"])]
    fields = []
    for name, (dtype, offset) in points.dtype.fields.items():
        fields.append({"name": name, "offset": offset, "datatype": _DATATYPES[dtype.str], "count": 1})
    step = points.dtype.itemsize
    data = np.frombuffer(points.tobytes(), np.uint8)
    size = {"height": 1, "width": len(points), "point_step": step, "row_step": step * len(points)}
    return {"fields": fields, "data": data, "is_dense": True, **size}


def _of_imu(track: ImuTrack) -> Iterator[Message]:
    samples = track.samples()
    rates = track.path.motions(samples.times_ns).rates @ track.imu.pose.rotation
    rate = track.imu.rate
    covariances = {
        "angular_velocity_covariance": np.diag(np.square(track.imu.gyroscope.noise_density) * rate),
        "linear_acceleration_covariance": np.diag(np.square(track.imu.accelerometer.noise_density) * rate),
        "orientation_covariance": np.array([-1.0] + [0.0] * 8),  # -1: there is no orientation
    }
    for index, stamp in enumerate(samples.times_ns.tolist()):
        measured = {
            "header": _header(stamp, "body"),
            "angular_velocity": _xyz(samples.angular_velocity[index]),
            "linear_acceleration": _xyz(samples.specific_force[index]),
        }
        yield stamp, "/imu", "sensor_msgs/Imu", {**measured, **covariances}
        R_w_body = samples.rotations[index]
        pose = {"position": _xyz(samples.positions_w[index]), "orientation": _turn(R_w_body)}
        velocity = R_w_body.T @ samples.velocities_w[index]  # m/s in the body frame, as the message has it
        state = {
            "header": _header(stamp, "world"),
            "child_frame_id": "body",
            "pose": {"pose": pose},
            "twist": {"twist": {"linear": _xyz(velocity), "angular": _xyz(rates[index])}},
        }
        yield stamp, "/ground_truth/odometry", "nav_msgs/Odometry", state
