"""Meshes in use: moved and hidden, lit by a lamp, in jobs and many worlds, served, in other processes."""

import pickle
import signal

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.mesh_files import Builder, corners_w, y_up
from support.meshes import directions, room, truth_of, write_room
from support.processes import OMNISCV, started

import omniscv
from omniscv import make
from omniscv.diagnostics.doctor import examine_address
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.instant import Instant
from omniscv.job import load

CENTER_W = np.array([0.1, 0.2, 1.5])
ROUNDED_M = 1e-6  # of float32 in the file, along grazing rays
RAYS = directions(3000)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("mesh") / "room.glb"
    write_room(path)
    return path


@pytest.fixture
def source(path):
    with omniscv.open_source(f"mesh://{path}") as source:
        yield source


def assert_shows(source, meshes):
    """A source shows meshes, by name; labels are those of the whole room."""
    names = sorted(room())
    truth = truth_of(meshes)
    hits = source.trace(CENTER_W, RAYS)
    distance, label, _ = truth.trace(CENTER_W, RAYS)
    of_room = np.array([0] + [1 + names.index(name) for name in sorted(meshes)])
    np.testing.assert_array_equal(hits.label, of_room[label])
    np.testing.assert_allclose(hits.distance, distance, atol=ROUNDED_M)


def test_a_hidden_object_is_not_met_and_its_label_stays(source):
    meshes = room()
    del meshes["Table"]
    with source.without(["Table"]) as without:
        assert_shows(without, meshes)
    with source.at(Instant(hidden=frozenset(["Table"]))) as without:
        assert_shows(without, meshes)
    assert_shows(source, room())


def test_a_moved_object_is_where_its_pose_says_and_back_afterwards(source):
    meshes = room()
    turn = Rotation.from_euler("zyx", [40, 20, -10], degrees=True).as_matrix()
    target = np.array([-1.0, 0.8, 0.9])
    table = meshes["Table"]
    middle = table.bounds.mean(axis=0)
    table.vertices = (table.vertices - middle) @ turn.T + target
    pose = Pose(target, turn)
    with source.at(Instant(poses={"Table": pose})) as moved:
        assert_shows(moved, meshes)
        box = moved.geometry().boxes["Table"]
        np.testing.assert_allclose(box.center_w, target, atol=1e-12)
        np.testing.assert_allclose(box.size, (1.2, 0.7, 0.75), atol=ROUNDED_M)
        np.testing.assert_allclose(np.abs(box.R_w_b.T @ turn), np.eye(3), atol=1e-12)
        np.testing.assert_allclose(moved.poses()["Table"].position, target)
    assert_shows(source, room())
    np.testing.assert_allclose(source.poses(["Table"])["Table"].position, middle, atol=ROUNDED_M)


def test_with_all_hidden_there_is_sky(source):
    with source.without(source.objects().names()) as nothing:
        hits = nothing.trace(CENTER_W, RAYS)
        assert np.isinf(hits.distance).all()
        assert not hits.label.any()
        assert not nothing.shade(CENTER_W, RAYS).any()


def test_in_another_process_it_is_the_same(source):
    with source.without(["Ball"]) as without, pickle.loads(pickle.dumps(source)) as again:  # noqa: S301
        np.testing.assert_array_equal(
            again.trace(CENTER_W, RAYS).distance, source.trace(CENTER_W, RAYS).distance
        )
        assert again.scene_identity == source.scene_identity == without.scene_identity


def plate_and_screen(path):
    """A floor of 4 m, one-coloured, and a square screen of .5 m half way up to a lamp at 2 m."""
    built = Builder()
    for name, size, height in (("Floor", 2.0, 0.0), ("Screen", 0.25, 1.0)):
        square = np.column_stack([corners_w(0)[:, 1:] - [0, 0.5], np.zeros(4)]) * [2 * size, 2 * size, 1]
        place = y_up(np.add(square, [0, 0, height])).astype("f4")
        surface = {"baseColorFactor": [0.5, 0.25, 1.0, 1.0]}
        material = built.add(
            "materials", {"name": name, "pbrMetallicRoughness": surface, "doubleSided": True}
        )
        indices = built.accessor(np.array([0, 1, 2, 0, 2, 3], "u2"))
        attributes = {"POSITION": built.accessor(place)}
        built.node(name, {"attributes": attributes, "indices": indices, "material": material})
    built.write(path)


