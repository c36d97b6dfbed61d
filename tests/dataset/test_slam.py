"""Sequences for SLAM: EuRoC's folder, KITTI's LiDAR, PCD and bags, as other programs read them."""

from functools import cache

import numpy as np
import pytest
import yaml
from evo.core import sync
from evo.tools import file_interface
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from plyfile import PlyData
from rosbags import highlevel
from support.exact import distance_to_surfaces

from mock_server import load_scene
from omniscv import dataset
from omniscv.errors import ArgumentError
from omniscv.geometry import R_LEVEL, Pose
from omniscv.geometry.trajectory_files import read_trajectory
from omniscv.job import load
from omniscv.job.file import EPOCH_NS
from omniscv.make import make

JOB = """
source: scene://six-wall
rig:
  cameras:
    left:
      camera: {model: kannala-brandt, width: 48, height: 40, fx: 15, fy: 15}
      position: [-0.1, 0, 0]
      yaw_deg: 10
    right:
      camera: {model: pinhole, width: 48, height: 40, fov_deg: 90}
      position: [0.1, 0, 0]
      time_offset: 0.01
    scan: {camera: {model: lidar, preset: vlp-16}, position: [0, -0.2, 0], pitch_deg: -5}
imu: {rate: 100, position: [0, 0.1, -0.1], yaw_deg: 20, gyroscope: {bias: 0.01, noise_density: 0.001}}
poses:
  - {time: 0, position: [0, 0, 1.5]}
  - {time: 0.2, position: [0.1, 0.02, 1.5], yaw_deg: 5}
  - {time: 0.35, position: [0.2, 0.05, 1.52], yaw_deg: 12, pitch_deg: 3}
  - {time: 0.5, position: [0.3, 0.05, 1.5], yaw_deg: 15}
modes: [lit, object_mask, depth, normals]
face_size: 64
classes: {rules: [{match: "Layout_*", class: room, stuff: true}], unmatched: other}
out: dataset
"""
EXPORTS = """
export:
  - {format: euroc, cameras: [left, right]}
  - {format: kitti_lidar, cameras: [scan], intensity: true}
  - {format: pcd, cameras: [scan]}
  - rosbag2
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    root = tmp_path_factory.mktemp("slam")
    (root / "job.yaml").write_text(JOB + EXPORTS)
    job = load(root / "job.yaml")
    assert job.assumed.startswith("imu: a spline through 4 poses, within")
    make(job)
    return job.out


@pytest.fixture(scope="module")
def frames(folder):
    return dataset.open(folder)


def of(frames, name):
    return [frame for frame in frames if frame.camera_name == name]


def T_world_scan(frame):
    """The sensor's pose: X ahead, Y left, Z up."""
    return Pose(frame.pose.position, frame.pose.rotation @ R_LEVEL.T)


def test_euroc(folder, frames):
    """evo reads the true state; with T_BS of a camera it is the pose of that camera's images."""
    root = folder / "exports/euroc/mav0"
    truth = file_interface.read_euroc_csv_trajectory(str(root / "state_groundtruth_estimate0/data.csv"))
    assert truth.num_poses == 51
    assert truth.check()[0]
    path = frames[0].imu.path
    for number, name in enumerate(("left", "right")):
        sensor = yaml.safe_load((root / f"cam{number}/sensor.yaml").read_text())
        T_body_cam = np.array(sensor["T_BS"]["data"]).reshape(4, 4)
        rows = (root / f"cam{number}/data.csv").read_text().splitlines()[1:]
        stamps = [row.split(",")[0] for row in rows]
        for stamp, frame in zip(stamps, of(frames, name), strict=True):
            assert int(stamp) == frame.time_ns
            assert (root / f"cam{number}/data/{stamp}.png").read_bytes() == frame.files["lit"].read_bytes()
            at = np.abs(truth.timestamps - frame.time).argmin()
            if abs(truth.timestamps[at] - frame.time) < 1e-6:
                T_world_cam = truth.poses_se3[at] @ T_body_cam
                np.testing.assert_allclose(T_world_cam[:3, 3], frame.pose.position, atol=1e-9)
                np.testing.assert_allclose(T_world_cam[:3, :3], frame.pose.rotation, atol=1e-9)
            body = path.at(frame.time_ns, steps_beyond=1)
            mount = Pose(T_body_cam[:3, 3], T_body_cam[:3, :3])
            mounted = body @ frames[0].imu.imu.pose @ mount
            np.testing.assert_allclose(mounted.position, frame.pose.position, atol=1e-9)
    assert sensor["camera_model"] == "pinhole"
    assert sensor["intrinsics"][2:] == [23.5, 19.5]  # pixel centres at whole numbers
    rows = (root / "imu0/data.csv").read_text().splitlines()
    measured = np.loadtxt(rows, delimiter=",")
    samples = frames[0].imu.samples()
    assert [int(line.split(",")[0]) for line in rows[1:]] == [EPOCH_NS + 10_000_000 * k for k in range(51)]
    np.testing.assert_array_equal(measured[:, 1:4], samples.angular_velocity)
    np.testing.assert_array_equal(measured[:, 4:], samples.specific_force)


