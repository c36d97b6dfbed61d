"""PLY, and a job's dataset in all formats of geometry at once: poses, cameras, depth, points, flow."""

import json
from dataclasses import replace

import numpy as np
import pycolmap
import pytest
from plyfile import PlyData
from support.datasets import made
from support.exact import distance_to_surfaces, float_source
from support.traced_frames import frame_of, traced, traced_frame

import mock_server
from omniscv import Pose, calibration, cameras, dataset, render
from omniscv.dataset import get
from omniscv.errors import ArgumentError
from omniscv.geometry.trajectory_files import read_trajectory

SCENE = mock_server.load_scene("four-wall")
CAMERA = cameras.create("fisheye-equidistant", width=40, height=40, fov_deg=185)
POSES = [Pose.from_angles((0.4, 0.3, 1.4), 20, 5, -3), Pose.from_angles((1.4, 0.1, 1.2), 80)]
NORMALS = ("nx", "ny", "nz")
COLORS = ("red", "green", "blue")


def columns(table, names):
    return np.stack([table[each] for each in names], axis=-1)


def test_plyfile_reads_a_frame_to_the_bit(tmp_path):
    frame = traced_frame(tmp_path, SCENE, CAMERA, POSES[0])
    path, cloud = get("ply").export([frame], tmp_path, {})
    assert (path.name, cloud.name) == ("cam.ply", "cloud.ply")
    layers = traced(SCENE, CAMERA, POSES[0])
    pose = POSES[0]
    seen = layers["depth"] > 0
    rays = CAMERA.unproject()
    points_w = pose.position + layers["depth"][seen, None] * (rays.directions[seen] @ pose.rotation.T)

    read = PlyData.read(path)
    vertex = read["vertex"].data
    np.testing.assert_allclose(columns(vertex, "xyz"), points_w, atol=1e-6)
    assert distance_to_surfaces(SCENE, columns(vertex, "xyz").astype(float)).max() < 1e-3
    np.testing.assert_array_equal(columns(vertex, COLORS), layers["lit"][seen])
    np.testing.assert_array_equal(vertex["label"], layers["labels"][seen])
    np.testing.assert_allclose(columns(vertex, NORMALS), layers["normals"][seen] @ pose.rotation.T, atol=1e-6)
    assert [vertex.dtype[each].str for each in ("x", "nx", "red", "label")] == ["<f4", "<f4", "|u1", "<u2"]
    assert f"label {SCENE.label('Chair_1')} Chair_1" in read.comments


def test_trimesh_reads_the_merged_cloud(tmp_path):
    """It keeps, of each cube, a point of one of the frames, and of the camera that is nearer."""
    import trimesh  # here: each worker of pytest imports all test files

    frames = [traced_frame(tmp_path, SCENE, CAMERA, pose, key=f"cam-{i}") for i, pose in enumerate(POSES)]
    one, other, cloud = get("ply").export(frames, tmp_path, {"voxel": 0.1})
    merged = trimesh.load(cloud)
    apart = [columns(PlyData.read(path)["vertex"].data, "xyz") for path in (one, other)]
    away = [np.linalg.norm(each - pose.position, axis=1) for each, pose in zip(apart, POSES, strict=True)]
    cubes, cube_of = np.unique(cube(np.concatenate(apart).astype(float)), axis=0, return_inverse=True)
    nearest = np.full(len(cubes), np.inf)
    np.minimum.at(nearest, cube_of, np.concatenate(away))
    assert len(merged.vertices) == pytest.approx(len(cubes), abs=3)  # float32 may cross a cube's side
    assert len(cubes) < 0.9 * len(cube_of)

    given = set(map(tuple, np.concatenate(apart).astype(float).tolist()))
    assert set(map(tuple, merged.vertices.tolist())) <= given
    best = dict(zip(map(tuple, cubes.tolist()), nearest, strict=True))
    wanted = np.array([best[tuple(each)] for each in cube(merged.vertices).tolist()])
    to_cameras = [np.linalg.norm(merged.vertices - pose.position, axis=1) for pose in POSES]
    assert np.mean(np.abs(to_cameras - wanted).min(axis=0) < 1e-5) > 0.999


def cube(points):
    return np.floor(points / 0.1 + 0.5).astype(int)


def test_properties_are_the_layers_of_the_frames(tmp_path):
    layers = traced(SCENE, CAMERA, POSES[0])
    depth = layers["depth"]
    half = np.arange(1600).reshape(40, 40) % 2 == 0

    def exported(layers, **options):
        (path,) = get("ply").export([frame_of(tmp_path, layers, CAMERA, POSES[0])], tmp_path, options)
        return path.name, PlyData.read(path)["vertex"]

    assert [each.name for each in exported({"depth": depth}, cloud=False)[1].properties] == ["x", "y", "z"]
    assert exported({"depth": depth}, frames=False)[0] == "cloud.ply"
    unsure = {"depth": depth, "unsure": np.ones((40, 40), bool)}
    assert len(exported(unsure, cloud=False)[1].data) == 0
    seen = CAMERA.valid() & np.isfinite(depth) & (depth > 0)
    marked = exported({"depth": depth, "label_edge": half}, cloud=False)[1]
    np.testing.assert_array_equal(marked["doubt"], half[seen])
    with pytest.raises(ArgumentError, match="expected a frame with depth"):
        exported({"lit": layers["lit"]})


