"""What sources know of shapes, and what they show without some objects: against the scene itself."""

import math
import shutil
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import yaml
from support.faces import face_requests
from support.unreal import answering, opened

import mock_server
import omniscv
from omniscv.errors import ArgumentError, SourceError
from omniscv.geometry.scene_geometry import SceneGeometry
from omniscv.importing.folders import export, import_folder
from omniscv.sources import Request
from omniscv.sources.recording.inspection import verify
from omniscv.sources.registry import open_sources
from omniscv.sources.unreal import open_connection
from omniscv.sources.unreal.objects import boxes

SCENE = mock_server.load_scene("four-wall")
SMALL = "mock://four-wall?dialect=0.3.10&size=16x16"
MASKS = face_requests(16, ["object_mask"])
CM = 0.01


@pytest.mark.parametrize("room", ["four-wall", "six-wall"])
def test_boxes_of_a_scene_touch_its_objects_all_round(room):
    scene = mock_server.load_scene(room)
    with omniscv.open_source(f"scene://{room}") as source:
        geometry = source.geometry()
    assert set(geometry.boxes) == set(scene.objects)
    for name, box in geometry.boxes.items():
        assert box.source == "scene"
        low, high = scene.bounds(name)
        corners = box.corners_w()
        if np.allclose(box.R_w_b, np.eye(3)):
            assert corners.min(axis=0) == pytest.approx(low, abs=1e-9)
            assert corners.max(axis=0) == pytest.approx(high, abs=1e-9)
        assert (corners.min(axis=0) <= low + 1e-9).all()
        assert (corners.max(axis=0) >= high - 1e-9).all()
        points = (scene.vertices(name) - box.center_w) @ box.R_w_b
        assert np.abs(points).max(axis=0) == pytest.approx(box.size / 2, abs=1e-3)  # 64 points on a circle


@pytest.mark.parametrize("room", ["four-wall", "six-wall"])
def test_the_room_is_where_its_walls_are_met(room):
    """Seen from a point on the floor's outline each wall has its name, and so have floor and ceiling."""
    scene = mock_server.load_scene(room)
    with omniscv.open_source(f"scene://{room}") as source:
        found = source.geometry().room
    corners = np.column_stack([found.corners_w, np.full(len(found.corners_w), found.floor_z)])
    middles = (corners + np.roll(corners, -1, axis=0)) / 2
    x, y = (np.roll(corners, -1, axis=0) - corners)[:, :2].T
    inward = np.stack([-y, x, 0 * x], axis=1) / np.hypot(x, y)[:, None]  # counterclockwise
    up = (found.ceiling_z - found.floor_z) * np.array([0, 0, 1])
    others = set(scene.objects) - set(found.surfaces)

    def met(origins, directions):
        hits = scene.trace(origins, directions, hidden=others)
        return [scene.objects[label - 1] for label in hits.label], hits.distance

    names, distances = met(middles + 0.1 * inward + up / 3, -inward)
    assert names == list(found.walls)
    assert distances == pytest.approx(0.1)
    for direction, name in ((-up, found.floor), (up, found.ceiling)):
        names, distances = met(middles + 0.1 * inward + up / 2, np.tile(direction, (len(middles), 1)))
        assert set(names) == {name}
        assert distances == pytest.approx(np.linalg.norm(up) / 2)


@pytest.mark.parametrize("dialect", ["N1", "M"])
def test_boxes_come_over_the_wire_from_vertices(dialect):
    with omniscv.open_source(f"mock://four-wall?dialect={dialect}") as source:
        geometry = source.geometry()
    assert geometry.room.walls == SCENE.room.walls
    assert set(geometry.boxes) == set(SCENE.objects)
    for name, box in geometry.boxes.items():
        assert box.source == "vertices"
        low, high = SCENE.bounds(name)
        inside = (SCENE.vertices(name) - box.center_w) @ box.R_w_b
        assert np.abs(inside).max(axis=0) == pytest.approx(box.size / 2, abs=1e-6)  # tight, and around all
        if np.array_equal(box.R_w_b, np.eye(3)):
            assert box.center_w - box.size / 2 == pytest.approx(low, abs=CM)
            assert box.center_w + box.size / 2 == pytest.approx(high, abs=CM)
    exact = SCENE.box("Chair_1")[2]
    found = geometry.boxes["Chair_1"].size
    assert np.sort(found) == pytest.approx(np.sort(exact), abs=1e-4)  # it is turned by 12 degrees