def xyz(points):
    return np.stack([points[axis] for axis in "xyz"], axis=-1)


def kitti(folder, frame, i):
    root = folder / "exports/kitti_lidar"
    points = np.fromfile(root / f"velodyne/{i:06d}.bin", np.float32).reshape(-1, 4)
    assert 0 < points[:, 3].max() <= 1
    seconds = np.fromfile(root / f"seconds/{i:06d}.bin", np.float32)
    return points[:, :3], seconds, np.fromfile(root / f"labels/{i:06d}.label", np.uint32) >> 16


def pcd(folder, frame, i):
    points = read_pcd(folder / f"exports/pcd/{frame.key}.pcd")[1].ravel()
    points = points[np.isfinite(points["x"])]
    return xyz(points), points["time"], points["label"]


@cache
def messages_of(path):
    messages = {}
    with highlevel.AnyReader([path]) as reader:
        for connection, stamp, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            messages.setdefault(connection.topic, []).append((stamp, message))
    return messages


def bag(folder, frame, i):
    stamp, cloud = messages_of(folder / "exports/rosbag2/bag")["/scan/points"][i]
    assert stamp == frame.time_ns
    points = points_of(cloud)
    return xyz(points), points["time"], points["label"]


@pytest.mark.parametrize("form", [kitti, pcd, bag])
def test_points_lie_on_what_they_hit_when_each_is_placed_at_its_time(form, folder, frames):
    """The sensor at each point's time by the spline through the poses; what it hits by the scene's tracer."""
    room = load_scene("six-wall")
    path = frames[0].imu.path
    scans = of(frames, "scan")
    for i, frame in enumerate(scans):
        points, seconds, labels = form(folder, frame, i)
        assert len(points) == len(labels) > 10_000
        assert seconds.min() == 0 < 0.0999 < seconds.max() < 0.1
        mounted = path.at(frame.time_ns).inverse() @ T_world_scan(frame)
        rig = path.motions(frame.time_ns + np.rint(1e9 * seconds).astype(int))
        rotations = rig.rotations @ mounted.rotation
        origins = rig.positions_w + rig.rotations @ mounted.position
        rays = np.einsum("nij,nj->ni", rotations, points)
        reach = np.linalg.norm(rays, axis=1)
        hits = room.trace(origins, rays / reach[:, None])
        walls = np.isin(labels, [id for name, id in frame.instances.items() if name.startswith("Layout")])
        assert np.abs(hits.distance - reach)[walls].max() < 1e-4
        frozen = T_world_scan(frame).to_world(points) - (origins + rays)
        assert np.median(np.linalg.norm(frozen, axis=1)) > 0.01  # as if all were of one instant


def test_points_of_a_moving_scan_in_ply_lie_in_the_world(folder, frames, tmp_path):
    """Each was seen from where the sensor was then: walls are flat."""
    dataset.export(folder, "ply", tmp_path, cameras=["scan"])
    for frame in of(frames, "scan"):
        points = PlyData.read(tmp_path / f"{frame.key}.ply")["vertex"].data
        walls = [id for name, id in frame.instances.items() if name.startswith("Layout")]
        seen = points[np.isin(points["label"], walls) & (points["doubt"] == 0)]
        assert len(seen) > 10_000
        away = distance_to_surfaces(load_scene("six-wall"), xyz(seen))
        assert away.max() < 1e-4