def test_points_in_the_air_are_left_out(tmp_path):
    """Whole cubes at few centres put points beside surfaces, within their bounds: those of more than 1 % have
    none."""
    camera = cameras.create("noncentral-panorama", width=96, height=48, radius=0.6)
    way = {"strategy": "cube", "viewpoints": 6, "face_size": 128}
    image = render(camera, POSES[0], float_source(SCENE), modes=("object_mask", "depth"), **way)
    frame = frame_of(tmp_path, {name: image[name] for name in ("depth", "depth_error")}, camera, POSES[0])
    farthest = {}
    for limit in (0.01, None):
        (path,) = get("ply").export([frame], tmp_path, {"cloud": False, "max_relative_error": limit})
        xyz = columns(PlyData.read(path)["vertex"].data, "xyz").astype(float)
        farthest[limit] = distance_to_surfaces(SCENE, xyz).max()
    assert farthest[0.01] < 0.05 < 0.2 < farthest[None]


EXPORTS = """
truth: {poses: true, flow: {backward: true}, tolerance: {abs_m: 0.03}}
export:
  - {format: ply, voxel: 0.1, max_relative_error: 0.001}
  - {format: depth-png, scale: stanford2d3d}
  - poses
  - {format: kalibr, cameras: [lens]}
  - {format: colmap, points: 0.2}
  - nerfstudio
"""


@pytest.fixture(scope="module")
def exports(tmp_path_factory):
    return made(tmp_path_factory.mktemp("job"), more=EXPORTS) / "exports"


def test_each_camera_has_a_trajectory_in_the_order_of_times(exports):
    """Made again, all exports are the same bytes."""
    assert dataset.check(exports.parent, deep=True) == []
    frames = [frame for frame in dataset.open(exports.parent) if frame.camera_name == "lens"]
    for kind in ("tum", "euroc", "kitti"):
        read = read_trajectory(exports / f"poses/lens.{kind}", first=frames[0].pose)
        assert read.seconds == pytest.approx([0, 0.5, 1])
        for pose, frame in zip(read, frames, strict=True):
            np.testing.assert_allclose(pose.position, frame.pose.position, atol=1e-12)
            np.testing.assert_allclose(pose.rotation, frame.pose.rotation, atol=1e-12)
    assert (exports / "poses/lens.keys").read_text().split() == [frame.key for frame in frames]
    chain = calibration.load(exports / "kalibr/camchain.yaml")
    ray = frames[0].camera.unproject([10.0, 20.0]).directions
    np.testing.assert_allclose(chain["cam0"].project(ray)[0], [10, 20], atol=1e-9)


def test_coordinates_of_the_real_world_keep_their_digits(tmp_path):
    """In UTM float32 has steps of 0.5 m: points are traced after what each form says of its origin, whose
    numbers alone are read as float32."""
    utm = np.array([5e5, 5e6, 0.0])
    frames = [traced_frame(tmp_path, SCENE, CAMERA, pose, key=f"cam-{i}") for i, pose in enumerate(POSES)]
    moved = [replace(frame, pose=Pose(frame.pose.position + utm, frame.pose.rotation)) for frame in frames]
    for name in ("ply", "colmap", "pcd", "nerfstudio"):
        get(name).export(moved, tmp_path / name, {"points": 0.1} if name == "colmap" else {})

    model = pycolmap.Reconstruction(tmp_path / "colmap/sparse/0")
    origin = np.loadtxt(tmp_path / "colmap/sparse/0/origin.txt")
    transforms = json.loads((tmp_path / "nerfstudio/transforms.json").read_text())
    applied = np.array(transforms["applied_transform"])
    for i, pose in enumerate(POSES):
        of_ply = columns(PlyData.read(tmp_path / f"ply/cam-{i}.ply")["vertex"].data, "xyz")
        assert of_ply.dtype == np.float64
        image = next(image for image in model.images.values() if image.name == f"cam/cam-{i}.png")
        of_model = [model.points3D[p.point3D_id].xyz for p in image.points2D if p.has_point3D()]
        text, _, data = (tmp_path / f"pcd/cam-{i}.pcd").read_bytes().partition(b"DATA binary\n")
        keys = dict(line.split(" ", 1) for line in text.decode().splitlines())
        w_from = [float(np.float32(number)) for number in keys["VIEWPOINT"].split()]
        sensor = Pose.from_quaternion(w_from[:3], [*w_from[4:], w_from[3]])
        step = sum(int(size) for size in keys["SIZE"].split())
        rows = np.frombuffer(data, np.uint8).reshape(-1, step)[:, :12].copy().view("<f4")
        of_pcd = sensor.to_world(rows[np.isfinite(rows[:, 0])].astype(float))
        assert keys["#"].split()[0] == "origin"
        away_of_pcd = np.array(keys["#"].split()[1:], float)
        for points, away in ((of_ply, 0), (np.float32(of_model), origin), (of_pcd, away_of_pcd)):
            rays = points + away - utm - pose.position
            reach = np.linalg.norm(rays, axis=1)
            off = np.abs(SCENE.trace(pose.position, rays / reach[:, None]).distance - reach)
            assert np.quantile(off, 0.99) < 1e-4  # others are on the edges of objects
            assert len(off) > 300
        matrix = np.float32(transforms["frames"][i]["transform_matrix"])
        np.testing.assert_allclose(matrix[:3, 3] - applied[:, 3] - utm, pose.position, atol=1e-4)


def test_the_cloud_has_classes_and_their_names(exports):
    read = PlyData.read(exports / "ply/cloud.ply")
    vertex = read["vertex"].data
    label_of = {each.split()[2]: int(each.split()[1]) for each in read.comments if each.startswith("label")}
    floor = vertex[vertex["label"] == label_of["Layout_Floor"]]
    assert len(floor) > 50
    np.testing.assert_allclose(floor["z"], 0, atol=0.002)
    np.testing.assert_allclose(floor["nz"], 1, atol=1e-3)
    (floor_class,) = np.unique(floor["class"])
    assert f"class {floor_class} floor" in read.comments
