"""Rooms fitted to images, against the rooms that were rendered."""

from dataclasses import replace

import numpy as np
import pytest
from support.rooms import L_SHAPE, T_SHAPE, U_SHAPE, room_of_scene, scene_of_plan
from support.traced_frames import traced

import mock_server
from omniscv import Pose, Renderer, cameras, open_source
from omniscv.dataset import truths
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.frame.classes import ClassTable, SemanticClass
from omniscv.geometry.scene_geometry import SceneGeometry
from omniscv.sources.base import SourceWrapper
from omniscv.sources.scene import SceneSource
from omniscv.truth import layout, room_of
from omniscv.truth.room_layout import Picture

PANORAMA = cameras.create("equirectangular", 256, 128)
SHOWN = ("object_mask", "depth", "normals")


def picture_of(scene, position):
    """What a perfect image of a scene shows, with labels of its objects."""
    pose = Pose.from_angles(position, yaw_deg=33)
    names = {name: scene.label(name) for name in scene.objects}
    return Picture(PANORAMA, pose, traced(scene, PANORAMA, pose), names)


def rendered(source, camera=PANORAMA, **known):
    renderer = Renderer(source)
    image = renderer.render(camera, Pose.from_angles((0.1, 0.2, 1.5)), SHOWN)
    instances = {name: i for i, name in enumerate(image.objects.names(), 1)}
    return Frame("a", "lens", image.camera, image.pose, instances=instances, image=image, **known), renderer


def same_room(found, corners, names, within_m):
    """Whether a room has these corners, in any turn, and the walls between them these names."""
    start = int(np.linalg.norm(found.corners_w - corners[0], axis=1).argmin())
    turned = np.roll(found.corners_w, -start, axis=0)
    walls = np.roll(found.walls, -start)
    assert turned.shape == np.shape(corners)
    assert np.abs(turned - corners).max() <= within_m
    assert walls.tolist() == list(names)


@pytest.mark.parametrize("scene", ["four-wall", "six-wall"])
def test_an_image_of_a_furnished_room_gives_its_walls(scene):
    """Rendered as users render: walls behind furniture are seen above it, and labels may be blurred."""
    shown, _ = rendered(open_source(f"scene://{scene}"))
    found = layout([shown.image])
    expected = room_of_scene(scene)
    assert found.source == "fitted"
    assert found.residual_m < 0.002
    same_room(found.room, expected.corners_w, expected.walls, 0.002)
    assert abs(found.room.floor_z) < 0.001
    assert abs(found.room.ceiling_z - 2.8) < 0.001
    assert (found.room.floor, found.room.ceiling) == ("Layout_Floor", "Layout_Ceiling")


@pytest.mark.parametrize(
    ("plan", "places"),
    [
        (L_SHAPE, [(0.5, -0.5, 1.5)]),
        (T_SHAPE, [(0.2, -2, 1.2), (3, 1, 1.2), (-3, 1, 1.7)]),
        (U_SHAPE, [(2, 2, 1.2), (-2, 2, 1.4), (0, -1, 1)]),
    ],
)
def test_several_images_are_fitted_together(plan, places):
    scene = scene_of_plan(plan)
    fitted = layout([picture_of(scene, place) for place in places])
    assert fitted.residual_m < 1e-4
    same_room(fitted.room, np.array(plan), [f"Layout_Wall_{i + 1}" for i in range(len(plan))], 1e-3)
    if len(places) > 1:
        with pytest.raises(ArgumentError, match="walls that do not close"):
            layout([picture_of(scene, places[0])])


@pytest.mark.parametrize("turn_deg", [17, 45])
def test_one_object_may_be_all_walls_and_stand_at_any_angle(turn_deg):
    """The U's arms end on one plane: which walls follow each other is found by their ends."""
    scene = scene_of_plan(U_SHAPE)
    label = {name: 99 if "Wall" in name else scene.label(name) for name in scene.objects}
    turn = Pose.from_angles((0.4, -0.2, 0.1), yaw_deg=turn_deg)
    spin = turn.R_w_c @ Pose.from_angles((0, 0, 0)).R_w_c.T
    pictures = []
    for place in ((2, 2, 1.2), (-2, 2, 1.4), (0, -1, 1)):
        seen = picture_of(scene, place)
        labels = np.array([0, *(label[name] for name in scene.objects)], np.uint16)[seen.files["labels"]]
        pose = Pose(spin @ seen.pose.position + turn.position, spin @ seen.pose.R_w_c)
        names = {"Layout_Walls": 99, **{name: label[name] for name in label if "Wall" not in name}}
        pictures.append(Picture(PANORAMA, pose, {**seen.files, "labels": labels}, names))
    room = layout(pictures).room
    expected = np.array(U_SHAPE) @ spin[:2, :2].T + turn.position[:2]
    same_room(room, expected, ["Layout_Walls"] * 8, 2e-3)