def test_a_lamp_gives_its_cosine_shadows_and_ambient_light(tmp_path):
    """Of light: decoded by the formula of sRGB, which is written out here."""
    path = tmp_path / "plate.glb"
    plate_and_screen(path)
    places = np.array([[0.2, 0.3, 0], [0.45, 0.4, 0], [0.6, 0.0, 0], [1.5, 1.2, 0.0]])
    in_shadow = np.array([True, True, False, False])  # the screen's shadow is 1 m wide
    origin = np.array([3.0, 0.1, 0.7])
    toward = places - origin
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    with omniscv.open_source(f"mesh://{path}?lamp=0,0,2") as source:
        codes = source.shade(origin, toward).astype(float)
    light = np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)
    lamp = np.array([0, 0, 2.0]) - places
    cosine = lamp[:, 2] / np.linalg.norm(lamp, axis=1)
    expected = np.outer(0.25 + 0.75 * np.where(in_shadow, 0, cosine), [0.5, 0.25, 1.0])
    np.testing.assert_allclose(light, expected, atol=2e-4)  # of float32 and the table of codes


def leaf(path, mode, cutoff=None):
    """A square whose left half has alpha 0.3 and whose right half 0.8, in front of another."""
    built = Builder()
    built.square("Right", 2)
    colors = np.ones((4, 4), "f4")
    colors[:, 3] = [0.3, 0.3, 0.3, 0.3]
    place = y_up(corners_w(1)).astype("f4")
    material = {"name": "leaf", "alphaMode": mode, "doubleSided": True}
    if cutoff is not None:
        material["alphaCutoff"] = cutoff
    number = built.add("materials", material)
    attributes = {"POSITION": built.accessor(place), "COLOR_0": built.accessor(colors)}
    indices = built.accessor(np.array([0, 1, 2, 0, 2, 3], "u2"))
    built.node("Leaf", {"attributes": attributes, "indices": indices, "material": number})
    built.write(path)


@pytest.mark.parametrize(
    ("mode", "cutoff", "query", "distance_m"),
    [
        ("OPAQUE", None, "", 1),
        ("MASK", None, "", 2),
        ("MASK", 0.2, "", 1),
        ("BLEND", None, "", 1),
        ("BLEND", None, "?alpha=cut", 2),
    ],
)
def test_alpha_makes_holes_as_the_file_or_the_address_says(mode, cutoff, query, distance_m, tmp_path):
    path = tmp_path / "leaf.glb"
    leaf(path, mode, cutoff)
    with omniscv.open_source(f"mesh://{path}{query}") as source:
        hits = source.trace(np.array([0.0, 0.1, 0.45]), np.array([[1.0, 0, 0]]))
    assert hits.distance[0] == pytest.approx(distance_m)


VARIED = {
    "seed": 3,
    "objects": {
        "Table": {"shift": {"box": [[-0.3, -0.3, 0], [0.3, 0.3, 0.2]]}, "turn_deg": [0, 90]},
        "Crate": {"shown": 0.5},
    },
}


def as_drawn(frame):
    """Return the truth of a frame's world: the room with what was drawn done to it by trimesh."""
    meshes = room()
    drawn = frame.varied["objects"]
    if not drawn["Crate"]["shown"]:
        del meshes["Crate"]
    table = meshes["Table"]
    middle = table.bounds.mean(axis=0)
    turn = Rotation.from_euler("z", drawn["Table"]["turn_deg"], degrees=True).as_matrix()
    table.vertices = (table.vertices - middle) @ turn.T + middle + drawn["Table"]["shift"]
    return sorted(meshes), truth_of(meshes)


@pytest.mark.rays
def test_a_job_varies_the_objects_of_a_folder_of_meshes_and_its_recordings_replay_it(tmp_path):
    (tmp_path / "scans").mkdir()
    for number in range(2):
        write_room(tmp_path / "scans" / f"{number}.glb", seed=number)
    description = {
        "worlds": {"scan-*": {"source": f"mesh://{tmp_path}/scans/*.glb", "record": f"{tmp_path}/*.sqlite"}},
        "cameras": {"wide": {"model": "fisheye-equidistant", "width": 48, "height": 48, "fov_deg": 185}},
        "poses": [{"position": [0.1, 0.2, 1.5]}, {"position": [0.2, 0.2, 1.5]}],
        "modes": ["lit", "object_mask", "depth"],
        "truth": {"boxes3d": True},
        "vary": VARIED,
        "out": str(tmp_path / "live"),
    }
    live = {**description, "worlds": {"scan-*": {"source": f"mesh://{tmp_path}/scans/*.glb"}}}
    make.make(load(live))
    make.make(load({**description, "out": str(tmp_path / "recorded")}))
    replayed = {"scan-*": {"source": f"{tmp_path}/*.sqlite"}}
    make.make(load({**description, "worlds": replayed, "out": str(tmp_path / "replayed")}))
    frames = {name: omniscv.dataset.open(tmp_path / name) for name in ("live", "recorded", "replayed")}
    frames = {name: {frame.key: frame for frame in dataset} for name, dataset in frames.items()}
    assert len(frames["live"]) == 4
    names = sorted(room())
    for key, frame in frames["live"].items():
        shown, truth = as_drawn(frame)
        rays = frame.camera.unproject(frame.camera.pixels())
        toward = (rays.directions @ frame.pose.rotation.T)[rays.valid]
        distance, label, _ = truth.trace(frame.pose.position, toward)
        of_room = np.array([0] + [1 + names.index(name) for name in shown])
        np.testing.assert_array_equal(frame.layer("labels")[rays.valid], of_room[label])
        np.testing.assert_allclose(frame.layer("depth")[rays.valid], distance, atol=ROUNDED_M)
        for layer in ("lit", "labels", "depth"):
            recorded = frames["recorded"][key].layer(layer)
            np.testing.assert_array_equal(frames["replayed"][key].layer(layer), recorded)


