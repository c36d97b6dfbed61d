"""Six faces as other tools name, turn and pack them: imported, composed, and judged by exact tracing."""

import json
from functools import cache

import numpy as np
import pytest
from PIL import Image
from support.pictured import AT, FACES, SCENE, SMALL, judge, panorama, put, run, seen

import omniscv
from omniscv import cli
from omniscv.chart import traced
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.importing.importing import import_pictures
from omniscv.importing.layouts import LAYOUTS
from omniscv.sources import View

EDGE = 64
HERE = Pose.from_angles(AT)
PLACE = ("--position", "0.3,-0.2,1.45")
WORDS = " ".join(FACES)


@cache
def pictures(name="faces", layer=0, edge=EDGE):
    return [seen(View(Pose(AT, face.R_w_c), 90, edge, edge))[layer] for face in LAYOUTS[name].arrangement]


def written(folder, name="faces", words=WORDS, file="{}.png", change=lambda pixels: pixels, **options):
    for word, pixels in zip(words.split(), pictures(name), strict=True):
        put(folder / file.format(word), change(pixels), **options)
    return folder


@pytest.fixture
def file(tmp_path):
    return tmp_path / "a.sqlite"


NAMED = [
    ("faces", WORDS, "{}"),
    ("faces", "0 1 2 3 4 5", "lit_{}"),
    ("top-bottom", "front right back left top bottom", "room_{}_0001"),
    ("gl", "posx negx posy negy posz negz", "{}"),
    ("gl", "0 1 2 3 4 5", "cube{}"),
    ("unity", "FrontTex BackTex LeftTex RightTex UpTex DownTex", "sky_{}"),
    ("matterport", "skybox0 skybox1 skybox2 skybox3 skybox4 skybox5", "d2_{}_sami"),
    ("blender-addon", "NORTH SOUTH WEST EAST ZENITH NADIR", "{}_0001"),
]


@pytest.mark.parametrize(("name", "words", "form"), NAMED)
def test_six_files_by_their_names_and_seams(name, words, form, tmp_path, file):
    found = import_pictures(written(tmp_path / "sky", name, words, f"{form}.png"), file, position=AT)
    assert found.captures == 6
    assert found.lines[0].startswith(f"layout {name}: step across edges ")
    judge(file, HERE, ("lit",))


@pytest.mark.parametrize("name", [name for name, each in LAYOUTS.items() if each.cells and name != "openexr"])
def test_six_faces_in_one_picture(name, tmp_path, file):
    rows = LAYOUTS[name].cells.split("/")
    whole = np.zeros((EDGE * len(rows), EDGE * len(rows[0]), 3), np.uint8)
    cells = [(r, c) for r, row in enumerate(rows) for c, cell in enumerate(row) if cell == "#"]
    for (r, c), pixels in zip(cells, pictures(name), strict=True):
        whole[r * EDGE : (r + 1) * EDGE, c * EDGE : (c + 1) * EDGE] = pixels
    put(tmp_path / "sky.png", whole)
    found = import_pictures(tmp_path / "sky.png", file, position=AT)
    assert found.lines[0].startswith(f"layout {name}: ")
    judge(file, HERE, ("lit",))


def test_a_named_layout_is_taken_at_its_word(tmp_path, file):
    folder = written(tmp_path / "sky", "unreal", "posx negx posy negy posz negz")
    import_pictures(folder, file, "unreal", position=AT)
    judge(file, HERE, ("lit",))


def exchange(folder, one, other):
    pair = [folder / f"{word}.png" for word in (one, other)]
    contents = [each.read_bytes() for each in pair]
    for each, content in zip(pair, reversed(contents), strict=True):
        each.write_bytes(content)


def test_exchanged_and_turned_faces_are_put_right(tmp_path, file):
    folder = written(tmp_path / "sky")
    exchange(folder, "back", "down")
    with Image.open(folder / "left.png") as picture:
        picture.transpose(Image.Transpose.ROTATE_270).save(folder / "left.png")  # clockwise
    found = import_pictures(folder, file, position=AT)
    assert {
        "back shows down, not back: put right",
        "left shows left turned by 90 degrees, not left: put right",
    } < {*found.lines}
    judge(file, HERE, ("lit",))


