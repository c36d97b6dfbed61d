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
        scans = [lidar_of(camera) is not None for camera in cameras.values()]
        needs = {
            "depth": any(scans) or options.depth != "none",
            "lit": not all(scans),
            "labels": options.labels,
        }
        return ["imu", *(kind for kind, is_needed in needs.items() if is_needed)]

    def refuses(self, camera: Camera) -> str | None:
        _rosbags()
        return None

    def write(self, frames: Sequence[Frame], out: Path, options: BagOptions) -> list[Path]:
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
    """Return a message of nested fields."""

    def value(node: Any, description: Any, at: Any) -> Any:
        if node.name == "NAME":
            return _message(store, description, at or {})
        if node.name == "BASE":
            return at if at is not None else "" if description[0] == "string" else 0
        (of, item), count = description
        if of.name == "NAME":
            return [value(of, item, one) for one in at or ()]
        return np.zeros(count, item[0]) if at is None else np.asarray(at, item[0]).ravel()

    fields = store.fielddefs[kind][1]
    return store.types[kind](**{name: value(node, of, given.get(name)) for name, (node, of) in fields})


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
    for name, mine in by_camera(frames).items():
        camera = mine[0].camera
        lens = camera.base if isinstance(camera, RollingShutter) else camera
        pose = track.on_body(mine[0])
        info = _camera_info(lens)
        lidar = lidar_of(mine[0].camera) is not None
        turn = pose.rotation @ R_LEVEL.T if lidar else pose.rotation
        static.append(_transform(mine[0].time_ns or 0, "body", name, pose.position, turn))
        for frame in mine:
            header = {"header": _header(stamp := frame.time_ns or 0, name)}
            if lidar:
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
    first = min(frame.time_ns or 0 for frame in frames)
    yield first, "/tf_static", "tf2_msgs/TFMessage", {"transforms": static}


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
        D = D if fisheye or len(D) > 4 else np.append(D, 0.0)
        model = "equidistant" if fisheye else "plumb_bob" if len(D) == 5 else "rational_polynomial"
        size = {"height": camera.height, "width": camera.width, "distortion_model": model}
        return {**size, "d": D, "k": K, "r": np.eye(3), "p": np.column_stack([K, np.zeros(3)])}
    return {}


def _cloud(table: Any) -> dict[str, Any]:
    points = table[np.isfinite(table["x"])]
    fields = [
        {"name": name, "offset": offset, "datatype": _DATATYPES[type.str], "count": 1}
        for name, (type, offset) in points.dtype.fields.items()
    ]
    step = points.dtype.itemsize
    data = np.frombuffer(points.tobytes(), np.uint8)
    size = {"height": 1, "width": len(points), "point_step": step, "row_step": step * len(points)}
    return {"fields": fields, "data": data, "is_dense": True, **size}


def _of_imu(track: ImuTrack) -> Iterator[Message]:
    samples = track.samples()
    rates = track.path.motions(samples.times_ns).rates @ track.imu.pose.rotation
    noises = {"angular_velocity": track.imu.gyroscope, "linear_acceleration": track.imu.accelerometer}
    covariances = {
        f"{name}_covariance": np.diag(np.square(of.noise_density) * track.imu.rate)
        for name, of in noises.items()
    }
    covariances["orientation_covariance"] = np.array([-1.0] + [0.0] * 8)  # there is none
    for i, stamp in enumerate(samples.times_ns.tolist()):
        R = samples.rotations[i]
        position = samples.positions_w[i]
        force = _xyz(samples.specific_force[i])
        measured = {"angular_velocity": _xyz(samples.angular_velocity[i]), "linear_acceleration": force}
        yield stamp, "/imu", "sensor_msgs/Imu", {"header": _header(stamp, "body"), **measured, **covariances}
        pose = {"pose": {"position": _xyz(position), "orientation": _turn(R)}}
        moves = {"linear": _xyz(R.T @ samples.velocities_w[i]), "angular": _xyz(rates[i])}  # of the child
        state = {"header": _header(stamp, "world"), "child_frame_id": "body", "pose": pose}
        yield stamp, "/ground_truth/odometry", "nav_msgs/Odometry", {**state, "twist": {"twist": moves}}
