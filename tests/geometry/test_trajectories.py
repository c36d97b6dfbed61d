"""Trajectory files of SLAM benchmarks: read, written, and between their poses."""

import numpy as np
import pytest
from evo.core import metrics, trajectory
from evo.tools import file_interface
from scipy.spatial.transform import Rotation

from omniscv.cli import run
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry import trajectory_files as files
from omniscv.geometry.instant import object_pose
from omniscv.geometry.trajectory import Trajectory, all_parsed, nanoseconds, parsed
from omniscv.geometry.trajectory_files import read_trajectory
from omniscv.job import load

JOB = "source: scene://four-wall\ncameras: {p: {model: pinhole, width: 8, height: 8, fov_deg: 60}}\nposes: "


def wandering(count=40):
    draw = np.random.default_rng(5)
    turns = Rotation.random(count, rng=draw).as_matrix()
    poses = tuple(Pose(place, R) for place, R in zip(draw.normal(size=(count, 3)) * 30, turns, strict=True))
    return Trajectory.timed(poses, tuple(np.cumsum(draw.uniform(0.01, 0.4, count)).tolist()))


def matrices(poses):
    return [np.vstack([np.column_stack([p.rotation, p.position]), [0, 0, 0, 1]]) for p in poses]


@pytest.mark.parametrize("kind", ["tum", "euroc", "kitti"])
def test_evo_reads_what_was_written_and_so_do_we(kind, tmp_path):
    """Its own absolute pose error, of positions and of angles, against poses that no file has held."""
    poses = wandering()
    path = tmp_path / f"path.{kind}"
    path.write_text(getattr(files, f"write_{kind}")(poses))
    expected = matrices(poses)
    if kind == "kitti":
        read = file_interface.read_kitti_poses_file(path)
        reference = trajectory.PosePath3D(poses_se3=[np.linalg.inv(expected[0]) @ each for each in expected])
    else:
        readers = {"tum": "read_tum_trajectory_file", "euroc": "read_euroc_csv_trajectory"}
        read = getattr(file_interface, readers[kind])(path)
        reference = trajectory.PoseTrajectory3D(poses_se3=expected, timestamps=np.array(poses.seconds))
        np.testing.assert_allclose(read.timestamps, poses.seconds, atol=1e-9)
    for relation in (metrics.PoseRelation.translation_part, metrics.PoseRelation.rotation_angle_rad):
        error = metrics.APE(relation)
        error.process_data((reference, read))
        assert error.get_statistic(metrics.StatisticsType.max) < 1e-7  # arccos near 0 has no more digits
    np.testing.assert_allclose(read.poses_se3, reference.poses_se3, atol=1e-12)
    (tmp_path / "path.times").write_text(files.write_kitti_times(poses))
    read = read_trajectory(path, first=poses[0])
    np.testing.assert_allclose(matrices(read), matrices(poses), atol=1e-12)
    assert read.seconds == pytest.approx(poses.seconds, abs=5e-10)  # EuRoC counts nanoseconds


def test_kitti_without_times_has_none(tmp_path):
    (tmp_path / "00.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1 1\n")
    read = read_trajectory(tmp_path / "00.txt")
    assert read.times_ns is None
    assert [line.split()[0] for line in files.write_tum(read).splitlines()[1:]] == ["0", "1"]
    assert files.write_euroc(read).splitlines()[2].startswith("1000000000,")
    np.testing.assert_allclose(read[1].position, (1, 0, 0), atol=1e-12)  # level: the camera's z is ahead
    with pytest.raises(ArgumentError, match="expected poses with times"):
        read.at(500_000_000)