def test_bounds_serve_where_there_are_no_vertices():
    refuses = answering("error Can not find a handler for URI", "vertex_location")
    with mock_server.serve("four-wall") as server, opened(server, refuses) as source:
        geometry = source.geometry()
    assert geometry.room is None
    for name in SCENE.objects:
        box = geometry.boxes[name]
        assert box.source == "bounds"
        assert np.array_equal(box.R_w_b, np.eye(3))
        ends = box.center_w - box.size / 2, box.center_w + box.size / 2
        assert np.array(ends) == pytest.approx(np.array(SCENE.bounds(name)), abs=CM)


def test_plugin_0_3_10_knows_no_boxes():
    with omniscv.open_source(SMALL) as source:
        assert source.geometry().boxes == {}
        assert source.geometry().room.floor == "Layout_Floor"


def test_vertices_that_are_none_are_a_fault():
    reply = [""]

    def spoils(command, forward):
        return reply[0] if "vertex_location" in command else forward(command)

    impatient = {"retries": 1, "patience_s": 0.1}
    with mock_server.serve("four-wall") as server, opened(server, spoils, **impatient) as source:
        for reply[0] in ("1 2", "1 2 nan", "a b c", "1e12 0 0", b"\xff\xfe"):
            with pytest.raises(SourceError, match=r"expected (three numbers|text)"):
                source.geometry()


def test_a_server_whose_boxes_are_a_fault_can_be_recorded(tmp_path, caplog):
    path = tmp_path / "room.sqlite"
    spoils = answering("1 2", "vertex_location", "/bounds")
    with mock_server.serve("four-wall") as server, opened(server, spoils, retries=1, patience_s=0.5) as live:
        recording = omniscv.record(live, path)
        with recording:
            assert len(list(recording.capture(MASKS[:2]))) == 2
    assert "no boxes of objects are recorded: " in caplog.text
    with omniscv.open_source(path) as replay:
        assert not replay.geometry()
        assert len(list(replay.capture(MASKS[:2]))) == 2


def test_vertices_are_fetched_up_to_a_bound():
    """Bounds serve for the rest; eight objects are asked for together."""
    with mock_server.serve("four-wall") as server, open_connection(server.uri) as connection:
        found = boxes(connection, SCENE.objects, most_vertices=500)
    assert [found[name].source for name in SCENE.objects] == ["vertices"] * 8 + ["bounds"] * 12


SOURCES = {"scene": ["scene://four-wall"], "mock": ["mock://four-wall"], "0.3.10": [SMALL]}
SOURCES["pool"] = SOURCES["scene"] * 2


@pytest.mark.parametrize("uris", SOURCES.values(), ids=SOURCES)
def test_hidden_objects_are_gone_until_the_source_is_closed(uris):
    gone = ["Sofa", "Carpet"]
    with open_sources(uris) as source:
        before = [capture.pixels for capture in source.capture(MASKS)]
        colors = [source.objects().colors[name] for name in gone]
        assert any(shows(pixels, color) for pixels in before for color in colors)
        with suppress(ZeroDivisionError), source.without(gone) as rest:
            assert not any(shows(each.pixels, color) for each in rest.capture(MASKS) for color in colors)
            raise ZeroDivisionError
        after = [capture.pixels for capture in source.capture(MASKS)]
        assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))
        with pytest.raises(ArgumentError, match="objects of the scene, got 'Sofy'; did you mean Sofa"):
            source.without(["Carpet", "Sofy"])


def shows(pixels, color):
    return (np.abs(pixels.astype(int) - color) <= 3).all(axis=-1).any()


def test_a_game_that_refuses_to_hide_is_left_as_it_was():
    refuses = answering("error Can not hide", "Table/hide")
    with mock_server.serve("four-wall") as server, opened(server, refuses) as source:
        with pytest.raises(SourceError, match=r"Table/hide.* with ok, got 'error Can not hide'"):
            source.without(["Sofa", "Table", "Vase"])
        assert not any(thing.hidden for thing in server.world.objects.values())


