"""What ``omniscv look`` writes, read without a browser."""

import base64
import json
import shutil
import sys
import zlib
from html.parser import HTMLParser

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from PIL import Image
from support import datasets, looked
from support.command_line import ROOT

import omniscv
from omniscv import cameras, cli, dataset
from omniscv.errors import ArgumentError, RecordingError
from omniscv.viewing import rerun_file
from omniscv.viewing.look import look
from omniscv.viewing.look.directions import describe
from omniscv.viewing.look.layers import box_lines, pack

KINDS = {"f4": np.float32, "u4": np.uint32, "u2": np.uint16, "i2": np.int16, "i1": np.int8, "u1": np.uint8}


class Read(HTMLParser):
    """A page's JSON by the id of its script, and every address in its markup."""

    def __init__(self, path):
        super().__init__()
        self.json = {}
        self.addresses = []
        self._id = None
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.addresses += [attributes[key] for key in ("src", "href", "action") if key in attributes]
        self._id = attributes.get("id") if attributes.get("type") == "application/json" else None

    def handle_data(self, data):
        if self._id:
            self.json[self._id] = json.loads(data)
            self._id = None


def unpacked(packed):
    """The numbers of a packed array, (C, H, W), as its description says."""
    kind = np.dtype(KINDS[packed["type"]])
    planes = np.frombuffer(zlib.decompress(base64.b64decode(packed["data"])), np.uint8)
    steps = np.ascontiguousarray(planes.reshape(kind.itemsize, -1).T).view(f"<u{kind.itemsize}")
    whole = np.cumsum(steps.reshape(packed["shape"]), axis=-1, dtype=f"u{kind.itemsize}")
    return whole.view(kind)


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return looked.images(tmp_path_factory.mktemp("images"))


@given(st.sampled_from(sorted(KINDS)).flatmap(lambda kind: arrays.arrays(KINDS[kind], (3, 5, 2))))
def test_packed_arrays_hold_every_bit(values):
    assert unpacked(pack(values)).tobytes() == np.moveaxis(values, -1, 0).tobytes()