def test_between_poses_positions_are_linear_and_turns_steady():
    first, last = Pose.from_angles((0, 0, 1)), Pose.from_angles((3, 6, 1), yaw_deg=90)
    poses = Trajectory.timed((first, last), (10.0, 13.0))
    assert poses[1:].times_ns == poses.times_ns[1:]
    third = poses.at(11 * 10**9)
    np.testing.assert_allclose(third.position, (1, 2, 1), atol=1e-12)
    assert third.angles() == pytest.approx((30, 0, 0), abs=1e-9)
    for time, pose in zip(poses.seconds, poses, strict=True):
        np.testing.assert_allclose(poses.at(nanoseconds(time)).rotation, pose.rotation, atol=1e-12)
    for outside in (9.9, 13.1):
        with pytest.raises(ArgumentError, match="time: expected 10 to 13 s, got"):
            poses.at(nanoseconds(outside))


def test_wrong_trajectories():
    two = (Pose.from_angles((0, 0, 1.5)), Pose.from_angles((1, 0, 1.5)))
    for poses, times, says in (
        ((), None, "at least one pose"),
        (two, (1,), "one per pose, got 1 for 2"),
        (two, (1, 1), "increasing seconds, got 0.000000001 after 0.000000001"),
        (two, (1.0, 2.0), "whole nanoseconds, got 1.0, or others; Trajectory.timed takes seconds"),
    ):
        with pytest.raises(ArgumentError, match=says):
            Trajectory(poses, times)


@pytest.mark.parametrize(
    ("poses", "looks", "says"),
    [
        ("{file: path.txt, frame: body}", (1, 0, 0), ""),
        ("{file: path.txt, frame: camera}", (0, 0, 1), ""),
        ("path.txt", (0, 0, 1), "poses: path.txt: taken as poses of a camera, z forward, which mostly"),
    ],
)
def test_the_frame_of_a_file_is_stated_or_said(poses, looks, says, tmp_path, capsys):
    (tmp_path / "path.txt").write_text("0 1 0 1.5 0 0 0 1\n1 1 1 1.5 0 0 0 1\n")
    job = tmp_path / "job.yaml"
    job.write_text(f"{JOB}{poses}\nout: {tmp_path}/out\n")
    assert [pose.t_w_c.tolist() for pose in load(job).poses] == [[1, 0, 1.5], [1, 1, 1.5]]
    assert load(job).times_ns == (0, 10**9)
    for pose in load(job).poses:
        np.testing.assert_allclose(pose.R_w_c @ (0, 0, 1), looks, atol=1e-12)
    assert run(["render", str(job)]) == 0
    assert capsys.readouterr().err.startswith(f"omniscv: {says}" if says else "")
    assert load(job).assumed.startswith(says)


@pytest.mark.parametrize(
    "rows",
    [
        "x,y,z,yaw,pitch,roll\n1,2,3,90,-10,5",
        "time, roll_deg, pitch_deg, yaw_deg, x, y, z\n7, 5, -10, 90, 1, 2, 3",
        f"X,Y,Z,Yaw_rad,Pitch_rad,Roll_rad\n1,2,3,{np.pi / 2},{np.radians(-10)},{np.radians(5)}",
    ],
)
def test_a_table_has_the_angles_of_a_pose(rows, tmp_path):
    path = tmp_path / "poses.csv"
    path.write_text(rows + "\n")
    poses = read_trajectory(path)
    assert poses.seconds == ((7.0,) if "time" in rows else None)
    wanted = Pose.from_angles((1, 2, 3), 90, -10, 5)
    np.testing.assert_allclose(poses[0].position, wanted.position)
    np.testing.assert_allclose(poses[0].rotation, wanted.rotation, atol=1e-12)
    of_object = read_trajectory(path, frame="object")[0]  # unturned, its axes are the world's
    np.testing.assert_allclose(of_object.rotation, object_pose((1, 2, 3), 90, -10, 5).rotation, atol=1e-12)


