"""Files that fail: one line that names the file, or a part that is left out and counted."""

import io
import json
import logging
import struct
import zlib

import numpy as np
import pytest
import trimesh
from PIL import Image
from support import mesh_files
from support.mesh_files import FACES, Builder, corners_w, png, y_up

import omniscv
from omniscv.errors import ArgumentError, SourceError


def changed(change, before=lambda built: None):
    """Return a writer of a GLB file whose JSON is changed before it is written by hand."""

    def write(path):
        built = Builder()
        built.square("Left", -2)
        built.square("Right", 2)
        before(built)
        built.json["buffers"] = [{"byteLength": len(built.data)}]
        change(built.json)
        text = json.dumps(built.json).encode()
        text += b" " * (-len(text) % 4)
        data = bytes(built.data) + b"\0" * (-len(built.data) % 4)
        chunks = (
            struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(data), 0x4E4942) + data
        )
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)

    return write


def setting(*keys, to):
    """Return a change of one value in the JSON."""

    def change(document):
        owner = document
        for key in keys[:-1]:
            owner = owner[key]
        owner[keys[-1]] = to

    return change


def cut(write, share):
    def write_cut(path):
        write(path)
        data = path.read_bytes()
        path.write_bytes(data[: int(share * len(data))])

    return write_cut


def bomb(pixels):
    """Return a PNG file of a header that claims a number of pixels each way."""
    data = bytearray(png(np.zeros((1, 1, 3), np.uint8)))
    data[16:24] = struct.pack(">II", pixels, pixels)
    data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    return bytes(data)


def image(data):
    return lambda built: built.json["images"].append({"bufferView": built.view(data)})


def last_image(document):
    document["textures"][0]["source"] = len(document["images"]) - 1


def text(content):
    return lambda path: path.write_text(content)


NOISE = np.random.default_rng(0).integers(0, 255, (32, 32, 3), np.uint8)
PLY = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
FACE = "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
ROWS = "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"

