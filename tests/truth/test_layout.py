"""Layouts as cameras see them, against exact tracing of the same room."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support import rooms
from support.cases import cases
from support.rooms import L_SHAPE, PLAIN, T_SHAPE, U_SHAPE, room_of_plan, scene_of_plan
from support.traced_frames import traced

import mock_server
from omniscv import Pose, cameras
from omniscv.errors import ArgumentError
from omniscv.geometry.scene_geometry import Room, SceneGeometry
from omniscv.truth import layout, project_layout, room_of

POSE = Pose.from_angles((0.2, -0.3, 1.5), yaw_deg=20, pitch_deg=5, roll_deg=-7)
SPACING_PX = 0.5
RAY_M = 1e-6


def example(name, width=128):
    return cameras.model(name).example(width)


def pieces_of(record):
    return [(edge, np.array(piece["pixels"]), piece) for edge in record["edges"] for piece in edge["pieces"]]


def on_edge(record, edge, camera, pose, pixels):
    """Origins, the points of an edge that are nearest to the pixels' rays, and how far off the rays are."""
    rays = camera.unproject(pixels)
    assert rays.valid.all()
    origins = pose.to_world(rays.origins)
    directions = rays.directions @ pose.R_w_c.T
    a, b = (np.array(record["corners"][k]["world"]) for k in edge["corners"])
    along = (b - a) / np.linalg.norm(b - a)
    # The least distance of two lines, from the normal equations of both parameters.
    cosine = directions @ along
    offset = a - origins
    share = (cosine * (offset * directions).sum(1) - offset @ along) / (1 - cosine**2)
    points = a + np.clip(share, 0, np.linalg.norm(b - a))[:, None] * along
    away = np.linalg.norm(np.cross(points - origins, directions), axis=1)
    return origins, points, away


def traced_visible(scene, origins, points, hidden=()):
    offset = points - origins
    distance = np.linalg.norm(offset, axis=1)
    return scene.trace(origins, offset, hidden=hidden).distance >= distance - 1e-6


def checked_pieces(record, scene, camera, pose):
    """The pieces, whose pixels see their edges, lie close, and have the flags of tracing."""
    for edge, pixels, piece in pieces_of(record):
        origins, points, away = on_edge(record, edge, camera, pose, pixels)
        assert away.max() <= RAY_M
        assert (np.linalg.norm(np.diff(pixels, axis=0), axis=1) <= SPACING_PX).all()
        assert (traced_visible(scene, origins, points) == piece["visible_room"]).all()
    return [piece for _, _, piece in pieces_of(record)]


@pytest.mark.parametrize(
    "name", [name for name in rooms.FAMILIES if name != "rolling-shutter"]
)  # two seconds
def test_curves_are_those_of_the_edges_with_the_flags_of_tracing(name):
    camera = example(name, 48)
    record = project_layout(room_of_plan(L_SHAPE), camera, POSE)
    pieces = checked_pieces(record, scene_of_plan(L_SHAPE), camera, POSE)
    assert pieces
    assert {piece["visible"] for piece in pieces} == {None}
    for edge in record["edges"]:  # the curves hold all that the camera sees of the edges
        a, b = (np.array(record["corners"][k]["camera"]) for k in edge["corners"])
        pixels, valid = camera.project(a + np.linspace(0, 1, 150)[:, None] * (b - a))
        found = [np.array(piece["pixels"]) for piece in edge["pieces"]]
        if not valid.any():
            assert not found
            continue
        away = np.linalg.norm(pixels[valid][:, None] - np.concatenate(found), axis=-1).min(axis=1)
        assert away.max() <= SPACING_PX


def test_a_long_lens_misses_no_edge():
    """Half a degree of the room: between samples a degree apart, its whole view would be missed."""
    camera = cameras.create("pinhole", 200, 150, fov_deg=0.5)
    pose = Pose.look_at((0.2, -0.3, 1.5), (4, -1.234, 0.0))
    record = project_layout(room_of_plan(L_SHAPE), camera, pose)
    ((edge, pixels, piece),) = pieces_of(record)
    assert (edge["id"], piece["visible_room"]) == (1, True)
    assert np.linalg.norm(pixels - [100, 75], axis=1).min() <= SPACING_PX
    assert pixels[:, 0].min() < 0.01
    assert pixels[:, 0].max() > 199.99


@pytest.mark.parametrize(("name", "width"), [("equirectangular", 512), ("noncentral-spherical-mirror", 350)])
def test_flags_behind_furniture_are_those_of_tracing(name, width):
    """Depth has one answer a pixel: a silhouette between two of them is known to half a pixel."""
    scene = mock_server.load_scene("six-wall")
    camera = example(name, width)
    record = project_layout(
        rooms.room_of_scene("six-wall"), camera, POSE, traced(scene, camera, POSE)["depth"]
    )
    wrong = clear = wrong_clear = total = 0
    for edge, pixels, piece in pieces_of(record):
        origins, points, _ = on_edge(record, edge, camera, POSE, pixels)
        expected = traced_visible(scene, origins, points)
        near = same_within_a_pixel(scene, camera, POSE, record, edge, pixels, expected)
        total = total + len(pixels)
        wrong = wrong + (expected != piece["visible"]).sum()
        clear = clear + near.sum()
        wrong_clear = wrong_clear + (near & (expected != piece["visible"])).sum()
    assert wrong_clear == 0
    assert wrong <= 0.008 * total  # about one sample at each silhouette
    assert clear >= 0.9 * total