def test_alpha_exchanged_faces_and_mirrors(tmp_path, file, capsys):
    """Faces of an engine, alpha 0: left and right exchanged, or all of them mirrored: both give a cube."""
    folder = written(tmp_path / "rgba", change=lambda pixels: np.dstack([pixels, 0 * pixels[..., :1]]))
    assert run(folder, file) == 0
    assert float(capsys.readouterr().out.split("edges ")[1].split()[0]) > 0.3  # black faces: 0.00
    exchange(folder, "left", "right")
    assert run(folder, tmp_path / "b.sqlite", *PLACE) == 0
    out = capsys.readouterr().out
    assert "and so it is if all pictures are mirrored" in out
    assert "right shows left, not right: put right" in out
    mirrored = written(tmp_path / "mirrored", change=lambda pixels: pixels[:, ::-1])
    assert run(mirrored, tmp_path / "c.sqlite", "--mirrored", *PLACE) == 0
    assert "next best" in capsys.readouterr().out
    for name in "bc":
        judge(tmp_path / f"{name}.sqlite", HERE, ("lit",))


def test_faces_that_do_not_fit_are_refused(tmp_path, file):
    draw = np.random.default_rng(1)
    folder = written(tmp_path / "sky", change=lambda _: draw.integers(0, 256, (32, 32, 3), np.uint8))
    with pytest.raises(ArgumentError, match="expected six faces that fit together, got none that do clearly"):
        import_pictures(folder, file)
    assert not file.exists()


@pytest.mark.parametrize("depth", ["planar-m", "ray-mm"])
def test_colour_depth_and_masks_by_the_words_in_names(depth, tmp_path, file):
    folder = written(tmp_path / "room", file="lit_{}.png")
    names = {name: label for label, name in enumerate(sorted(SCENE.objects), start=1)}
    (tmp_path / "names.json").write_text(json.dumps(names))
    for word, face, planar, ids in zip(
        FACES, LAYOUTS["faces"].arrangement, pictures(layer=1), pictures(layer=2), strict=True
    ):
        lengths = View(Pose(AT, face.R_w_c), 90, EDGE, EDGE).ray_lengths()
        along = planar * lengths * 1000 if depth == "ray-mm" else planar
        np.save(folder / f"{word}_depth.npy", along.astype(np.float32))
        put(folder / f"masks/{word}.png", np.uint8(ids))
    assert run(folder, file, "--depth", depth, "--names", tmp_path / "names.json", *PLACE) == 0
    with omniscv.open_source(file) as source:
        image = omniscv.render(SMALL, HERE, source, ("depth",))
    truth = traced(SCENE, SMALL, HERE).distance
    off = np.abs(image.depth - truth)
    sure = np.isfinite(image.depth_error)
    assert (off <= 2 * image.depth_error + 1e-4)[sure].mean() > 0.998
    judge(file, HERE, ("lit", "object_mask"))


def test_a_panorama_becomes_six_faces(tmp_path, file):
    put(tmp_path / "pano.png", panorama(HERE)[0])
    found = import_pictures(tmp_path / "pano.png", file, position=AT, yaw_deg=40)
    assert found.lines == ("layout latlong: 1 place, 1 of lit", "resampled to six faces")
    with omniscv.open_source(file) as source:
        image = omniscv.render(SMALL, Pose.from_angles(AT, 40), source, ("lit",), filter="nearest")
    assert np.abs(image.lit - 255 * traced(SCENE, SMALL, HERE).color).mean() < 6


def test_another_form_of_pictures_and_a_place_that_needs_no_position(tmp_path, file):
    folder = written(tmp_path / "faces", file="{}.webp", lossless=True, exact=True)
    out = tmp_path / "out"
    assert run(folder, file, *PLACE) == 0
    assert cli.run(["render", "--source", str(file), "--size", "32x16", "--out", str(out)]) == 0
    assert json.loads((out / "equirectangular.json").read_text())["pose"]["position"] == list(AT)