REFUSED = {
    "a cut file": ("a.glb", cut(mesh_files.plain_glb, 0.7), "expected .* bytes, got .*: the file is cut off"),
    "a few bytes": ("a.glb", cut(mesh_files.plain_glb, 0.005), "expected a whole GLB file|expected JSON"),
    "no JSON": ("a.gltf", text("{]"), "expected JSON"),
    "glTF 1": ("a.gltf", text('{"asset": {"version": "1.0"}}'), "expected glTF 2.0, got version '1.0'"),
    "no triangles": ("a.gltf", text('{"asset": {"version": "2.0"}}'), "expected triangles, got none"),
    "indices out of range": (
        "a.glb",
        changed(
            lambda document: document["meshes"][0]["primitives"][0].update(
                indices=len(document["accessors"]) - 1
            ),
            lambda built: built.accessor(np.array([0, 1, 9], "u2")),
        ),
        "Left: expected indices of 4 vertices, got 9",
    ),
    "a billion claimed vertices": (
        "a.glb",
        changed(setting("accessors", 0, "count", to=10**9)),
        "expected .* bytes of 1000000000 values, got 48",
    ),
    "a billion that are nowhere": (
        "a.glb",
        changed(
            lambda document: (
                document["accessors"][0].update(count=10**9) or document["accessors"][0].pop("bufferView")
            )
        ),
        "expected at most .* numbers, got 3000000000",
    ),
    "a node in a circle": (
        "a.glb",
        changed(setting("nodes", 0, "children", to=[0])),
        "node 0: expected a tree of nodes, got it twice",
    ),
    "a mesh that is not there": (
        "a.glb",
        changed(setting("nodes", 0, "mesh", to=7)),
        "expected one of 2 meshes, got 7",
    ),
    "a buffer by network": (
        "a.glb",
        changed(setting("buffers", 0, "uri", to="https://example.org/a.bin")),
        "expected files in its folder, got 'https://example.org/a.bin'; nothing is fetched",
    ),
    "a buffer outside of the folder": (
        "a.glb",
        changed(setting("buffers", 0, "uri", to="../../etc/passwd")),
        r"expected files in its folder, got '\.\./\.\./etc/passwd'",
    ),
    "a picture that is missing": (
        "a.glb",
        changed(setting("images", 0, to={"uri": "paint.png"})),
        "expected the file 'paint.png' beside it, got none",
    ),
    "a picture that is none": (
        "a.glb",
        changed(last_image, image(b"GIF89a no picture")),
        "image 2: expected a picture, got: cannot identify",
    ),
    "a picture that is cut off": (
        "a.glb",
        changed(last_image, image(png(NOISE)[:300])),
        "image 2: expected a picture, got:",
    ),
    "a bomb of pixels": (
        "a.glb",
        changed(last_image, image(bomb(30000))),
        "image 2: expected .* pixels",
    ),
    "an extension that changes geometry": (
        "a.glb",
        changed(setting("extensionsRequired", to=["NV_micromesh"])),
        "expected a file without NV_micromesh, which it requires",
    ),
    "a skin": (
        "a.glb",
        changed(setting("nodes", 0, "skin", to=0)),
        "Left: expected a rigid mesh, got a skin",
    ),
    "a PLY that claims rows": (
        "a.ply",
        text(PLY.replace("3", "1000000000") + FACE + ROWS),
        "expected 1000000000 rows",
    ),
    "a PLY that is cut off": (
        "a.ply",
        cut(lambda path: mesh_files.ply(path), 0.9),
        "element face: expected",
    ),
    "a PLY without faces": (
        "a.ply",
        text(PLY + "end_header\n0 0 0\n1 0 0\n0 1 0\n"),
        "expected faces with lists",
    ),
    "a PLY with words": (
        "a.ply",
        text(PLY + FACE + ROWS.replace("1 0 0", "x 0 0")),
        "expected 3 rows of numbers",
    ),
    "an OBJ with words": ("a.obj", text("v 0 0 x\nf 1 1 1"), "v: expected 3 numbers a line"),
    "an OBJ with indices out of range": (
        "a.obj",
        text("v 0 0 0\nf 1 2 3"),
        "expected indices of 1 vertices, got 2",
    ),
    "an OBJ that names a file elsewhere": (
        "a.obj",
        text("mtllib ../paint.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3"),
        r"expected files in its folder, got '\.\./paint\.mtl'",
    ),
    "an STL that is none": ("a.stl", text("solid nothing"), "expected .stl of triangles|expected triangles"),
    "another form": (
        "a.blend",
        text("BLENDER"),
        r"expected a file of .glb, .gltf, .ply, .obj, .* got .blend",
    ),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_a_broken_file_is_one_line_that_names_it(kind, tmp_path):
    name, write, message = REFUSED[kind]
    path = tmp_path / name
    write(path)
    with pytest.raises(ArgumentError, match=message) as error:
        omniscv.open_source(f"mesh://{path}")
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("share", np.linspace(0.02, 0.98, 25), ids="{:.2f}".format)
@pytest.mark.parametrize("form", ["glb", "glb draco", "glb meshopt", "ply doubles", "obj", "off"])
def test_a_file_cut_anywhere_is_one_line_or_less_of_the_mesh(form, share, tmp_path):
    name, write = mesh_files.FORMS[form]
    path = tmp_path / name
    cut(write, share)(path)
    try:
        with omniscv.open_source(f"mesh://{path}") as source:
            names = source.objects().names()
            message = str(path)
    except ArgumentError as error:
        names = []
        message = str(error)
    assert set(names) <= {"Left", "Right", "object_7", "object_12", "mesh"}
    assert str(path) in message
    assert "\n" not in message


def spoiled(data, rng):
    """Return bytes of which a few are others, from the middle of the file on."""
    result = bytearray(data)
    for _ in range(rng.integers(1, 5)):
        place = rng.integers(len(data) // 2, len(data) - 4)
        result[place : place + 4] = rng.choice([b"\xff\xff\xff\xff", b"\0\0\0\0", b"9999", b"\0\0\xc0\x7f"])
    return bytes(result)


@pytest.mark.parametrize("form", mesh_files.FORMS)
def test_a_file_with_other_bytes_is_one_line_or_a_mesh_that_rays_meet(form, tmp_path):
    name, write = mesh_files.FORMS[form]
    path = tmp_path / name
    write(path)
    data = path.read_bytes()
    rng = np.random.default_rng(1)
    for _ in range(25):
        path.write_bytes(spoiled(data, rng))
        message = str(path)
        try:
            with omniscv.open_source(f"mesh://{path}") as source:
                source.trace(np.zeros(3), np.array([[1.0, 0, 0], [-1, 0, 0]]))
        except ArgumentError as error:
            message = str(error)
        assert str(path) in message
        assert "\n" not in message


def with_faults(path):
    """One square with a triangle without area, one with a vertex that is no number, and a line."""
    built = Builder()
    built.square("Left", -2)
    place = y_up(corners_w(2))
    place = np.concatenate([place, [[np.nan, 0, 0]]]).astype("f4")
    faces = np.concatenate([FACES.ravel(), [0, 1, 1, 0, 1, 4]]).astype("u2")
    built.node("Right", {"attributes": {"POSITION": built.accessor(place)}, "indices": built.accessor(faces)})
    built.node("Line", {"attributes": {"POSITION": built.accessor(place)}, "mode": 1})
    built.write(path)


def test_what_is_left_out_is_counted_in_a_warning(tmp_path, caplog):
    path = tmp_path / "room.glb"
    with_faults(path)
    with caplog.at_level(logging.WARNING), omniscv.open_source(f"mesh://{path}") as source:
        assert source.objects().names() == ["Left", "Right"]
    assert [record.getMessage().partition(": ")[2] for record in caplog.records] == [
        "left out 1 primitives of points or lines",
        "left out 1 triangles with vertices that are no numbers",
        "left out 1 triangles without area",
        "not closed: 8 edges bound one triangle alone; through holes is sky",
    ]


def test_ktx_pictures_cost_colours_alone_and_the_line_says_how_to_convert(tmp_path):
    path = tmp_path / "room.glb"
    built = Builder()
    built.square("Left", -2)
    built.json["textures"] = [{"extensions": {"KHR_texture_basisu": {"source": 0}}}]
    built.json["images"] = [{"bufferView": 0, "mimeType": "image/ktx2"}]
    built.json["extensionsRequired"] = built.json["extensionsUsed"] = ["KHR_texture_basisu"]
    built.write(path)
    camera = omniscv.cameras.create("equirectangular", width=32, height=16)
    pose = omniscv.Pose.from_angles((0, 0, 0.5))
    with omniscv.open_source(f"mesh://{path}") as source:
        assert source.capabilities.modes == {"object_mask", "depth", "normals"}
        image = omniscv.render(camera, pose, source, ("object_mask", "depth"))
        assert image.labels.max() == 1
        with pytest.raises(ArgumentError, match="got KTX2; convert them: npx @gltf-transform/cli"):
            source.shade(np.zeros(3), np.array([[1.0, 0, 0]]))


@pytest.mark.parametrize(
    ("query", "message"),
    [
        ("unit=yard", "unit: expected one of m, cm, mm, km, in, ft; got 'yard'"),
        ("lamp=1,2", "lamp: expected 3 finite numbers|lamp: expected"),
        ("lamps=1", "expected options among unit, up, labels, alpha, lamp, traces"),
        ("labels=room", "labels: expected object, material, or a file"),
    ],
)
def test_a_wrong_option_is_one_line(query, message, tmp_path):
    path = tmp_path / "room.glb"
    mesh_files.plain_glb(path)
    with pytest.raises(ArgumentError, match=message):
        omniscv.open_source(f"mesh://{path}?{query}")


def test_a_picture_of_an_hdr_of_colours_is_not_executed(tmp_path):
    """Names of pictures are names of files, whatever they look like."""
    path = tmp_path / "room.obj"
    file = io.BytesIO()
    Image.new("RGB", (2, 2)).save(file, "PNG")
    (tmp_path / "$(touch owned).png").write_bytes(file.getvalue())
    (tmp_path / "paint.mtl").write_text("newmtl a\nmap_Kd $(touch owned).png\n")
    path.write_text("mtllib paint.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n")
    with omniscv.open_source(f"mesh://{path}") as source:
        assert source.objects().names() == ["mesh"]
    assert not (tmp_path / "owned").exists()


@pytest.mark.parametrize("closed", [True, False])
def test_open_edges_are_counted_by_place_and_a_closed_mesh_has_none(closed, tmp_path, caplog):
    """Each of a ball's triangles has vertices of its own: edges agree by where they are."""
    ball = trimesh.creation.icosphere(subdivisions=2)
    ball.unmerge_vertices()
    if not closed:
        ball.update_faces(np.arange(len(ball.faces)) != 7)
    ball.export(tmp_path / "ball.ply")
    with caplog.at_level(logging.WARNING), omniscv.open_source(f"mesh://{tmp_path}/ball.ply"):
        said = [record.getMessage() for record in caplog.records]
    assert [text.split(": ")[-1].split()[0] for text in said] == ([] if closed else ["3"])


def test_where_there_is_no_embree_one_line_says_so(tmp_path, monkeypatch):
    from omniscv.sources.mesh import tracing

    mesh_files.plain_glb(tmp_path / "room.glb")
    monkeypatch.setattr(tracing, "find_spec", lambda name: None)
    with pytest.raises(SourceError, match="expected embreex, which there is for Linux"):
        omniscv.open_source(f"mesh://{tmp_path}/room.glb")