def test_a_page_holds_all_layers_and_no_address(truth, tmp_path):
    page, *others = look(truth.folder, tmp_path / "page.html")
    read = Read(page)
    assert others == []
    assert read.addresses == ["data:,"]
    assert "default-src 'none'" in page.read_text()
    shared = read.json["data"]
    assert [each["key"] for each in shared["frames"]] == sorted(looked.CAMERAS)
    assert [each["name"] for each in shared["layers"]] == ["lit", "depth", "normals", "labels"]
    for i, line in enumerate(shared["frames"]):
        camera = looked.CAMERAS[line["key"]]
        layers = read.json[f"frame-{i}"]["layers"]
        hit = truth.trace(camera, (camera.width // 2, camera.height // 2))
        place = 0, camera.height // 2, camera.width // 2
        assert unpacked(layers["depth"])[place] == np.float32(hit.distance[0])
        assert shared["labels"][str(unpacked(layers["labels"])[place])]["name"] in truth.scene.objects
        lit = (truth.folder / f"{line['key']}.lit.png").read_bytes()
        assert base64.b64decode(layers["lit"]["data"]) == lit


def test_many_frames_lie_beside_the_page_as_programs(truth, tmp_path):
    page, *others = look(truth.folder, tmp_path / "page.html", most_pixels=1000)
    assert [path.name for path in others] == ["00000.js", "00001.js", "00002.js"]
    assert Read(page).json["data"]["folder"] == "page.frames"
    for i, path in enumerate(others):
        call = path.read_text()
        assert call.startswith(f"lookFrame({i},")
        assert set(json.loads(call[len(f"lookFrame({i},") : -2])) == {"layers", "boxes", "layout"}
    # They are replaced together.
    before = [path.read_bytes() for path in others]
    (truth.folder / "panorama.depth.exr").rename(tmp_path / "depth.exr")
    try:
        shutil.copy(truth.folder / "panorama.json", truth.folder / "panorama.depth.exr")
        with pytest.raises(ArgumentError, match=r"panorama\.depth\.exr: expected a picture of depth"):
            look(truth.folder, tmp_path / "page.html", most_pixels=1000)
    finally:
        (tmp_path / "depth.exr").rename(truth.folder / "panorama.depth.exr")
    assert [path.read_bytes() for path in others] == before
    look(truth.folder / "panorama.json", tmp_path / "page.html", most_pixels=1000)
    assert [path.name for path in (tmp_path / "page.frames").iterdir()] == ["00000.js"]
    assert {path.name for path in tmp_path.iterdir()} == {"page.html", "page.frames"}


def test_one_image_is_shown_by_any_of_its_files_or_as_a_bare_picture(truth, tmp_path):
    for name in ("panorama.json", "panorama.lit.png", "panorama.depth.exr"):
        page, *_ = look(truth.folder / name, tmp_path / "page.html")
        assert [each["key"] for each in Read(page).json["data"]["frames"]] == ["panorama"]
    for size, sphere in ((64, 32), "closed"), ((60, 40), None):
        Image.new("RGB", size, (10, 200, 30)).save(tmp_path / "picture.jpg")
        page, *_ = look(tmp_path / "picture.jpg", tmp_path / "page.html")
        shared = Read(page).json["data"]
        assert (shared["cameras"]["picture"]["sphere"], shared["placed"]) == (sphere, False)


def test_a_dataset_shows_its_classes_boxes_layout_and_times(tmp_path):
    folder = datasets.made(tmp_path, more="truth: {boxes: true, boxes3d: true, layout: true}\n")
    page, *_ = look(folder, tmp_path / "page.html")
    read = Read(page)
    shared = read.json["data"]
    keys = [each["key"] for each in shared["frames"]]
    assert [each["time"] for each in shared["frames"]] == [0, 0.5, 1, 0, 0.5, 1]
    assert {"wall", "floor", "chair"} <= {each["name"] for each in shared["classes"].values()}
    assert {"wall", "chair"} <= {each["class"] for each in shared["labels"].values()}
    frame = read.json[f"frame-{keys.index('pano-0')}"]
    assert {"boxes", "boxes3d"} == set(frame["boxes"])
    assert np.allclose(sorted(frame["layout"]["floor"]), [[-3, -2.5], [-3, 2.5], [3, -2.5], [3, 2.5]])


TURNED = {
    "fisheye": cameras.create("fisheye-equidistant", width=128, height=128, fov_deg=185),
    "cube": cameras.create("cube-map", width=48, height=32),
    "ball": looked.CAMERAS["mirror"],
    "cone": cameras.model("noncentral-conical-mirror").example(96),
    "rolling": cameras.model("rolling-shutter").example(48),
}


@pytest.mark.parametrize("name", TURNED)
def test_directions_find_the_pixels_that_see_them(name):
    """Of directions anywhere: within 0.1 px where the image is smooth, a px at borders; and a pixel is
    found where the camera sees, but for a rim of a pixel.

    How far it is off is the lesser of the distance between pixels and of the angle between rays: across a
    seam the pixels are far apart, and around the tip of a cone, where the directions of a whole circle meet
    in one pixel, the rays are.
    """
    camera = TURNED[name]
    described = describe(camera)
    tables = {key: unpacked(described["sphere"][key]) for key in ("nodes", "kinds", "tables")}
    directions = np.random.default_rng(1).normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    found, smooth = looked_up(described["sphere"], tables, directions)
    pixels, sees = camera.project(1e6 * directions)
    both = sees & np.isfinite(found[:, 0])
    assert np.mean(sees == np.isfinite(found[:, 0])) > 0.995
    rays = camera.unproject(np.clip(found[both], 0, (camera.width, camera.height)))
    turned = np.linalg.norm(rays.directions - directions[both], axis=-1) * described["density"]
    off = np.fmin(turned, np.linalg.norm(pixels[both] - found[both], axis=-1))
    for kind, most in ((smooth[both], 0.1), (~smooth[both], 0.95)):
        values = off[rays.valid & kind]
        assert values.max(initial=0) < most


def looked_up(sphere, tables, directions):
    """(N, 2) px of directions, NaN for none, and which were interpolated, as directions.py describes it."""
    count = sphere["cells"]
    finer = sphere["fine"]
    axis = np.abs(directions).argmax(axis=-1)
    rows = np.arange(len(directions))
    largest = directions[rows, axis]
    place = np.stack([directions[rows, (axis + k) % 3] / np.abs(largest) for k in (1, 2)], axis=-1)
    place = (place + 1) / 2 * count
    i, j = np.minimum(place.astype(int), count - 1).T
    face = 2 * axis + (largest < 0)
    kinds = tables["kinds"][0, face * count + j, i].astype(int)
    s, t = (place - np.stack([i, j], axis=-1)).T
    nodes = np.moveaxis(tables["nodes"], 0, -1).astype(float)
    row = face * (count + 1) + j
    top = nodes[row, i] * (1 - s)[:, None] + nodes[row, i + 1] * s[:, None]
    low = nodes[row + 1, i] * (1 - s)[:, None] + nodes[row + 1, i + 1] * s[:, None]
    found = (top * (1 - t)[:, None] + low * t[:, None] - 1) / 1024
    torn = kinds >= 2
    fine = np.moveaxis(tables["tables"], 0, -1).astype(float)
    at = fine[(kinds[torn] - 2) * finer + (t[torn] * finer).astype(int), (s[torn] * finer).astype(int)]
    found[torn] = np.where(at > 0, (at - 1) / 1024, np.nan)
    found[kinds == 0] = np.nan
    return found, kinds == 1


@pytest.mark.parametrize(
    ("make", "wanted"),
    [
        (lambda folder: None, "expected a folder, an image or a recording"),
        (lambda folder: folder.mkdir(), "expected images of 'render' or a dataset"),
        (lambda folder: dataset.Writer(folder).finish(), "expected a dataset with frames"),
        (lambda folder: folder.write_text("text"), "expected a folder of images, a STEM.json"),
        (lambda folder: Image.new("RGB", (4, 4)).save(folder, "GIF"), "expected a picture .png, .jpg, .jpeg"),
        (lambda folder: folder.write_bytes(b"SQLite format 3\0" + bytes(100)), "expected a recording"),
    ],
)
def test_what_cannot_be_shown_is_refused_in_one_line(tmp_path, make, wanted):
    make(tmp_path / "what")
    with pytest.raises((ArgumentError, RecordingError), match=wanted):
        look(tmp_path / "what", tmp_path / "page.html")
    assert not (tmp_path / "page.html").exists()


def test_a_recording_is_composed_at_its_places_but_those_that_are_not_recorded_all_around(tmp_path):
    """The living room was recorded for a non-central camera, too: in depth only, but for one place."""
    shutil.copy(ROOT / "captures" / "living-room.sqlite", tmp_path / "room.sqlite")
    warned = []
    page, *_ = look(tmp_path / "room.sqlite", tmp_path / "page.html", size=(64, 32), warn=warned.append)
    shared = Read(page).json["data"]
    assert shared["title"] == "room.sqlite"
    assert [each["camera"] for each in shared["frames"]] == ["equirectangular"]
    (warning,) = warned
    assert "not recorded in lit all around" in warning


@pytest.mark.parametrize(
    ("name", "text", "wanted"),
    [
        ("panorama.truth.json", '{"boxes": [{"id": 1}]}', "expected truth records"),
        ("panorama.layout.json", '{"edges": 3}', "expected layout records"),
        ("objects.json", '{"1": "Table"}', "expected labels and their objects"),
        ("panorama.json", '{"camera": 1, "pose": 2}', "camera: expected"),
        ("panorama.labels.png", "", "expected 256x128 px, as its camera has, got 128x128"),
    ],
)
def test_damaged_files_are_named(truth, tmp_path, name, text, wanted):
    folder = shutil.copytree(truth.folder, tmp_path / "images")
    (folder / name).write_text(text) if text else shutil.copy(folder / "fisheye.labels.png", folder / name)
    with pytest.raises(ArgumentError, match=f"{name}: {wanted}"):
        look(folder / "panorama.json", tmp_path / "page.html")


def test_the_command_prints_the_page(truth, tmp_path, capsys):
    assert cli.run(["look", str(truth.folder / "panorama.json"), "--out", str(tmp_path / "a.html")]) == 0
    assert capsys.readouterr().out.strip() == str(tmp_path / "a.html")
    assert cli.run(["look", str(truth.folder), "--out", str(tmp_path / "a.txt")]) == 2
    assert "expected a file NAME.html" in capsys.readouterr().err


def test_a_file_for_rerun_needs_its_name_and_its_extra(tmp_path, monkeypatch):
    with pytest.raises(ArgumentError, match=r"expected a file NAME.rrd, got 'room.html'"):
        rerun_file.write([], tmp_path / "room.html")
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(ArgumentError, match=r"pip install 'omniscv\[rerun\]'"):
        rerun_file.write([], tmp_path / "room.rrd")


WIDE = cameras.create("equirectangular", width=256, height=128)


def points(kind, camera, record):
    lines = np.concatenate(box_lines(kind, camera, record))
    return lines[np.isfinite(lines).all(axis=1)]


def test_a_box_over_the_seam_continues_at_the_left():
    u, v = points("boxes", WIDE, {"bbox": [0, 40, 256, 30], "bbox_wrap": [240, 40, 40, 30]}).T
    assert (v.min(), v.max()) == (40, 70)
    assert ((u >= 240) | (u <= 24)).all()
    assert {240, 24} <= set(u)


@pytest.mark.parametrize("name", ["equirectangular", "noncentral-panorama"])
def test_lines_of_a_box_in_space_end_at_its_corners(name):
    camera = cameras.model(name).example(100)
    pose = omniscv.Pose.from_angles((0, 0, 1.5))
    with omniscv.open_source("scene://four-wall") as source:
        boxes = {"Sofa": source.geometry().boxes["Sofa"], "Table": source.geometry().boxes["Table"]}
    seen = 0
    for record in omniscv.truth.boxes3d(boxes, camera, pose, {"Sofa": 1, "Table": 2}):
        lines = points("boxes3d", camera, record)
        pixels, valid = camera.project(pose.to_camera(boxes[record["name"]].corners_w()))
        for pixel in pixels[valid]:
            assert np.abs(lines - pixel).max(axis=1).min() < 1e-6
            seen += 1
    assert seen >= 8