def test_masks_without_a_list_and_colours_of_no_object(tmp_path, file, capsys):
    folder = written(tmp_path / "f", file="rgb/{}.png")
    for word, ids in zip(FACES, pictures(layer=2), strict=True):
        put(folder / f"mask/{word}.png", np.uint8(ids))
    assert run(folder, file) == 0
    assert "objects named after their ids" in capsys.readouterr().out
    with omniscv.open_source(file) as source:
        image = omniscv.render(SMALL, Pose.from_angles((0, 0, 0)), source, ("object_mask",))
        shown = {source.objects().names()[label - 1] for label in np.unique(image.labels) if label}
    assert shown <= {f"id-{label}" for label in range(1, 30)}
    assert len(shown) > 5
    (tmp_path / "names.json").write_text(json.dumps({"Nothing": 200, "Neither": 201}))
    other = tmp_path / "b.sqlite"
    assert run(folder, other, "--names", tmp_path / "names.json") == 0
    out = capsys.readouterr().out
    for says in ("ids that no object has", "masks: 2 of 2 objects are in none", "labels are 0"):
        assert says in out
    words = ["--size", "64x32", "--modes", "mask", "--out", str(tmp_path / "o")]
    assert cli.run(["render", "--source", str(other), *words]) == 0
    error = capsys.readouterr().err
    assert "ids that no object has: label 0" in error
    assert "labels are 0: no pixel shows an object" in error
    assert cli.run(["doctor", str(other)]) == 1
    assert f"0 of {6 * EDGE**2}" in capsys.readouterr().out


def test_what_is_no_cube_and_what_acts_on_nothing_is_refused(tmp_path, file, capsys):
    (tmp_path / "empty").mkdir()
    Image.new("RGB", (70, 33)).save(tmp_path / "odd.png")
    (written(tmp_path / "five") / "up.png").unlink()
    (tmp_path / "heic").mkdir()
    (tmp_path / "heic/front.heic").touch()
    written(tmp_path / "six")
    written(tmp_path / "m", file="{}.mask.png", change=lambda pixels: pixels[..., 0])
    for name, names in (("none.json", None), ("colour.json", {"Sofa": [300, 0, 0]}), ("a.json", [])):
        (tmp_path / name).write_text(json.dumps(names))
    for given, says, *words in (
        ("empty", "expected six pictures of faces, in colour, depth or masks, got none"),
        ("odd.png", "expected a picture of six faces as in strip, c6x1, c1x6"),
        ("five", "got 5 of lit: back, down, front, left, right"),
        ("heic", "cannot read 'front.heic'"),
        ("six", "depth: expected pictures that it acts on", "--depth", "ray-mm"),
        ("six", "poses: expected pictures that it acts on", "--poses", tmp_path / "a.json"),
        ("m", "none.json: expected names of ids, got", "--names", tmp_path / "none.json"),
        ("m", "colour.json: expected names of ids, got", "--names", tmp_path / "colour.json"),
    ):
        assert run(tmp_path / given, file, *words) == 2
        assert says in capsys.readouterr().err
    assert not file.exists()


def test_faces_in_memory_are_a_source():
    lit, depth = (dict(zip(FACES, pictures(layer=layer), strict=True)) for layer in (0, 1))
    source = omniscv.sources.from_faces(lit, depth=depth, position=AT)
    image = omniscv.render(SMALL, HERE, source, ("lit", "depth"), filter="nearest")
    truth = traced(SCENE, SMALL, HERE)
    assert np.abs(image.lit - 255 * truth.color).mean() < 6
    assert np.median(np.abs(image.depth - truth.distance)) < 0.01
    for wrong, says in (
        ({**lit, "top": lit["up"]}, "expected faces front, right, back, left, up, down"),
        ({**lit, "up": lit["up"][:32]}, "expected six square faces of one size"),
    ):
        with pytest.raises(ArgumentError, match=says):
            omniscv.sources.from_faces(wrong)