def same_within_a_pixel(scene, camera, pose, record, edge, pixels, expected):
    """Where what is traced along the edge does not change within a pixel."""
    same = np.ones(len(pixels), bool)
    for shift in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        rays = camera.unproject(pixels + shift)
        origins = pose.to_world(rays.origins)
        directions = rays.directions @ pose.R_w_c.T
        furniture = [name for name in scene.objects if not name.startswith("Layout")]
        full = scene.trace(origins, directions)
        empty = scene.trace(origins, directions, hidden=furniture)
        same &= (full.distance == empty.distance) == expected
    return same


@pytest.mark.parametrize(
    ("plan", "position"),
    [(T_SHAPE, (3.1, 0.7, 1.2)), (U_SHAPE, (0.2, -1.2, 1.7)), (PLAIN, (4.0, 0.5, 4.0))],
    ids=["T", "U", "from outside"],
)
def test_rooms_hide_parts_of_themselves(plan, position):
    pose = Pose.from_angles(position)
    camera = example("equirectangular", 256)
    scene = scene_of_plan(plan)
    record = project_layout(room_of_plan(plan), camera, pose, traced(scene, camera, pose)["depth"])
    pieces = checked_pieces(record, scene, camera, pose)
    assert {piece["visible_room"] for piece in pieces} == {True, False}
    for corner in record["corners"]:
        origin = pose.position[None]
        point = np.array([corner["world"]])
        assert traced_visible(scene, origin, point)[0] == corner["visible_room"]


def test_edges_break_at_the_seam_and_come_up_to_it_on_both_sides():
    camera = example("equirectangular", 256)
    pose = Pose.from_angles((2 / 3, 1.0, 1.5), yaw_deg=0)
    room = room_of_plan([[-2, 1], [2, -3], [2, 3]])
    record = project_layout(room, camera, pose)
    behind = record["corners"][0]
    assert behind["in_image"]
    assert behind["pixel"][0] in (0, camera.width)
    ends = [np.array(piece["pixels"])[[0, -1], 0] for _, _, piece in pieces_of(record)]
    at_seam = [u for u in np.concatenate(ends) if min(u, camera.width - u) < 1e-4]
    assert len(at_seam) >= 4  # both of the floor's and both of the ceiling's edges end there
    back = project_layout(room_of_plan(PLAIN), camera, Pose.from_angles((0, 0, 1.5)))["edges"][3]
    assert len(back["pieces"]) == 2
    ends = sorted(u for piece in back["pieces"] for u in (piece["pixels"][0][0], piece["pixels"][-1][0]))
    assert ends[0] < 1e-4
    assert ends[-1] > camera.width - 1e-4


def test_a_record_is_plain_and_holds_its_room():
    room = room_of_plan(L_SHAPE, 2.6)
    record = project_layout(layout(SceneGeometry(room=room)), example("pinhole"), POSE)
    assert (record["version"], record["source"], record["residual_m"]) == (1, "scene", 0.0)
    assert (record["floor"], record["ceiling"], record["camera_height"]) == (0.0, 2.6, 1.5)
    planes = [edge["planes"] for edge in record["edges"][12:14]]
    assert planes == [["Layout_Wall_6", "Layout_Wall_1"], ["Layout_Wall_1", "Layout_Wall_2"]]
    assert room_of(record).to_dict() == room.to_dict()
    for corner in record["corners"]:
        assert (corner["pixel"] is None) is not corner["in_image"]
        assert not (corner["visible_room"] and not corner["in_image"])


def test_wrong_arguments_are_one_line():
    room = room_of_plan(PLAIN)
    camera = example("pinhole")
    flat = Room(room.corners_w, 3.0, 2.0, room.walls, "f", "c")
    wrong = (PLAIN[::-1], "counterclockwise"), (PLAIN[:2], "at least 3"), ([PLAIN[0], *PLAIN], "different")
    for plan, words in wrong:
        with pytest.raises(ArgumentError, match=words):
            project_layout(room_of_plan(plan), camera, POSE)
    record = project_layout(room, camera, POSE)
    record["corners"][5]["world"][2] += 0.4
    for call, words in (
        (lambda: project_layout(flat, camera, POSE), r"room\.ceiling_z: expected a finite number > 3"),
        (lambda: project_layout(room, camera, POSE, np.ones((3, 4))), r"the image.s shape \(128, 128\)"),
        (lambda: layout(SceneGeometry()), "a scene whose room is known"),
        (lambda: room_of(record), r"got corners that are 0\.4 m off"),
        (lambda: room_of({}), "expected a record of a layout"),
    ):
        with pytest.raises(ArgumentError, match=words):
            call()


@cases(8)
@given(
    name=st.sampled_from(cameras.names()),
    place=st.tuples(st.floats(-2.8, 1.5), st.floats(-2.3, 3.3), st.floats(0.1, 2.7)),
    angles=st.tuples(st.floats(-180, 180), st.floats(-90, 90), st.floats(-180, 180)),
)
def test_samples_lie_on_their_edges_wherever_the_camera_is(name, place, angles):
    # A ray along a wall is decided by rounding: a push-broom that flies along an axis has whole rows of them.
    off_the_walls = np.array([0.0123, 0.0171, 0.0137])
    off_the_axes = np.array([0.37, 0.41, 0.53])
    camera = example(name, 64)
    pose = Pose.from_angles(place + off_the_walls, *(angles + off_the_axes))
    checked_pieces(project_layout(room_of_plan(L_SHAPE), camera, pose), scene_of_plan(L_SHAPE), camera, pose)