def test_columns_of_trackers_that_are_nothing_of_a_pose(tmp_path):
    (tmp_path / "a.csv").write_text(
        "frame_idx,timestamp,state,is_lost,x,y,z,q_x,q_y,q_z,q_w,vx,vel_y,velocity.z\n"
        "7,0.5,2,false,1,2,3,0.1,0.5,0.5,0.7,9,9,9\n8,0.6,2,true,1,2,4,0,0,0,1,9,9,9\n"
    )
    read = read_trajectory(tmp_path / "a.csv")
    assert read.seconds == (0.5, 0.6)
    np.testing.assert_array_equal([pose.position for pose in read], [[1, 2, 3], [1, 2, 4]])
    np.testing.assert_allclose(read[0].quaternion(), [0.1, 0.5, 0.5, 0.7])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("x,y,yaw\n1,2,3\n", "path.txt: line 1: expected columns x, y and z, got no z"),
        ("x,y,z,jaw\n1,2,3,4\n", "line 1: expected names of columns among time, x, .*; got 'jaw'"),
        ("x,y,z,qw,yaw\n1,2,3,4,5\n", "line 1: expected qx, qy, qz and qw, or yaw"),
        ("x,y,z\n1,2\n", "line 1: expected 3 columns, as there are names, got 2 in one row"),
        ("x,y,z\n1,2,3\n\n1,2\n", "line 4: expected 'x,y,z', got '1,2'"),
        ("x,y,z\n", "expected rows of numbers below the names"),
        ("x,y,z,yaw,yaw_rad\n1,2,3,4,5\n", "line 1: expected each column once, got yaw twice"),
        ("x,y,z,yaw\n1,,3,4\n", "line 2: expected"),
        ("x;y;z\n1,5;2;3\n", "line 1: expected decimal points, got a comma"),
        ("x;y;z\n1;2;3\n1;2;3,5\n", "line 3: expected decimal points, got a comma"),
        ("0,1 1,5 2,0 0,5 0,0 0,0 0,0 1,0\n", "line 1: expected decimal points, got a comma"),
        ("time,x,y,z\n1e30,0,0,0\n", "time: expected seconds"),
        ("0 0 0 0 0 0 0 1\n3e7 0 0 0 0 0 0 1\n6e7 0 0 0 0 0 0 1\n", "steps of 30000000; name the column"),
        ("# time_h tx ty tz qx qy qz qw\n0 0 0 0 0 0 0 1\n", "expected names of columns|names"),
        ("time [h],x,y,z\n0,0,0,0\n", "expected time in s or ms or us or ns or sec, got 'h'"),
        ("x [ft],y [ft],z [ft]\n1,2,3\n", "line 1: expected x in m or cm or mm, got 'ft'"),
        ("1,2,0,0,0,0,0,0,1\n", "8 or 17 columns with a separator .*got 9 columns without names"),
        ("1,2,3,4,5,6,7,8\n", "line 1: expected a quaternion of length 1"),
        ("x y z qw qx qy qz\n1 2 3 1 0 0 0\n1 2 3 0 0 0 0\n", "line 3: expected a quaternion of length 1"),
        ("", "got none"),
        ("\xe4\xf6", r"path.txt: 'utf-8' codec"),
        ("0 1 2 3 0 0\n", "line 1: expected names of the columns, or 8"),
        ("0 1 2 nan 0 0 0 1\n", "line 1: expected finite numbers"),
        ("0 1 2 1e10 0 0 0 1\n", "line 1: expected coordinates of at most"),
        ("1 0 0 0 0 0 0 1\n0 0 0 0 0 0 0 1\n", "increasing"),
        ("1 0 0 0 0 1 0 0 0 0 -1 0\n", "line 1: expected the numbers of a rigid"),
        ("#t\n100,0,0,0,1,0,0,0\n1.5,0,0,0,1,0,0,0\n", "line 3: expected 'time x y z qw qx qy qz'"),
        ("9" * 400 + ",0,0,0,1,0,0,0\n", "line 1: expected 'time x y z qw qx qy qz'"),
        ("0 0 0 0 0 0 0 1\n# rest\n1 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n", "line 4: expected one pose at a"),
    ],
)
def test_a_wrong_line_is_named(text, says, tmp_path):
    path = tmp_path / "path.txt"
    with pytest.raises(ArgumentError, match=r"path.txt: expected a readable file"):
        read_trajectory(path)
    path.write_text(text, encoding="latin-1")
    with pytest.raises(ArgumentError, match=says):
        read_trajectory(path)