def test_hidden_folders_and_thumbnails_are_no_pictures(tmp_path, file, capsys):
    folder = written(tmp_path / "sky")
    for name in ("@eaDir/front.png/SYNOPHOTO_THUMB_M.jpg", ".thumbs/front.png", ".hidden.png"):
        put(folder / name, pictures()[0])
    (folder / "pano.png").mkdir()
    put(folder / "pano.png/notes.txt.png/inner.png", pictures()[0])
    (folder / "pano.png/notes.txt.png/inner.png").unlink()
    (folder / "._front.png").write_bytes(b"of macOS")
    assert run(folder, file, *PLACE) == 0
    assert "3 pictures that are hidden, or thumbnails, are skipped" in capsys.readouterr().out
    judge(file, HERE, ("lit",))


def palette(pixels):
    """Ids as indices of a palette of colours, as VOC's masks."""
    image = Image.fromarray(np.uint8(pixels)).convert("P")
    image.putpalette(np.random.default_rng(0).integers(0, 256, 768, np.uint8).tobytes())
    return image


IDS = {name: 1 + i for i, name in enumerate(sorted(SCENE.objects))}


@pytest.mark.parametrize("form", ["palette", "RGB of grey"])
@pytest.mark.parametrize("kind", ["faces", "panorama"])
def test_masks_with_a_list_by_id_in_other_forms(form, kind, tmp_path, file):
    layers = zip(FACES, pictures(), pictures(layer=2), strict=True)
    if kind == "panorama":
        lit, _, labels = panorama(HERE)
        layers = [("a", lit, labels)]
    for word, lit, ids in layers:
        put(tmp_path / f"f/{word}.png", lit)
        picture = palette(ids) if form == "palette" else Image.fromarray(np.uint8(ids)).convert("RGB")
        picture.save(tmp_path / f"f/{word}_mask.png")
    (tmp_path / "names.json").write_text(json.dumps(IDS))
    assert run(tmp_path / "f", file, *PLACE, "--names", tmp_path / "names.json") == 0
    judge(file, HERE, ("object_mask",))


@pytest.mark.parametrize(
    ("masks", "names", "says"),
    [
        (
            "colours",
            IDS,
            "in grey or a palette, because the objects are listed by id, got colours",
        ),
        ("ids", {"Sofa": [1, 2, 3]}, "expected colours, because the objects are listed by colour, got grey"),
    ],
)
def test_masks_that_a_list_cannot_name_are_refused(masks, names, says, tmp_path, file, capsys):
    folder = written(tmp_path / "f", file="{}_rgb.png")
    for i, (word, ids) in enumerate(zip(FACES, pictures(layer=2), strict=True)):
        colors = np.uint8(np.dstack([ids, 3 * ids + i, 7 * ids]))
        put(folder / f"{word}_mask.png", colors if masks == "colours" else np.uint8(ids))
    (tmp_path / "names.json").write_text(json.dumps(names))
    assert run(folder, file, "--names", tmp_path / "names.json") == 2
    error = capsys.readouterr().err
    assert says in error
    assert "; list the " in error
    assert not file.exists()


def test_six_faces_of_depth_have_the_unit_that_is_said(tmp_path, file):
    """Whole numbers: millimetres, of planar depth."""
    folder = written(tmp_path / "sky")
    views = [View(Pose(AT, face.R_w_c), 90, EDGE, EDGE) for face in LAYOUTS["faces"].arrangement]
    for word, view in zip(WORDS.split(), views, strict=True):
        depth = np.round(1000 * seen(view)[2]).astype(np.uint16)
        put(folder / "depth" / f"{word}.png", depth)
    import_pictures(folder, file, position=AT, depth="planar-mm")
    with omniscv.open_source(file) as source:
        for view in views:
            (capture,) = source.capture([omniscv.sources.Request(view, "depth")])
            np.testing.assert_allclose(capture.pixels, seen(view)[2], atol=6e-4)


def test_a_face_in_a_strip_is_named_by_its_number(tmp_path, file):
    faces = pictures()
    faces[1], faces[4] = faces[4], faces[1]
    put(tmp_path / "strip.png", np.concatenate(faces, axis=1))
    found = import_pictures(tmp_path / "strip.png", file, position=AT)
    named = {line.partition(" shows ")[0] for line in found.lines if "put right" in line}
    assert named == {"face 2", "face 5"}, found.lines