def test_kitti_lidar(folder, frames):
    """As SemanticKITTI's own tools read it: the sensor's poses by poses.txt and Tr, labels and classes."""
    root = folder / "exports/kitti_lidar"
    calib = dict(line.split(": ") for line in (root / "calib.txt").read_text().splitlines())
    Tr = np.vstack([np.array(calib["Tr"].split(), float).reshape(3, 4), [0, 0, 0, 1]])
    scans = of(frames, "scan")
    first = T_world_scan(scans[0])
    for i, (frame, row) in enumerate(zip(scans, np.loadtxt(root / "poses.txt"), strict=True)):
        label = np.fromfile(root / f"labels/{i:06d}.label", np.uint32)
        pose = np.linalg.inv(Tr) @ np.vstack([row.reshape(3, 4), [0, 0, 0, 1]]) @ Tr
        np.testing.assert_allclose(first.to_world(pose[:3, 3]), frame.pose.position, atol=1e-9)
        kept = ~left_out(frame)
        np.testing.assert_array_equal(label >> 16, frame.layer("labels")[kept])
        np.testing.assert_array_equal(label & 0xFFFF, frame.layer("classes")[kept])
        doubt = np.fromfile(root / f"doubt/{i:06d}.bin", np.bool_)
        np.testing.assert_array_equal(doubt, frame.layer("doubt")[kept])
        assert (frame.layer("label_edge")[kept] <= doubt).all()


def left_out(frame):
    return frame.layer("unsure") | (frame.layer("depth_error") > 0.01 * frame.layer("depth"))


def read_pcd(path):
    header, _, data = path.read_bytes().partition(b"DATA binary\n")
    keys = dict(line.split(" ", 1) for line in header.decode().splitlines())
    codes = [t.lower() + s for t, s in zip(keys["TYPE"].split(), keys["SIZE"].split(), strict=True)]
    points = np.frombuffer(data, list(zip(keys["FIELDS"].split(), codes, strict=True)))
    return keys, points.reshape(int(keys["HEIGHT"]), int(keys["WIDTH"]))


def points_of(cloud):
    formats = [{7: "f4", 4: "u2", 2: "u1"}[field.datatype] for field in cloud.fields]
    offsets = [field.offset for field in cloud.fields]
    names = [field.name for field in cloud.fields]
    layout = {"names": names, "formats": formats, "offsets": offsets, "itemsize": cloud.point_step}
    return np.frombuffer(cloud.data, layout)


