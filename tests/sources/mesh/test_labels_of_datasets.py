"""Labels that stand in other files: forms of Replica, HM3D, ScanNet++ and Matterport3D, made small."""

import json

import numpy as np
import plyfile
import pytest
from support import mesh_files
from support.mesh_files import FACES, Builder, corners_w, y_up

import omniscv
from omniscv.errors import ArgumentError

CENTER_W = np.array([0.0, 0.1, 0.45])
TOWARD = np.array([[-1.0, 0, 0], [1.0, 0, 0]])
"""To the left square, and to the right one."""


def named(address):
    """Return the names of what stands to the left and to the right."""
    with omniscv.open_source(address) as source:
        label = source.trace(CENTER_W, TOWARD).label
        names = ["", *source.objects().names()]
    return [names[number] for number in label]


def replica(folder):
    mesh_files.ply(folder / "mesh_semantic.ply", quads=True)
    classes = [{"id": 3, "name": "wall"}, {"id": 20, "name": "indoor plant"}]
    objects = [{"id": 7, "class_id": 20}, {"id": 12, "class_id": 3}, {"id": 13, "class_id": 99}]
    (folder / "info_semantic.json").write_text(json.dumps({"classes": classes, "objects": objects}))
    return f"mesh://{folder}/mesh_semantic.ply", ["indoor_plant_7", "wall_12"]


def scannetpp(folder):
    mesh_files.ply(folder / "mesh_aligned_0.05.ply")
    segments = [4, 4, 4, 9, 5, 5, 5, 5]  # one corner of the left square is another's
    (folder / "segments.json").write_text(json.dumps({"segIndices": segments}))
    groups = [
        {"id": 1, "label": "chair", "segments": [4]},
        {"id": 2, "label": "blue box", "segments": [5, 8]},
    ]
    (folder / "segments_anno.json").write_text(json.dumps({"segGroups": groups}))
    return f"mesh://{folder}/mesh_aligned_0.05.ply?labels=segments_anno.json", ["chair_1", "blue_box_2"]


def house(folder):
    (folder / "a.house").write_text(
        "ASCII 1.1\nC 0 5 picture 6 picture 0 0 0 0 0\nC 1 28 armchair 3 chair 0 0 0 0 0\n"
        "O 7 0 1 0 0 0 1 0 0 0 1 0 1 1 1 0 0 0 0 0 0 0 0\nO 12 0 0 0 0 0 1 0 0 0 1 0 1 1 1 0 0 0 0 0 0 0 0\n"
    )


def matterport_objects(folder):
    mesh_files.ply(folder / "a_semantic.ply")
    house(folder)
    return f"mesh://{folder}/a_semantic.ply?labels=a.house", ["chair_7", "picture_12"]


def matterport_categories(folder):
    mesh_files.ply(folder / "ids.ply")
    data = plyfile.PlyData.read(folder / "ids.ply")
    face = data["face"].data
    table = np.empty(len(face), [("vertex_indices", "O"), ("category_id", "i4")])
    table["vertex_indices"] = face["vertex_indices"]
    table["category_id"] = np.where(face["object_id"] == 7, 28, 5)
    plyfile.PlyData([data["vertex"], plyfile.PlyElement.describe(table, "face")]).write(
        folder / "region0.ply"
    )
    house(folder)
    return f"mesh://{folder}/region0.ply?labels=a.house", ["chair_28", "picture_5"]


def hm3d_colors(folder):
    built = Builder()
    for x, code in ((-2, 0x2F04A1), (2, 0xFE10C0)):
        rgb = np.array([code >> 16, code >> 8 & 255, code & 255]) / 255
        light = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        attributes = {
            "POSITION": built.accessor(y_up(corners_w(x)).astype("f4")),
            "COLOR_0": built.accessor(np.tile(light, (4, 1)).astype("f4")),
        }
        indices = built.accessor(np.array([0, 1, 2, 0, 2, 3, 2, 1, 0, 3, 2, 0], "u2"))
        built.node("chunk", {"attributes": attributes, "indices": indices})
    built.write(folder / "a.semantic.glb")
    annotations(folder)
    return f"mesh://{folder}/a.semantic.glb?labels=a.semantic.txt", ["ceiling_lamp,_round_1", "door_2"]


def hm3d_pictures(folder):
    """Both squares in one mesh, whose picture has a colour for each object."""
    built = Builder()
    pixels = np.zeros((8, 16, 3), np.uint8)
    pixels[:, :8] = (0x2F, 0x04, 0xA1)
    pixels[:, 8:] = (0xFE, 0x10, 0xC0)
    image = built.add("images", {"bufferView": built.view(mesh_files.png(pixels)), "mimeType": "image/png"})
    surface = {"baseColorTexture": {"index": built.add("textures", {"source": image})}}
    material = built.add("materials", {"pbrMetallicRoughness": surface, "doubleSided": True})
    places = np.concatenate([mesh_files.UV * [0.45, 1], mesh_files.UV * [0.45, 1] + [0.55, 0]])
    points = np.concatenate([corners_w(-2), corners_w(2)])
    attributes = {
        "POSITION": built.accessor(y_up(points).astype("f4")),
        "TEXCOORD_0": built.accessor(places.astype("f4")),
    }
    indices = built.accessor(np.concatenate([FACES, FACES + 4]).ravel().astype("u2"))
    built.node("chunk", {"attributes": attributes, "indices": indices, "material": material})
    built.write(folder / "a.semantic.glb")
    annotations(folder)
    return f"mesh://{folder}/a.semantic.glb?labels=a.semantic.txt", ["ceiling_lamp,_round_1", "door_2"]


def annotations(folder):
    (folder / "a.semantic.txt").write_text(
        'HM3D Semantic Annotations\n1,2F04A1,"ceiling lamp, round",0\n2,FE10C0,"door",1\n'
    )


FORMS = (replica, scannetpp, matterport_objects, matterport_categories, hm3d_colors, hm3d_pictures)


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.__name__)
def test_objects_have_the_names_of_the_labels_file(form, tmp_path):
    address, names = form(tmp_path)
    assert named(address) == names


@pytest.mark.parametrize(
    ("labels", "content", "message"),
    [
        ("info_semantic.json", "[]", "labels: expected a JSON object"),
        (
            "info_semantic.json",
            '{"objects": [{}], "classes": []}',
            "expected objects and classes with ids",
        ),
        ("segments_anno.json", '{"segGroups": [{"id": 1}]}', "labels: expected segIndices and segGroups"),
        (
            "a.semantic.txt",
            "1,2F04A1,chair,0",
            "expected 'HM3D Semantic Annotations' in the first line",
        ),
        ("a.house", "O x", "labels: expected lines of a .house file, got 'O x'"),
        ("gone.json", None, "expected the file 'gone.json' beside it, got none"),
        ("../up.json", None, r"expected files in its folder, got '\.\./up\.json'"),
        ("objects.xml", None, "labels: expected object, material, or a file"),
    ],
)
def test_labels_that_do_not_fit_are_refused_in_a_line(labels, content, message, tmp_path):
    mesh_files.ply(tmp_path / "room.ply")
    (tmp_path / "segments.json").write_text('{"segIndices": [1, 2]}')
    if content is not None:
        (tmp_path / labels).write_text(content)
    mesh = tmp_path / "room.ply"
    if labels.endswith(".txt"):
        mesh = tmp_path / "room.glb"
        mesh_files.plain_glb(mesh)
    with pytest.raises(ArgumentError, match=message):
        omniscv.open_source(f"mesh://{mesh}?labels={labels}")