def test_classes_name_the_surfaces_of_the_room():
    scene = scene_of_plan(L_SHAPE)
    seen = picture_of(scene, (0.5, -0.5, 1.5))
    names = {name.replace("Layout_", "SM_"): label for name, label in seen.instances.items()}
    renamed = Picture(seen.camera, seen.pose, seen.files, names)
    with pytest.raises(ArgumentError, match=r"objects named Layout\*, or of the classes"):
        layout([renamed])
    classes = {name: SemanticClass(i, name) for i, name in enumerate(("wall", "floor", "ceiling"), 1)}
    of_object = {name: name.split("_")[1].lower() for name in names}
    room = layout([renamed], ClassTable(classes, of_object)).room
    same_room(room, np.array(L_SHAPE), [f"SM_Wall_{i + 1}" for i in range(6)], 1e-3)


def test_images_that_show_no_prism_or_not_enough_are_refused():
    seen = picture_of(scene_of_plan(L_SHAPE), (0.5, -0.5, 1.5))
    ceiling = seen.files["labels"] == seen.instances["Layout_Ceiling"]
    columns = np.sin(np.arange(PANORAMA.width) / 10)
    depth = np.where(ceiling, seen.files["depth"] * (1 + 0.1 * columns), seen.files["depth"])
    only_walls = {name: label for name, label in seen.instances.items() if "Wall" in name}
    flat = {key: value for key, value in seen.files.items() if key != "normals"}
    for files, names, says in (
        (seen.files | {"depth": depth}, seen.instances, r"within 0\.02 m, got points that are 0\.\d+ m off"),
        (seen.files, only_walls, "images that show the floor"),
        (flat, seen.instances, "render with normals, too"),
    ):
        with pytest.raises(ArgumentError, match=says):
            layout([Picture(seen.camera, seen.pose, files, names)])
    with pytest.raises(ArgumentError, match="got none"):
        layout([])


def test_the_room_of_a_source_without_one_is_fitted():
    observed, _ = rendered(SceneSource(mock_server.load_scene("four-wall")))
    truth = truths.get("layout")
    record = truth.apply(observed, {})
    assert record["source"] == "fitted"
    assert record["residual_m"] < 0.002
    assert truth.may_capture(observed.geometry, {})
    known = SceneGeometry(room=room_of_scene("four-wall"))
    assert not truth.may_capture(known, {})
    assert truth.may_capture(known, {"source": "fitted"})
    observed = replace(observed, geometry=known)
    assert truth.apply(observed, {"tolerance": {"abs_m": 0.01}, "source": "scene"})["source"] == "scene"


class Hides(SourceWrapper):
    """A live engine of sorts: it knows no shapes, but shows the room without what is in it."""

    def __init__(self, source, empty):
        super().__init__(source)
        self.hidden = []
        self._empty = empty

    def geometry(self):
        return SceneGeometry()

    def without(self, objects):
        self.hidden.append(sorted(objects))
        return SceneSource(self._empty)


def test_a_room_that_an_image_does_not_show_whole_is_fitted_without_furniture():
    furnished = mock_server.load_scene("six-wall")
    source = Hides(SceneSource(furnished), scene_of_plan(L_SHAPE))
    lens = cameras.create("fisheye-equidistant", 96, 96, fov_deg=120)
    known, renderer = rendered(source, lens)
    with pytest.raises(ArgumentError, match="walls that do not close"):
        truths.get("layout").apply(known, {})
    record = truths.get("layout").apply(replace(known, renderer=renderer), {})
    assert source.hidden == [[name for name in furnished.objects if not name.startswith("Layout")]]
    same_room(room_of(record), np.array(L_SHAPE), [f"Layout_Wall_{i + 1}" for i in range(6)], 0.002)
    visible = [piece["visible"] for edge in record["edges"] for piece in edge["pieces"]]
    assert {True, False} <= set(visible)  # the image's own depth decides what furniture hides