def test_shapes_are_recorded_with_the_objects(tmp_path):
    path = tmp_path / "room.sqlite"
    with omniscv.record(omniscv.open_source("mock://four-wall"), path) as source:
        list(source.capture(Request(each.view, "lit") for each in MASKS[:1]))
        with omniscv.open_source(path) as replay:
            assert not replay.geometry()  # nothing is asked of the source that is not needed
        list(source.capture(MASKS[:1]))
        expected = source.geometry().to_dict()
    assert verify(path).ok
    with omniscv.open_source(path) as replay:
        assert replay.geometry().to_dict() == expected
        assert len(list(replay.capture(MASKS[:1]))) == 1
        with pytest.raises(ArgumentError, match="expected one that can hide objects, got RecordedSource"):
            replay.without(["Sofa"])
    assert export(path, tmp_path / "folder") == 2
    import_folder(tmp_path / "folder", tmp_path / "again.sqlite")
    with omniscv.open_source(tmp_path / "again.sqlite") as replay:
        assert replay.geometry().to_dict() == expected


def test_a_recording_without_shapes_gets_them_when_masks_are_recorded(tmp_path):
    path = tmp_path / "room.sqlite"
    shutil.copy(Path(__file__).parents[2] / "captures" / "four-wall.sqlite", path)
    with omniscv.open_source(path) as replay:
        assert not replay.geometry()
    with omniscv.record(omniscv.open_source("mock://four-wall"), path) as source:
        assert source.geometry().room.walls == SCENE.room.walls
    assert verify(path).ok
    with omniscv.open_source(path) as replay:
        assert len(replay.geometry().boxes) == len(SCENE.objects)


BOX = {"center": [0, 0, 1], "rotation": np.eye(3).tolist(), "size": [1, 1, 2], "source": "scene"}
CORNERS_M = [[0, 0], [1, 0], [1, 1]]
ROOM = {"corners": CORNERS_M, "floor_z": 0, "ceiling_z": 2, "walls": [*"abc"], "floor": "f", "ceiling": "g"}


def test_shapes_of_a_file_are_checked():
    for shapes, room, says in (
        ({"A": BOX | {"size": [1, -1, 1]}}, None, r"boxes\.A\.size: expected lengths of at least 0"),
        ({"A": BOX | {"rotation": [[1, 0, 0]] * 3}}, None, "right-handed orthonormal"),
        ([], None, "boxes: expected a mapping"),
        ({}, ROOM | {"walls": ["a"]}, "as many walls, got 3 corners and 1 walls"),
    ):
        with pytest.raises(ArgumentError, match=says):
            SceneGeometry.from_dict({"boxes": shapes, "room": room})


@pytest.mark.parametrize("opened", ["scene", "mock"])
def test_boxes_do_not_turn_over(opened, tmp_path):
    """A cabinet that stands turned, and one that turns: each has its own size and heading at all angles."""
    cabinet = {"box": [0.5, 1.0, 1.7], "at": [0, 0, 0.85]}
    scene = tmp_path / "cabinets.yaml"
    objects = {f"At_{yaw}": {"solids": [{**cabinet, "turn_deg": yaw}]} for yaw in (0, 40, 44)}
    objects["Turning"] = {"solids": [{**cabinet, "at": [1, 1, 0.85]}]}
    scene.write_text(yaml.safe_dump({"sky": [0, 0, 0], "objects": objects}))
    with omniscv.open_source(f"{opened}://{scene}") as source:
        for yaw_deg in (40, 44, 46, 70):
            poses = {"Turning": omniscv.object_pose((1, 1, 0.85), yaw_deg)}
            boxes = source.at(omniscv.Instant(poses=poses)).geometry().boxes
            assert boxes["Turning"].size == pytest.approx([0.5, 1.0, 1.7], abs=1e-4)
            assert heading_deg(boxes["Turning"]) == pytest.approx(yaw_deg, abs=1e-3)
        for yaw_deg in (0, 40, 44):
            box = boxes[f"At_{yaw_deg}"]
            assert box.size == pytest.approx([0.5, 1.0, 1.7], abs=1e-4)
            assert heading_deg(box) == pytest.approx(yaw_deg, abs=1e-3)


def heading_deg(box):
    return math.degrees(math.atan2(box.R_w_b[1, 0], box.R_w_b[0, 0]))
