"""COLMAP's text model with rigs, as pycolmap reads it."""

import cv2
import numpy as np
import pycolmap
import pytest
from support.traced_frames import black_frame, frame_of, traced_frame

import mock_server
from omniscv import Pose, cameras
from omniscv.dataset import get
from omniscv.dataset.sequences import rigs
from omniscv.errors import ArgumentError

SCENE = mock_server.load_scene("four-wall")
PANORAMA = cameras.create("equirectangular", width=64, height=32)
BENDS = (0.02, -0.008, 0.002, -0.0004)
CAMERAS = {
    "panorama": PANORAMA,
    "fisheye": cameras.create("fisheye-equidistant", width=40, height=40, fov_deg=170),
    "brandt": cameras.create("kannala-brandt", 48, 40, fx=15.0, fy=14.0, k=BENDS, fov_deg=150),
    "pinhole": cameras.create("pinhole", width=32, height=24, fov_deg=80, center=(15, 13)),
    "eucm": cameras.create("extended-unified", 40, 40, fx=12.0, fy=12.5, cy=19.0, alpha=0.6, beta=1.1),
}
MOUNTED = {name: Pose.from_angles((0, 0.1 * i, 0), 40 * i, 5 * i) for i, name in enumerate(CAMERAS)}
MOVES = [Pose.from_angles((0.3 * i - 0.5, 0.2 * i, 1.3 + 0.1 * i), 50 * i, 4 * i, -3 * i) for i in range(3)]


def level(pose):
    """A pose of a camera, as T_rig_cam of a rig that is level in it."""
    return Pose.from_angles((0, 0, 0)).inverse() @ pose


def rig_frames(folder, names=tuple(CAMERAS), write=black_frame):
    return [
        write(folder, CAMERAS[name], move @ level(MOUNTED[name]), name, f"{name}-{i}")
        for i, move in enumerate(MOVES) for name in names
    ]  # fmt: skip


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """The frames of a rig of five cameras at three moments, and what pycolmap reads of their export."""
    folder = tmp_path_factory.mktemp("colmap")
    frames = rig_frames(folder, write=lambda folder, *more: traced_frame(folder, SCENE, *more))
    get("colmap").export(frames, folder / "out", {"points": 0.15})
    return frames, folder / "out", pycolmap.Reconstruction(folder / "out/sparse/0")


def by_name(read):
    return {image.name.split("/")[1].removesuffix(".png"): image for image in read.images.values()}


def w2c(pose):
    return np.column_stack([pose.rotation.T, -pose.rotation.T @ pose.position])


def assert_poses(read, frames):
    images = by_name(read)
    for frame in frames:
        found = images[frame.key].cam_from_world().matrix()
        np.testing.assert_allclose(found, w2c(frame.pose), atol=1e-9)


def test_pycolmap_has_the_poses_of_all_sensors_and_frames(model):
    frames, _, read = model
    (rig,) = read.rigs.values()
    assert rig.num_sensors() == 5
    assert len(read.frames) == 3
    images = by_name(read)
    assert len(images) == 15
    assert_poses(read, frames)
    for frame in frames:
        image = images[frame.key]
        np.testing.assert_allclose(image.projection_center(), frame.pose.position, atol=1e-9)
        sensor = rig.sensor_from_rig(image.camera.sensor_id).matrix() if image.camera_id > 1 else np.eye(3, 4)
        key = frame.key.replace(frame.camera_name, "brandt")
        reference = next(each for each in frames if each.key == key)
        np.testing.assert_allclose(sensor, w2c(reference.pose.inverse() @ frame.pose), atol=1e-9)


def test_points_project_to_where_they_were_seen(model):
    """Pixel centres, in every image; and they lie where the scene has surfaces."""
    _, _, read = model
    assert len(read.points3D) > 1000
    seen = dict.fromkeys(read.images, 0)
    for point in read.points3D.values():
        (element,) = point.track.elements
        image = read.images[element.image_id]
        observed = image.points2D[element.point2D_idx].xy
        np.testing.assert_allclose(image.project_point(point.xyz), observed, atol=1e-3)  # float32 depth
        np.testing.assert_allclose(observed % 1, 0.5)
        seen[element.image_id] += 1
    assert min(seen.values()) > 0
    xyz = np.array([point.xyz for point in read.points3D.values()])
    hits = SCENE.trace(MOVES[0].position, xyz - MOVES[0].position)
    colors = np.array([point.color for point in read.points3D.values()])
    visible = np.abs(hits.distance - np.linalg.norm(xyz - MOVES[0].position, axis=1)) < 1e-3
    close = np.abs(colors[visible] - 255 * hits.color[visible]).max(axis=1) < 3
    assert close.mean() > 0.95  # the edge of a texture's square may be between two rays


def test_images_and_masks(model):
    frames, out, read = model
    for image in read.images.values():
        size = image.camera.height, image.camera.width
        assert cv2.imread(str(out / "images" / image.name)).shape[:2] == size
    for name in ("fisheye", "brandt"):
        mask = cv2.imread(str(out / f"masks/{name}.png"), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(mask > 0, CAMERAS[name].valid())
    assert not (out / "masks/panorama.png").exists()
    first = (out / "images/panorama/panorama-0.png").read_bytes()
    assert first == next(frame for frame in frames if frame.key == "panorama-0").files["lit"].read_bytes()


def test_cameras_that_move_apart_are_rigs_of_their_own(tmp_path):
    frames = rig_frames(tmp_path, ("panorama", "pinhole"))
    turns = [Pose.from_angles((i, 0, 1), 30 * i * i) for i in range(2)]
    turning = [black_frame(tmp_path, PANORAMA, at, "turning", f"turning-{i}") for i, at in enumerate(turns)]
    found = rigs([*frames, *turning])
    assert [list(each.rig.cameras) for each in found] == [["panorama", "pinhole"], ["turning"]]
    assert [len(each.moments) for each in found] == [3, 2]
    get("colmap").export([*frames, *turning], tmp_path, {})
    read = pycolmap.Reconstruction(tmp_path / "sparse/0")
    assert (len(read.rigs), len(read.frames), len(read.images)) == (2, 5, 8)
    assert_poses(read, turning)


def test_a_moment_may_lack_an_image(tmp_path):
    """Of the reference camera, even: the rig's pose follows from another one."""
    frames = [f for f in rig_frames(tmp_path, ("panorama", "pinhole")) if f.key != "panorama-1"]
    get("colmap").export(frames, tmp_path, {})
    assert_poses(pycolmap.Reconstruction(tmp_path / "sparse/0"), frames)


def test_frames_of_other_names_are_together_by_time_or_pose(tmp_path):
    def of(name, key, pose, time_ns=None):
        return black_frame(tmp_path, PANORAMA, pose, name, key, time_ns=time_ns)

    here, there = MOVES[:2]
    timed = [of("a", "k0", here, 1.0), of("b", "k1", there, 1.0), of("a", "k2", there, 2.0)]
    assert [len(each.moments) for each in rigs(timed)] == [2]
    still = [of("a", "k0", here), of("b", "k1", here), of("b", "k2", there)]
    assert [len(each.moments) for each in rigs(still)] == [2]
    with pytest.raises(ArgumentError, match="expected one frame of a camera in a moment, got k0 and k1"):
        rigs([of("a", "k0", here), of("a", "k1", here)])
    dark = frame_of(tmp_path, {"depth": np.ones((32, 64), np.float32)}, PANORAMA, here)
    with pytest.raises(ArgumentError, match="cam: expected a frame with lit"):
        get("colmap").export([dark], tmp_path, {})