def test_pcd(folder, frames):
    """Organised, in the sensor's axes, with ring and time; VIEWPOINT is the sensor's pose."""
    frame = of(frames, "scan")[2]
    keys, points = read_pcd(folder / f"exports/pcd/{frame.key}.pcd")
    assert points.dtype.names == ("x", "y", "z", "ring", "time", "label", "class", "doubt")
    x, y, z, w, qx, qy, qz = map(float, keys["VIEWPOINT"].split())
    sensor = Pose.from_quaternion((x, y, z), (qx, qy, qz, w))
    np.testing.assert_allclose(sensor.rotation, T_world_scan(frame).rotation, atol=1e-12)
    assert points["ring"][:, 0].tolist() == [*range(15, -1, -1)]
    assert points["time"][0, 1] - points["time"][0, 0] == pytest.approx(55.296e-6, rel=1e-3)  # float32
    azimuth = np.arctan2(points["y"], points["x"])
    level = np.hypot(points["x"], points["y"])
    elevation = np.degrees(np.arctan2(points["z"], level))  # float32 has 7 digits
    seen = np.isfinite(elevation)
    np.testing.assert_allclose(elevation[seen], (-15.0 + 2 * points["ring"])[seen], atol=1e-4)
    fired = np.degrees(azimuth) - 180 + 3600 * (points["time"] - points["time"].min())
    np.testing.assert_allclose(((fired + 180) % 360 - 180)[seen], 0, atol=1e-4)
    np.testing.assert_array_equal(np.isnan(points["x"]), left_out(frame))


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_bags(folder, frames, storage, tmp_path):
    """rosbags, and of MCAP mcap, read the messages back: images, clouds, IMU, poses."""
    options = {"depth": "16UC1" if storage == "mcap" else "32FC1", "labels": True}
    dataset.export(folder, "rosbag2", tmp_path, storage=storage, **options)
    messages = messages_of(tmp_path / "bag")
    samples = frames[0].imu.samples()
    scans = of(frames, "scan")
    assert {topic: len(found) for topic, found in messages.items()} == {
        "/tf_static": 1, "/left/image/compressed": 3, "/left/camera_info": 3, "/right/image/compressed": 3,
        "/right/camera_info": 3, "/scan/points": 3, "/imu": 51, "/ground_truth/odometry": 51,
        "/left/range/image": 3, "/right/depth/image": 3, "/left/labels/image": 3, "/right/labels/image": 3,
    }  # fmt: skip
    assert messages["/left/camera_info"][0][1].distortion_model == "equidistant"
    assert messages["/right/camera_info"][0][1].distortion_model == "plumb_bob"
    stamp, image = messages["/right/image/compressed"][1]
    assert stamp == EPOCH_NS + 210_000_000
    assert image.data.tobytes() == of(frames, "right")[1].files["lit"].read_bytes()
    imu = messages["/imu"][7][1]
    assert imu.linear_acceleration.z == samples.specific_force[7, 2]
    assert imu.orientation_covariance[0] == -1
    np.testing.assert_allclose(imu.angular_velocity_covariance, np.diag([1e-4] * 3).ravel())
    shown = messages["/right/depth/image"][1][1]
    seen = of(frames, "right")[1].layer("depth")
    ahead = of(frames, "right")[1].camera.unproject()
    wanted = seen * ahead.directions[..., 2] * (1000 if storage == "mcap" else 1)
    pixels = shown.data.view({"16UC1": "<u2", "32FC1": "<f4"}[shown.encoding]).reshape(40, 48)
    np.testing.assert_allclose(pixels, wanted, rtol=1e-6, atol=0.5 if storage == "mcap" else 0)
    odometry = messages["/ground_truth/odometry"][7][1]
    assert odometry.twist.twist.angular.x == pytest.approx(samples.angular_velocity[7, 0], abs=0.05)
    static = {t.child_frame_id: t.transform for t in messages["/tf_static"][0][1].transforms}
    cloud = messages["/scan/points"][2][1]
    names = [field.name for field in cloud.fields]
    assert names == ["x", "y", "z", "ring", "time", "label", "class", "doubt"]
    points = points_of(cloud)
    on_body = static["scan"]
    at = messages["/ground_truth/odometry"][35][1].pose.pose
    T_world_body, T_body_scan = (
        Pose.from_quaternion([t.x, t.y, t.z], [q.x, q.y, q.z, q.w])
        for t, q in ((at.position, at.orientation), (on_body.translation, on_body.rotation))
    )
    wanted = T_world_scan(scans[2]).to_world(xyz(points))
    np.testing.assert_allclose((T_world_body @ T_body_scan).to_world(xyz(points)), wanted, atol=1e-9)
    if storage == "mcap":
        with next((tmp_path / "bag").glob("*.mcap")).open("rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            found = [decoded for *_, decoded in reader.iter_decoded_messages(topics=["/imu"])]
        assert len(found) == 51
        assert found[7].linear_acceleration.z == imu.linear_acceleration.z


def test_kalibr(folder, frames, tmp_path):
    """One chain of both cameras, though one is late: their poses on the IMU."""
    dataset.export(folder, "kalibr", tmp_path, cameras=["left", "right"])
    chain = yaml.safe_load((tmp_path / "camchain.yaml").read_text())
    for number, name in enumerate(("left", "right")):
        frame = of(frames, name)[1]
        entry = chain[f"cam{number}"]
        T_cam_imu = np.array(entry["T_cam_imu"])
        mounted = Pose(T_cam_imu[:3, 3], T_cam_imu[:3, :3]).inverse()
        camera = frames[0].imu.path.at(frame.time_ns) @ frames[0].imu.imu.pose @ mounted
        np.testing.assert_allclose(camera.position, frame.pose.position, atol=1e-9)
        assert entry["timeshift_cam_imu"] == 0
    T_1_0 = np.array(chain["cam1"]["T_cam_imu"]) @ np.linalg.inv(chain["cam0"]["T_cam_imu"])
    np.testing.assert_allclose(chain["cam1"]["T_cn_cnm1"], T_1_0, atol=1e-12)


def test_stamps_come_out_as_they_came_in(tmp_path):
    """The first ones of EuRoC's V1_01 (nine as published, one by their steps), of odd nanoseconds, which
    no float64 of seconds holds; and the IMU's equal steps."""
    odd = [302142976, 307142912, 312143104, 317143040, 322142976, 327142912, 332143104, 337143040, 342142976]
    stamps = [1403715274 * 10**9 + part for part in (*odd, 347142912)]
    rows = [f"{stamp},{0.01 * k},0,1.5,0.5,-0.5,0.5,-0.5" for k, stamp in enumerate(stamps)]
    (tmp_path / "data.csv").write_text("\n".join(rows) + "\n")
    lens = {"model": "pinhole", "width": 8, "height": 6, "fov_deg": 90}
    job = load({"source": "scene://four-wall", "cameras": {"cam": lens}, "imu": {}, "modes": ["lit"],
                "poses": {"file": str(tmp_path / "data.csv"), "frame": "camera"}, "face_size": 8,
                "out": str(tmp_path / "out"), "export": ["euroc", "poses", "rosbag2"]})  # fmt: skip
    make(job)
    assert [frame.time_ns for frame in dataset.open(job.out)] == stamps
    exports = job.out / "exports"
    for path in (exports / "euroc/mav0/cam0/data.csv", exports / "poses/cam.euroc"):
        assert [int(line.split(",")[0]) for line in path.read_text().splitlines()[1:]] == stamps
    assert {path.stem for path in (exports / "euroc/mav0/cam0/data").iterdir()} == {*map(str, stamps)}
    decimals = [f"{stamp // 10**9}.{stamp % 10**9:09d}".rstrip("0") for stamp in stamps]
    assert [line.split()[0] for line in (exports / "poses/cam.tum").read_text().splitlines()[1:]] == decimals
    assert (exports / "poses/cam.times").read_text().split() == decimals
    imu = [line.split(",")[0] for line in (exports / "euroc/mav0/imu0/data.csv").read_text().splitlines()[1:]]
    assert set(np.diff(list(map(int, imu))).tolist()) == {5_000_000}
    assert stamps[-1] <= int(imu[-1]) < stamps[-1] + 5_000_000
    of_bag = messages_of(exports / "rosbag2/bag")
    assert [stamp for stamp, _ in of_bag["/cam/image/compressed"]] == stamps
    for name in ("tum", "kitti"):
        assert read_trajectory(exports / f"poses/cam.{name}").times_ns == tuple(stamps)
    truth = file_interface.read_euroc_csv_trajectory(str(exports / "poses/cam.euroc"))
    tum = file_interface.read_tum_trajectory_file(str(exports / "poses/cam.tum"))
    assert sync.associate_trajectories(truth, tum)[0].num_poses == 10


def test_what_is_refused_before_the_first_capture(tmp_path):
    """A table is relative to the job's file; presets are no files."""
    path = tmp_path / "job.yaml"
    (tmp_path / "beams.csv").write_text("elevation_deg\n5\n-5\n")
    path.write_text(JOB.replace("preset: vlp-16", "preset: beams.csv, width: 90"))
    assert load(path).cameras["scan"].height == 2
    for old, new, says in (
        ("cameras: [left, right]}", "cameras: [scan]}", "euroc: cannot carry camera 'scan'"),
        ("cameras: [scan], intensity: true}", "}", "kitti_lidar: cannot carry camera 'left'"),
        ("imu: {rate: 100", "#", "euroc: expected frames with imu"),
        ("time: 0.35, ", "", "expected a time for every pose"),
    ):
        assert old in JOB + EXPORTS
        path.write_text((JOB + EXPORTS).replace(old, new, 1).replace("six-wall", "nowhere"))
        with pytest.raises(ArgumentError, match=says):
            make(load(path))


@pytest.mark.parametrize("limit", [None, 4], ids=["all", "limited"])
def test_a_camera_beside_an_imu_has_the_rate_of_the_job(tmp_path, limit):
    lens = {"model": "pinhole", "width": 8, "height": 6, "fov_deg": 90}
    line = {"waypoints": [[-1, 0, 1.5], [1, 0, 1.5]], "speed": 1, "rate": 8}
    job = load({"source": "scene://four-wall", "cameras": {"cam": lens}, "imu": {}, "modes": ["lit"],
                "poses": {"path": line}, "face_size": 8, "out": str(tmp_path / "out"),
                "export": ["euroc"]})  # fmt: skip
    make(job, limit=limit)
    text = (job.out / "exports/euroc/mav0/cam0/sensor.yaml").read_text()
    assert yaml.safe_load(text)["rate_hz"] == pytest.approx(8, rel=1e-6)