def test_what_a_file_says_of_itself_is_heeded(tmp_path):
    path = tmp_path / "path.txt"

    def read(text, frame="camera"):
        path.write_text(text)
        return read_trajectory(path, frame=frame)[-1]

    for mark in ";\t":
        pose = read("x,y,z,qx,qy,qz,qw\n1,2,3,0,0,0,1\n".replace(",", mark))
        np.testing.assert_array_equal(pose.t_w_c, (1, 2, 3))
        np.testing.assert_array_equal(pose.R_w_c, np.eye(3))
    pose = read("# timestamp tx ty tz qw qx qy qz\n0 1 2 3 1 0 0 0\n")
    np.testing.assert_array_equal(pose.R_w_c, np.eye(3))
    drive = read("1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 534 0 1 0 2 0 0 1 0\n", frame="body")
    np.testing.assert_allclose(drive.t_w_c, (534, 2, 0), atol=1e-9)
    np.testing.assert_allclose(drive.R_w_c @ (0, 0, 1), (1, 0, 0), atol=1e-12)
    down = read("x,y,z,pitch\n0,0,0,30\n", frame="body")  # ROS: about y, which points to the left
    np.testing.assert_allclose(down.R_w_c @ (0, 0, 1), (np.sqrt(0.75), 0, -0.5), atol=1e-12)


@pytest.mark.parametrize(
    ("text", "times", "says"),
    [
        ("1403636579763555584.000000 0 0 0 0 0 0 1\n", (1403636579.7635555,), "taken as ns since 1970"),
        ("1403636579763,0,0,0,1,0,0,0\n", (1403.636579763,), "EuRoC's body"),
        ("time,x,y,z\n1403636579763,0,0,0\n", (1403636579.763,), "taken as ms since 1970"),
        ("t_ms,x,y,z\n1500,0,0,0\n", (1.5,), ""),
        ("x,y,z,timestamp [us]\n0,0,0,1500\n", (0.0015,), ""),
        ("#sec,nsec,x,y,z,qx,qy,qz,qw\n1,2,0,0,0,0,0,0,1\n", (1.000000002,), ""),
        ("%time,field.header.seq,field.pose.position.x,field.pose.position.y,field.pose.position.z\n"
         "1403636579763555584,1,0,0,0\n", (1403636579.7635555,), "taken as ns"),
        ("0 0 0 0 0 0 0 1\n33 1 0 0 0 0 0 1\n66 2 0 0 0 0 0 1\n", (0, 33, 66), "steps of 33 are taken"),
        ("1000 0 0 0 0 0 0 1\n1033 1 0 0 0 0 0 1\n", (1000, 1033), "steps of 33 are taken"),
        ("0 0 0 0 0 0 0 1\n5 1 0 0 0 0 0 1\n10 2 0 0 0 0 0 1\n", (0, 5, 10), "steps of 5 are taken"),
        ("0 0 0 0 0 0 0 1\n2.5 1 0 0 0 0 0 1\n5.5 2 0 0 0 0 0 1\n", (0, 2.5, 5.5), ""),
        ("time_s,x,y,z\n0,0,0,0\n33,0,0,0\n66,0,0,0\n", (0, 33, 66), ""),
        ("5 0 0 0 0 0 0 1\n5 0.0001 0 0 0 0 0 1\n6 0 0 0 0 0 0 1\n", (5, 6), "1 rows that repeat"),
    ],
)  # fmt: skip
def test_the_unit_of_times(text, times, says, tmp_path):
    (tmp_path / "path.txt").write_text(text)
    read = read_trajectory(tmp_path / "path.txt")
    assert read.seconds == times
    assert len(read) == len(times)
    assert says in "".join(read.says)
    assert bool(says) == bool(read.says)


