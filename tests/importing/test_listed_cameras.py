"""Folders whose cameras are listed in the forms of other programs, traced, imported and judged."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.pictured import AT, SCENE, THERE, put, run, seen
from support.published import matrix, views

import omniscv
from omniscv.chart import traced
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.sources import View
from omniscv.sources.base import Request
from omniscv.sources.pictures import DepthForm, read_picture

SIZE = (80, 60)
POSES = [Pose.from_angles(AT, 20, 10, 5), Pose.from_angles(AT, 40, -5, 0), Pose.from_angles(THERE, 30)]
SQUARE = views(POSES, f=(1.2, 1.2), c=(0.5, 0.5), size=SIZE)
SMALL = omniscv.cameras.create("pinhole", 48, 36, fov_deg=50)
OPENGL = np.diag([1.0, -1, -1])


def focal(view):
    return view.projection[0]


def gaussian_splatting(folder):
    """As its camera_to_JSON: the centre, and the rotation from camera to world."""
    entries = []
    for i, view in enumerate(SQUARE):
        put(folder / f"images/view{i}.png", seen(view)[0])
        entry = {"id": i, "img_name": f"view{i}", "width": SIZE[0], "height": SIZE[1]}
        entry |= {"position": view.pose.position.tolist(), "rotation": view.pose.R_w_c.tolist()}
        entries.append(entry | {"fx": focal(view), "fy": focal(view)})
    (folder / "cameras.json").write_text(json.dumps(entries))


def llff(folder):
    """Columns down, right, back; then the position; then height, width, focal length; then bounds."""
    rows = []
    for i, view in enumerate(SQUARE):
        put(folder / f"images/{i}.png", seen(view)[0])
        right, down, ahead = view.pose.R_w_c.T
        hwf = [SIZE[1], SIZE[0], focal(view)]
        block = np.column_stack([down, right, -ahead, view.pose.position, hwf])
        rows.append([*block.ravel(), 0.5, 9.0])
    np.save(folder / "poses_bounds.npy", np.array(rows))


def arkitscenes(folder):
    """A pose is a time, an axis times its angle, and a translation, from the world to the camera."""
    lines = []
    for i, view in enumerate(SQUARE):
        name = f"41069021_{305 + i}.377"
        put(folder / f"lowres_wide/{name}.png", seen(view)[0])
        put(folder / f"lowres_depth/{name}.png", np.uint16(np.round(1000 * seen(view)[1])))
        fx, fy, cx, cy = view.projection
        lens = folder / f"lowres_wide_intrinsics/{name}.pincam"
        lens.parent.mkdir(exist_ok=True)
        lens.write_text(f"{SIZE[0]} {SIZE[1]} {fx} {fy} {cx} {cy}")
        R_c_w = view.pose.R_w_c.T
        numbers = [*Rotation.from_matrix(R_c_w).as_rotvec(), *(-R_c_w @ view.pose.position)]
        lines.append(" ".join(map(str, [305.3773 + i, *numbers])))
    put(folder / "lowres_wide/41069021_900.001.png", seen(SQUARE[0])[0])
    (folder / "lowres_wide.traj").write_text("\n".join(lines))


def isaac(folder, unit_m=0.01):
    """Row vectors; distances to the camera in metres; lists of objects by colour, another in each frame."""
    names = sorted(SCENE.objects)
    for i, view in enumerate(SQUARE):
        lit, planar, labels = seen(view)
        put(folder / f"rgb_{i:04}.png", lit)
        np.save(folder / f"distance_to_camera_{i:04}.npy", np.float32(planar * view.ray_lengths()))
        colors = np.random.default_rng(i).permutation(250)[: len(names) + 1, None] * [0, 1, 0] + [1, 0, 2]
        colors[0] = 0
        put(folder / f"semantic_segmentation_{i:04}.png", np.uint8(colors[labels]))
        listed = {"(0, 0, 0, 0)": {"class": "BACKGROUND"}}
        for name, color in zip(names, colors[1:].tolist(), strict=True):
            listed[str((*color, 255))] = {"class": name}
        (folder / f"semantic_segmentation_labels_{i:04}.json").write_text(json.dumps(listed))
        to_world = matrix(view.pose.R_w_c @ OPENGL, view.pose.position / unit_m)
        fx, fy, _, _ = view.projection
        near, far = 0.1, 100.0
        projection = np.zeros((4, 4))
        projection[0, 0] = 2 * fx / SIZE[0]
        projection[1, 1] = 2 * fy / SIZE[1]
        projection[2, 2] = -(far + near) / (far - near)
        projection[2, 3] = -1
        projection[3, 2] = -2 * far * near / (far - near)
        camera = {
            "cameraModel": "pinhole",
            "cameraViewTransform": np.linalg.inv(to_world).T.ravel().tolist(),
            "cameraProjection": projection.ravel().tolist(),
            "metersPerSceneUnit": unit_m,
            "renderProductResolution": [*SIZE],
        }
        (folder / f"camera_params_{i:04}.json").write_text(json.dumps(camera))


HYPERSIM = views(POSES, f=(np.sqrt(3), np.sqrt(3)), size=SIZE)


def hypersim(folder, unit_m=0.0254):
    """Distances along the ray in half floats, ids of -1 for none, a keyframe without pictures."""
    h5py = pytest.importorskip("h5py")

    def save(path, array):
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        with h5py.File(folder / path, "w") as file:
            file.create_dataset("dataset", data=array)

    for i, view in enumerate(HYPERSIM):
        lit, planar, labels = seen(view)
        save(f"images/scene_cam_00_final_hdf5/frame.{2 * i:04}.color.hdf5", np.float16(lit / 255))
        geometry = f"images/scene_cam_00_geometry_hdf5/frame.{2 * i:04}"
        save(f"{geometry}.depth_meters.hdf5", np.float16(planar * view.ray_lengths()))
        save(f"{geometry}.semantic_instance.hdf5", np.where(labels == 1, -1, labels).astype(np.int16))
    detail = "_detail/cam_00/camera_keyframe"
    known = [view.pose for view in HYPERSIM]
    save(f"{detail}_frame_indices.hdf5", np.array([0, 2, 4, 6]))
    save(f"{detail}_positions.hdf5", np.array([*(pose.position / unit_m for pose in known), [0, 0, 0]]))
    save(f"{detail}_orientations.hdf5", np.array([*(pose.R_w_c @ OPENGL for pose in known), np.eye(3)]))
    table = f"parameter_name,parameter_value\nmeters_per_asset_unit,{unit_m}\n"
    (folder / "_detail/metadata_scene.csv").write_text(table)


WRITERS = {
    "gaussian-splatting": (gaussian_splatting, {"lit"}, "where up is, are not known"),
    "llff": (llff, {"lit"}, "where up is, are not known"),
    "arkitscenes": (arkitscenes, {"lit", "depth"}, "1 pictures left out: no pose within 0.01 s"),
    "isaac": (isaac, {"lit", "depth", "object_mask"}, "3 of object_mask"),
}


@pytest.mark.parametrize("layout", WRITERS)
def test_pictures_come_in_as_they_were_traced(layout, tmp_path, capsys):
    write, modes, says = WRITERS[layout]
    (tmp_path / "f").mkdir()
    write(tmp_path / "f")
    assert run(tmp_path / "f", tmp_path / "a.sqlite") == 0
    out = capsys.readouterr().out
    assert f"layout {layout}: 2 places, 3 of lit" in out
    assert says in out
    with omniscv.open_source(tmp_path / "a.sqlite") as source:
        assert source.capabilities.modes == modes
        for view in SQUARE:
            (own,) = (
                v for v in source.recorded_views() if np.allclose(v.pose.R_w_c, view.pose.R_w_c, atol=1e-6)
            )
            np.testing.assert_allclose(own.pose.position, view.pose.position, atol=1e-5)
            np.testing.assert_allclose(own.projection, view.projection, atol=1e-4)
            (lit,) = source.capture([Request(own, "lit")])
            np.testing.assert_array_equal(lit.pixels, seen(view)[0])
            if "depth" in modes:
                check_depth(source, view.pose)
            if "object_mask" in modes:
                ids = source.objects().ids
                (mask,) = source.capture([Request(own, "object_mask")])
                expected = np.array([0, *(ids[name] for name in sorted(SCENE.objects))])[seen(view)[2]]
                np.testing.assert_array_equal(mask.pixels, expected)


def check_depth(source, pose):
    """An image of its middle is within its bounds."""
    image = omniscv.render(SMALL, pose, source, ("depth",), unseen="blank")
    off = np.abs(image.depth - traced(SCENE, SMALL, pose).distance)[image.valid]
    assert (off <= image.depth_error[image.valid]).mean() > 0.995


PINCAM = "lowres_wide_intrinsics/41069021_305.377.pincam"
LABELS = "semantic_segmentation_labels_0001.json"
SPOILED = [
    ("gaussian-splatting", "images/view1.png", None, "in images/ or beside it, got none"),
    ("gaussian-splatting", "cameras.json", "[]", "expected cameras, got an empty list"),
    ("gaussian-splatting", "cameras.json", '[{"position": [1, 2, 3]}]', "img_name: expected a text"),
    ("llff", "images/1.png", None, "expected a row for each picture"),
    ("llff", "poses_bounds.npy", "", "expected NPY"),
    ("arkitscenes", "lowres_wide.traj", "1 2 3", "poses: expected"),
    ("arkitscenes", PINCAM, None, "or --intrinsics FILE; got none"),
    ("isaac", LABELS, None, "the list of its objects"),
    ("isaac", "camera_params_0001.json", "{}", "cameraViewTransform: expected"),
]


@pytest.mark.parametrize(("layout", "path", "content", "says"), SPOILED, ids=[says for *_, says in SPOILED])
def test_what_is_missing_is_one_line(layout, path, content, says, tmp_path, capsys):
    (tmp_path / "f").mkdir()
    WRITERS[layout][0](tmp_path / "f")
    (tmp_path / "f" / path).unlink()
    if content is not None:
        (tmp_path / "f" / path).write_text(content)
    assert run(tmp_path / "f", tmp_path / "a.sqlite") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert says in line
    assert not (tmp_path / "a.sqlite").exists()


def test_depth_of_sun_rgbd(tmp_path):
    """The bits of millimetres are turned by three."""
    mm = np.array([[0, 1, 2003, 7999]], np.uint16)
    stored = np.uint16((mm.astype(np.uint32) << 3 | mm >> 13) & 0xFFFF)
    put(tmp_path / "d.png", stored)
    depth = read_picture(tmp_path / "d.png", "depth", DepthForm.parse("sunrgbd")).pixels
    np.testing.assert_allclose(depth, [[np.inf, 0.001, 2.003, 7.999]], rtol=1e-6)


TILTED = views([Pose.from_angles((0, 0, 0), 0, -12, 4)], f=(1.1, 1.15), c=(0.48, 0.53), size=SIZE)[0]


def sun_rgbd(folder, depths=("depth", "depth_bfx")):
    """A camera 1.3 m above the floor, whose world has its origin there; ``depth_bfx`` fills what was missing.

    As the toolbox of the data set: its axes x right, y ahead, z up are A @ extrinsics @ the camera's.
    """
    moved = View(Pose(AT, TILTED.pose.R_w_c), TILTED.fov_deg, *SIZE, TILTED.lens)
    lit, planar, _ = seen(moved)
    put(folder / "image/0000103.png", lit)
    mm = np.uint32(np.round(1000 * planar))
    for name in depths:
        missing = np.arange(SIZE[0]) % 7 == 0 if name == "depth" else np.zeros(SIZE[0], bool)
        stored = np.where(missing, 0, mm)
        put(folder / f"{name}/0000103.png", np.uint16((stored << 3 | stored >> 13) & 0xFFFF))
    fx, fy, cx, cy = TILTED.projection
    (folder / "intrinsics.txt").write_text(f"{fx} 0 {cx - 0.5} 0 {fy} {cy - 0.5} 0 0 1 ")
    A = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])  # axes of the toolbox from those of pictures
    right_ahead_up = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    E = A.T @ right_ahead_up @ TILTED.pose.R_w_c
    (folder / "extrinsics").mkdir(exist_ok=True)
    (folder / "extrinsics/20140101000000.txt").write_text("nothing: an earlier try")
    rows = [" ".join(map(str, [*row, 0])) for row in E]
    (folder / "extrinsics/20150118235401.txt").write_text("\n".join(rows))
    return planar


@pytest.mark.parametrize("depths", [("depth", "depth_bfx"), ("depth_bfx",), ()])
def test_a_scene_of_sun_rgbd(depths, tmp_path, capsys):
    (tmp_path / "f").mkdir()
    planar = sun_rgbd(tmp_path / "f", depths)
    assert run(tmp_path / "f", tmp_path / "a.sqlite") == 0
    out = capsys.readouterr().out
    assert "layout sunrgbd: 1 place, 1 of lit" in out
    assert ("depth_bfx is a guess" in out) == (depths == ("depth_bfx",))
    with omniscv.open_source(tmp_path / "a.sqlite") as source:
        (own,) = source.recorded_views()
        np.testing.assert_allclose(own.pose.R_w_c, TILTED.pose.R_w_c, atol=1e-6)
        np.testing.assert_allclose(own.pose.position, (0, 0, 0), atol=1e-9)
        np.testing.assert_allclose(own.projection, TILTED.projection, atol=1e-6)
        if depths:
            (depth,) = source.capture([Request(own, "depth")])
            known = np.isfinite(depth.pixels)
            assert known.all() == ("depth" not in depths)
            assert np.abs(depth.pixels - planar)[known].max() <= 0.0005 + 1e-6


def test_scenes_of_sun_rgbd_are_worlds_of_their_own(tmp_path, capsys):
    for name in ("NYU0001", "NYU0002"):
        (tmp_path / "kv1" / name).mkdir(parents=True)
        sun_rgbd(tmp_path / "kv1" / name)
    assert run(tmp_path / "kv1", tmp_path / "a.sqlite", "--layout", "sunrgbd") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "got 2 of them; import one, such as 'NYU0001'" in line
    (tmp_path / "kv1/NYU0001/extrinsics/20150118235401.txt").write_text("1 0 0 0\n" * 6)
    assert run(tmp_path / "kv1/NYU0001", tmp_path / "a.sqlite") == 2
    assert "extrinsics/20150118235401.txt" in capsys.readouterr().err


def test_hypersim(tmp_path, capsys):
    (tmp_path / "f").mkdir()
    hypersim(tmp_path / "f")
    assert run(tmp_path / "f", tmp_path / "a.sqlite") == 0
    out = capsys.readouterr().out
    assert "layout hypersim: 2 places, 3 of lit, 3 of depth, 3 of object_mask" in out
    assert "lens of 60 degrees; --intrinsics says another" in out
    with omniscv.open_source(tmp_path / "a.sqlite") as source:
        for view in HYPERSIM:
            recorded = source.recorded_views()
            (own,) = (v for v in recorded if np.allclose(v.pose.R_w_c, view.pose.R_w_c, atol=1e-6))
            np.testing.assert_allclose(own.projection, view.projection, rtol=1e-9)
            np.testing.assert_allclose(own.pose.position, view.pose.position, atol=1e-9)
            lit, mask = (next(iter(source.capture([Request(own, mode)]))) for mode in ("lit", "object_mask"))
            np.testing.assert_allclose(lit.pixels, seen(view)[0] / 255, atol=3e-4)
            labels = seen(view)[2]
            np.testing.assert_array_equal(mask.pixels, np.where(labels == 1, 0xFFFF, labels))
            check_depth(source, view.pose)


OUTSIDE = [("/etc/hostname", 0, 16)]


def test_hdf5_of_other_files_is_refused(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "other.hdf5", "w") as file:
        file.create_dataset("dataset", data=np.ones((4, 4), np.float32))
    for name, make in (
        ("link", lambda file: file.__setitem__("dataset", h5py.ExternalLink("other.hdf5", "dataset"))),
        (
            "external",
            lambda file: file.create_dataset("dataset", (4,), "f4", external=[("/etc/hostname", 0, 16)]),
        ),
        ("named", lambda file: file.create_dataset("colors", data=np.ones((4, 4)))),
        ("texts", lambda file: file.create_dataset("dataset", data=[b"a"])),
        ("large", lambda file: file.create_dataset("dataset", (1 << 20, 1 << 20), "u1", chunks=(1, 1 << 20))),
    ):
        with h5py.File(tmp_path / f"{name}.hdf5", "w") as file:
            make(file)
        with pytest.raises(ArgumentError):
            read_picture(tmp_path / f"{name}.hdf5", "depth")
    (tmp_path / "none.hdf5").write_bytes(b"no HDF5")
    with pytest.raises(ArgumentError, match="expected HDF5, got"):
        read_picture(tmp_path / "none.hdf5", "depth")