@pytest.mark.rays
def test_a_job_moves_an_object_along_a_path(path, tmp_path):
    """At each of its instants a frame shows the room with the table where its motion has it."""
    start = np.array([1.2, 0.9, 0.375])
    end = np.array([0.6, -1.2, 0.375])
    waypoints = [
        {"time": 0, "position": start.tolist()},
        {"time": 1, "position": end.tolist(), "yaw_deg": 60},
    ]
    description = {
        "source": f"mesh://{path}",
        "cameras": {"pano": {"model": "equirectangular", "width": 64, "height": 32}},
        "poses": [{"position": [0.1, 0.2, 1.5]}] * 3,
        "times": {"rate": 2, "count": 3},
        "motions": {"Table": waypoints},
        "modes": ["object_mask", "depth"],
        "out": str(tmp_path / "moving"),
    }
    make.make(load(description))
    names = sorted(room())
    frames = sorted(omniscv.dataset.open(tmp_path / "moving"), key=lambda frame: frame.key)
    for share, frame in zip((0, 0.5, 1), frames, strict=True):
        meshes = room()
        turn = Rotation.from_euler("z", 60 * share, degrees=True).as_matrix()
        moved = meshes["Table"].vertices - meshes["Table"].bounds.mean(axis=0)
        meshes["Table"].vertices = moved @ turn.T + start + share * (end - start)
        toward = frame.camera.unproject(frame.camera.pixels()).directions @ frame.pose.rotation.T
        distance, label, _ = truth_of(meshes).trace(frame.pose.position, toward.reshape(-1, 3))
        np.testing.assert_array_equal(frame.layer("labels").ravel(), label)
        np.testing.assert_allclose(frame.layer("depth").ravel(), distance, atol=ROUNDED_M)
        assert (label == 1 + names.index("Table")).any()


def test_a_pattern_that_nothing_matches_is_one_line(tmp_path):
    worlds = {"scan-*": {"source": f"mesh://{tmp_path}/scans/*.glb"}}
    with pytest.raises(ArgumentError, match=r"worlds.scan-\*: source: expected files of .*, got none"):
        load({"worlds": worlds, "cameras": {}, "poses": [], "out": str(tmp_path)})
    with pytest.raises(
        ArgumentError, match=r"source: expected one \*, which stands for files, got 'mesh://a.glb'"
    ):
        load({"worlds": {"scan-*": {"source": "mesh://a.glb"}}, "poses": [], "out": str(tmp_path)})


def test_unrealcv_clients_capture_a_served_mesh(path):
    """Objects and their masks over the wire agree with the mesh in this process."""
    camera = omniscv.cameras.create("equirectangular", width=96, height=48)
    pose = omniscv.Pose.from_angles((0.1, 0.2, 1.5))
    with started(*OMNISCV, "serve", str(path), "--port", "0", "--size", "64x64") as process:
        address = process.stdout.readline().split()[0]
        labels = []
        for uri in (address, f"mesh://{path}?traces=0"):
            with omniscv.open_source(uri) as source:
                assert source.objects().names() == sorted(room())
                labels.append(omniscv.render(camera, pose, source, ("lit", "object_mask")).labels)
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=60)
        assert process.returncode == 0
    assert (labels[0] == labels[1]).mean() > 0.995  # at edges of faces of other sizes


def test_what_is_not_there_is_one_line(source):
    with pytest.raises(ArgumentError, match="expected objects of the scene, got 'Tabel'; did you mean Table"):
        source.without(["Tabel"])
    assert "Table" in source.variable("objects")


def test_the_doctor_says_what_a_mesh_is(path, tmp_path):
    findings = {finding.name: finding for finding in examine_address(f"mesh://{path}", CENTER_W)}
    assert findings["mesh"].value == f"{len(truth_of(room()).corners)} triangles, 9 objects"
    assert all(finding.verdict == "ok" for finding in findings.values())
    plate_and_screen(tmp_path / "plate.glb")
    findings = {finding.name: finding for finding in examine_address(f"mesh://{tmp_path}/plate.glb")}
    assert findings["open edges"].value == "8"
    assert findings["open edges"].verdict == "warning"