def test_the_camera_on_a_body(tmp_path):
    """EuRoC's ground truth is of its IMU, whose x points up: T_BS of the published cam0, or Kalibr's chain,
    puts a camera on it."""
    T_BS = np.array([[0.0148655429818, -0.999880929698, 0.00414029679422, -0.0216401454975],
                     [0.999557249008, 0.0149672133247, 0.025715529948, -0.064676986768],
                     [-0.0257744366974, 0.00375618835797, 0.999660727178, 0.00981073058949],
                     [0, 0, 0, 1]])  # fmt: skip
    lens = "intrinsics: [458.654, 457.296, 367.215, 248.375]\nresolution: [752, 480]\ncamera_model: pinhole\n"
    sensor = f"{lens}distortion_model: radial-tangential\ndistortion_coefficients: [-0.28, 0.07, 0, 0]\n"
    sensor += f"T_BS: {{cols: 4, rows: 4, data: {T_BS.ravel().tolist()}}}\n"
    (tmp_path / "sensor.yaml").write_text(sensor)
    chain = f"{lens}distortion_model: radtan\ndistortion_coeffs: [-0.28, 0.07, 0, 0]\n"
    chain = "  ".join(f"cam0:\n{chain}T_cam_imu: {np.linalg.inv(T_BS).tolist()}\n".splitlines(keepends=True))
    (tmp_path / "chain.yaml").write_text(chain)
    q = Rotation.from_euler("ZYX", [30, -88, 10], degrees=True)
    x, y, z, w = q.as_quat()
    (tmp_path / "data.csv").write_text(f"1403636579763555584,4.6,-1.7,0.8,{w},{x},{y},{z}\n")
    T_WB = np.eye(4)
    T_WB[:3, :3] = q.as_matrix()
    T_WB[:3, 3] = (4.6, -1.7, 0.8)
    job = tmp_path / "job.yaml"
    for poses in ("{file: data.csv, frame: sensor.yaml}", "{file: data.csv, frame: chain.yaml}"):
        job.write_text(JOB + poses)
        read = load(job)
        np.testing.assert_allclose(matrices(read.poses)[0], T_WB @ T_BS, atol=1e-9)
        assert not read.assumed
    job.write_text(f"{JOB}data.csv")
    assert "the rotation is that of EuRoC's body, an IMU" in load(job).assumed
    job.write_text(f"{JOB}{{file: data.csv, frame: imu}}")
    with pytest.raises(ArgumentError, match=r"poses.frame: .*imu: expected a readable file"):
        load(job)


@pytest.mark.parametrize("per_s", [1, 10**3, 10**6, 10**9])
def test_many_times_are_read_as_each_alone(per_s):
    """Digits and a point are read without decimal arithmetic; all else, and more digits, with it."""
    rng = np.random.default_rng(5)
    whole = [str(number) for number in rng.integers(0, 2**60, 200)]
    texts = [*whole, *(f"{text[:7]}.{text[7 : 7 + i % 14]}" for i, text in enumerate(whole))]
    texts += ["-3.25", "1e9", "12.", "+4", ".5", "1_0", "1403715273.262142976", "1.0000000005"]
    assert all_parsed(texts, per_s) == [parsed(text, per_s) for text in texts]


def test_a_long_file_says_how_far_it_is_read(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(files, "_SAID_EVERY_S", 0.0)
    monkeypatch.setattr(files, "_LOOKED_EVERY", 100)
    rows = "".join(f"{i} 0 0 {i} 0 0 0 1\n" for i in range(1000))
    (tmp_path / "long.tum").write_text(rows)
    assert len(read_trajectory(tmp_path / "long.tum")) == 1000
    said = [record.getMessage() for record in caplog.records]
    assert said[0] == f"{tmp_path / 'long.tum'}: 100 rows read"
    assert 3 < len(said) < 10
