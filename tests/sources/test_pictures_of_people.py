"""Pictures that people have: what the gate lets in is what other readers see, all else is one line."""

import io
import json
import os
import warnings

import cv2
import numpy as np
import OpenImageIO
import pytest
from PIL import Image

import omniscv
from mock_server import load_scene
from omniscv import cli
from omniscv.chart import traced
from omniscv.errors import ArgumentError, BadReplyError
from omniscv.geometry import Pose
from omniscv.sources import View
from omniscv.sources.base import Capture, Request
from omniscv.sources.pictures import DepthForm, read_picture
from omniscv.sources.recording import sequences

SCENE = load_scene("four-wall")
AT = (0.3, -0.2, 1.45)
FACES = {
    "front": (0, 0),
    "right": (-90, 0),
    "back": (180, 0),
    "left": (90, 0),
    "up": (0, 90),
    "down": (0, -90),
}
DRAW = np.random.default_rng(7)
COLORS = DRAW.integers(0, 256, (12, 24, 3), np.uint8)


def seen(view):
    """Colours, planar depth and labels of a view, traced."""
    pixels = np.stack(np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5), axis=-1)
    fx, fy, cx, cy = view.projection
    rays = np.concatenate([(pixels - (cx, cy)) / (fx, fy), np.ones((*pixels.shape[:2], 1))], axis=-1)
    hits = SCENE.trace(view.pose.position, rays @ view.pose.R_w_c.T)
    planar = hits.distance / np.linalg.norm(rays, axis=-1)
    return np.uint8(255 * hits.color + 0.5), planar.astype(np.float32), hits.label


def six(folder, draw, suffix="png", edge=48):
    """Write six faces that a function draws from a view."""
    folder.mkdir(parents=True)
    for name, (yaw, pitch) in FACES.items():
        pixels = draw(View(Pose.from_angles(AT, yaw, pitch), 90, edge, edge))
        lossless = {"lossless": True, "exact": True} if suffix == "webp" else {}
        Image.fromarray(pixels).save(folder / f"{name}.{suffix}", **lossless)
    return folder


def run(*words):
    return cli.run(["recording", "import", *map(str, words)])


# -- The gate --------------------------------------------------------------------------------------------


def exr(path, channels, **spec):
    """Write float channels by name."""
    pixels = np.stack([*channels.values()], axis=-1).astype(np.float32)
    described = OpenImageIO.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], "float")
    described.channelnames = tuple(channels)
    for key, value in spec.items():
        setattr(described, key, value)
    file = OpenImageIO.ImageOutput.create(str(path))
    assert file.open(str(path), described)
    assert file.write_image(pixels)
    file.close()


def encoded(suffix):
    """Bytes of a valid picture."""
    if suffix in ("npy", "hdr", "png16"):
        pixels = {
            "npy": COLORS,
            "hdr": COLORS.astype(np.float32) / 99,
            "png16": COLORS.astype(np.uint16) * 257,
        }
        if suffix != "npy":
            return cv2.imencode("." + suffix[:3], pixels[suffix])[1].tobytes()
        np.save(buffer := io.BytesIO(), COLORS)
        return buffer.getvalue()
    buffer = io.BytesIO()
    Image.fromarray(COLORS).save(
        buffer, suffix.replace("tga", "TGA"), **({"lossless": True} if suffix == "webp" else {})
    )
    return buffer.getvalue()


def judged(data, suffix):
    """Pixels (H, W, 3) as Pillow, OpenCV or NumPy reads them."""
    if suffix == "npy":
        pixels = np.load(io.BytesIO(data), allow_pickle=False)
        return np.repeat(
            pixels.reshape(*pixels.shape[:2], -1)[..., :3], 1 if pixels.shape[2:] > (1,) else 3, axis=2
        )
    if suffix in ("hdr", "png16"):
        return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)[..., 2::-1]
    with warnings.catch_warnings(action="ignore"), Image.open(io.BytesIO(data)) as image:
        return np.asarray(image.convert("RGB"))


def changed(data, suffix, draw):
    """Bytes with one thing changed: a byte, the length, or the type, shape or order of an array."""
    way = draw.integers(0, 5 if suffix == "npy" else 3)
    at = int(draw.integers(0, len(data)))
    if way == 0:
        return data[:at] + bytes([data[at] ^ (1 << draw.integers(0, 8))]) + data[at + 1 :]
    if way in (1, 2):
        return data[:at] if way == 1 else data[:at] + bytes(draw.integers(0, 256, 3, np.uint8)) + data[at:]
    kind = draw.choice(["?", "i8", "u4", ">u2", ">f8", "c8", "f2", "O", "S3"])
    pixels = np.where(COLORS > 127, COLORS, 9).astype(kind if way == 3 else "u1")
    order = [
        lambda a: a,
        np.asfortranarray,
        lambda a: a.transpose(2, 0, 1),
        lambda a: a[0, 0],
        lambda a: a[..., :2],
    ]
    np.save(buffer := io.BytesIO(), order[draw.integers(0, 5)](pixels))
    return buffer.getvalue()


def check_changed(count, seed, folder):
    draw, wrong, taken = np.random.default_rng(seed), [], 0
    suffixes = ["png", "png16", "jpeg", "webp", "bmp", "tga", "tiff", "hdr", "npy"]
    valid = {suffix: encoded(suffix) for suffix in suffixes}
    for i in range(count):
        suffix = suffixes[i % len(suffixes)]
        data = changed(valid[suffix], suffix, draw)
        file = folder / f"a.{suffix[:3] if suffix == 'png16' else suffix}"
        file.write_bytes(data)
        try:
            pixels = read_picture(file).pixels
        except ArgumentError:  # of one line, as all of these are
            continue
        taken += 1
        try:
            judge = judged(data, suffix)
            same = pixels.shape == judge.shape and np.abs(pixels - judge.astype(np.float64)).max() <= 2
        except Exception as fault:
            judge, same = fault, np.array_equal(pixels, judged(valid[suffix], suffix))
        if not same:
            wrong.append((i, suffix, judge if isinstance(judge, Exception) else np.shape(judge)))
    assert not wrong, wrong[:5]
    assert taken > count / 20


def test_what_is_changed_at_random_is_right_or_one_line(tmp_path):
    check_changed(300, 1, tmp_path)


@pytest.mark.soak
def test_what_is_changed_at_random_20000_times(tmp_path):
    check_changed(20_000, 2, tmp_path)


def saved(name, pixels, **kw):
    """A function that saves a picture in a folder, and returns its name; ``bits``: of a palette."""

    def make(folder):
        image = Image.fromarray(pixels)
        (image.quantize(16) if "bits" in kw else image).save(folder / name, **kw)
        return name

    return make


def array(pixels):
    return lambda folder: (np.save(folder / "a.npy", pixels), "a.npy")[1]


def written(name, **kw):
    return lambda folder: (exr(folder / name, **kw), name)[1]


def progressive(scans, more=0):
    """A progressive JPEG of its first scans, and some bytes of the next one, with an end marker."""

    def make(folder):
        Image.fromarray(COLORS).save(buffer := io.BytesIO(), "JPEG", progressive=True)
        parts = buffer.getvalue().split(b"\xff\xda")
        data = b"\xff\xda".join(parts[: scans + 1 + bool(more)])
        (folder / "p.jpg").write_bytes(data[: len(data) - more or None] + b"\xff\xd9")
        return "p.jpg"

    return make


RGB = dict(zip("RGB", np.ones((3, 8, 16)), strict=True))
BAD = RGB | {"G": np.where(np.eye(8, 16), np.nan, -1)}
TURNED = Image.Exif()
TURNED[0x0112] = 6
MM, DEPTH16 = DepthForm.parse("planar-mm"), np.full((8, 16), 2003, np.uint16)
REFUSED = [
    ("lit", lambda folder: (os.mkfifo(folder / "a.png"), "a.png")[1], "expected a regular file"),
    ("lit", written("z.exr", channels={"Z": np.ones((8, 16))}), "one part with channels R, G, B, got 0"),
    ("lit", written("w.exr", channels=RGB, full_width=32), "all of the display window"),
    ("lit", written("n.exr", channels=BAD), "got 128 of 384 other values; --clip"),
    ("lit", array(np.full((4, 4, 3), 1e300)), "got 48 of 48 other values"),
    ("lit", saved("e.jpg", COLORS, exif=TURNED), "an orientation in its EXIF"),
    ("lit", lambda folder: (Image.new("CMYK", (8, 8)).save(folder / "c.jpg"), "c.jpg")[1], "got CMYK"),
    (
        "lit",
        saved("a.webp", COLORS, save_all=True, append_images=[Image.new("RGB", (24, 12))]),
        "several frames",
    ),
    ("lit", progressive(2), "a progressive JPEG without its last scans"),
    ("lit", progressive(2, 40), "without its last scans|premature end"),
    ("lit", array(np.full((4, 4, 3), 70000, np.uint32)), "of 0 to 255, got uint32 of 70000"),
    ("lit", array(np.zeros(5)), "expected NPY of numbers"),
    ("lit", array(np.zeros((0, 4, 3))), "expected 1 to 134217728 pixels, got 4 x 0"),
    ("lit", array(np.zeros((4, 4, 3), bool)), "got bool of shape"),
    ("object_mask", saved("m.jpg", COLORS), "without loss, as PNG, got lossy jpeg"),
    ("object_mask", saved("m.webp", COLORS), "got lossy webp"),
    (
        "object_mask",
        lambda folder: (Image.new("1", (8, 8)).save(folder / "m.png"), "m.png")[1],
        "got 1, which",
    ),
    ("object_mask", array(np.ones((4, 4), np.float32)), "whole numbers of 0 to 65535, got float32"),
    ("depth", saved("d.png", DEPTH16), "the unit of whole numbers, such as --depth planar-mm"),
    ("depth", saved("d.png", COLORS), "got uint8 colours, which are no metres"),
    ("depth", array(np.full((4, 4), 1j)), "expected NPY of numbers, got the header"),
    ("depth", array(np.full((4, 4), -2.0)), "such as -2 m; if that is no surface, --missing -2"),
    ("normals", saved("n.png", COLORS), "normals, whose frame is not known"),
]


@pytest.mark.parametrize(("kind", "make", "says"), REFUSED, ids=[says for *_, says in REFUSED])
def test_what_cannot_be_right_is_refused(kind, make, says, tmp_path):
    with pytest.raises(ArgumentError, match=says):
        read_picture(tmp_path / make(tmp_path), kind)


RGBA = np.dstack([COLORS, np.zeros((12, 24), np.uint8)])
GREY = np.repeat(COLORS[..., :1], 3, axis=-1)
FAR = [0, 2, np.nan, np.inf, -np.inf, 65504, 1e10]  # Habitat, ROS, half floats, Blender
FULL = np.where(np.arange(16) == 3, 65535, DEPTH16).astype(np.uint16)
LAYERS = {f"View.Combined.{c}": plane for c, plane in RGB.items()} | {"View.Depth.Z": np.full((8, 16), 3.0)}
TAKEN = [
    ("lit", saved("a.png", RGBA), None, COLORS),
    ("lit", saved("a.tga", RGBA), None, COLORS),
    ("lit", saved("a.tif", RGBA), None, COLORS),
    ("lit", saved("a.webp", RGBA, lossless=True, exact=True), None, COLORS),
    ("lit", saved("a.bmp", COLORS), None, COLORS),
    ("lit", saved("a.png", COLORS[..., 0]), None, GREY),
    ("lit", saved("p.png", GREY, bits=4), None, None),
    ("lit", saved("a.png", DEPTH16), None, np.full((8, 16, 3), 2003)),
    ("lit", array(np.asfortranarray(COLORS.astype(np.int64))), None, COLORS),
    ("lit", written("m.exr", channels=LAYERS), None, np.ones((8, 16, 3))),
    ("depth", written("m.exr", channels=LAYERS), None, np.full((8, 16), 3.0)),
    ("depth", saved("d.png", DEPTH16), MM, np.full((8, 16), 2003 / np.float32(1000))),
    ("depth", saved("d.png", DEPTH16), DepthForm.parse("ray-1/512", (2003,)), np.full((8, 16), np.inf)),
    ("depth", array(np.array([FAR, FAR[::-1]])), None, np.where(np.array([FAR, FAR[::-1]]) == 2, 2, np.inf)),
    ("depth", array(np.array([FAR[:6]], "f2")), None, np.where(np.array([FAR[:6]]) == 2, 2, np.inf)),
    ("depth", array(np.full((2, 2), 70000.0)), MM, np.full((2, 2), 70)),
    ("depth", saved("d.png", FULL), MM, np.where(FULL == 65535, np.inf, np.float32(2.003))),
    ("depth", saved("d.png", FULL), DepthForm.parse("planar-mm", (0,)), FULL / np.float32(1000)),
    ("object_mask", saved("m.png", RGBA), None, COLORS),
    ("object_mask", saved("m.png", DEPTH16), None, DEPTH16),
    ("object_mask", array(DEPTH16.astype(np.uint32)), None, DEPTH16),
]


@pytest.mark.parametrize(("kind", "make", "form", "expected"), TAKEN)
def test_what_is_right_in_another_form_is_taken(kind, make, form, expected, tmp_path):
    """Alpha of 0, palettes, grey, 16 bits, layers, whole numbers of other types, columns first."""
    file = tmp_path / make(tmp_path)
    expected = judged(file.read_bytes(), "png") if expected is None else expected
    np.testing.assert_array_equal(read_picture(file, kind, form).pixels, np.asarray(expected, np.float32))


def test_negative_light_is_clipped_when_asked(tmp_path, capsys):
    exr(tmp_path / "n.exr", BAD)
    assert run(tmp_path / "n.exr", tmp_path / "a.sqlite", "--clip") == 0
    assert "128 negative or NaN values taken as 0" in capsys.readouterr().out
    picture = read_picture(tmp_path / "n.exr", clip=True)
    assert picture.clipped == 128
    np.testing.assert_array_equal(picture.pixels[0, 0], [1, 0, 1])


@pytest.mark.parametrize(
    ("mode", "pixels"),
    [
        ("lit", np.zeros((4, 4, 4), np.uint8)),
        ("object_mask", np.zeros((4, 4), np.int64)),
        ("object_mask", np.zeros((4, 4, 3), np.float32)),
        ("depth", np.ones((4, 4), np.uint16)),
    ],
)
def test_a_recorder_refuses_other_forms_before_it_writes(mode, pixels, tmp_path):
    view = View(Pose.from_angles(AT), 90, 4, 4)
    payload = {"payload": b"x", "encoding": "npy"}  # whoever says that it decodes
    with (
        omniscv.open_source("scene://four-wall") as scene,
        omniscv.record(scene, tmp_path / "a.sqlite") as good,
    ):
        list(good.capture([Request(view, "lit")]))
        for extra in ({}, payload):
            with pytest.raises(BadReplyError, match=f"expected {mode} of"):
                good._store.add(Capture(Request(view, mode), view, pixels, **extra))
    assert cli.run(["recording", "check", str(tmp_path / "a.sqlite")]) == 0


# -- Six faces -------------------------------------------------------------------------------------------


def render(path, *words):
    return cli.run(["render", "--source", str(path), "--size", "64x32", *words])


def test_alpha_exchanged_faces_and_mirrors(tmp_path, capsys):
    """Faces of an engine, alpha 0: left and right exchanged, or all of them mirrored: both give a cube."""

    def transparent(view):
        lit = seen(view)[0]
        return np.dstack([lit, np.zeros_like(lit[..., :1])])

    folder = six(tmp_path / "rgba", transparent)
    assert run(folder, tmp_path / "a.sqlite") == 0
    assert float(capsys.readouterr().out.split("edges ")[1].split()[0]) > 0.3  # black faces: 0.00
    (folder / "left.png").rename(folder / "x.png")
    (folder / "right.png").rename(folder / "left.png")
    (folder / "x.png").rename(folder / "right.png")
    assert run(folder, tmp_path / "b.sqlite", "--position", "0.3,-0.2,1.45") == 0
    out = capsys.readouterr().out
    assert "or all pictures are mirrored" in out.replace("and so it is if all", "or all")
    assert "right shows left, not right: put right" in out
    mirrored = six(tmp_path / "mirrored", lambda view: seen(view)[0][:, ::-1])
    assert run(mirrored, tmp_path / "c.sqlite", "--mirrored", "--position", "0.3,-0.2,1.45") == 0
    assert "next best" in capsys.readouterr().out
    camera = omniscv.cameras.create("equirectangular", 64, 32)
    truth = 255 * traced(SCENE, camera, Pose.from_angles(AT)).color
    for name in "bc":
        with omniscv.open_source(tmp_path / f"{name}.sqlite") as source:
            image = omniscv.render(camera, Pose.from_angles(AT), source, ("lit",), filter="nearest")
        assert np.abs(image.lit - truth)[2:-2].mean() < 8  # 50 in a mirrored world


@pytest.mark.parametrize("suffix", ["bmp", "tga", "webp"])
def test_other_forms_of_pictures_and_a_place_that_needs_no_position(suffix, tmp_path, capsys):
    folder = six(tmp_path / "faces", lambda view: seen(view)[0], suffix)
    assert run(folder, tmp_path / "a.sqlite", "--position", "0.3,-0.2,1.45") == 0
    assert render(tmp_path / "a.sqlite", "--out", str(tmp_path / "out")) == 0
    assert json.loads((tmp_path / "out" / "equirectangular.json").read_text())["pose"]["position"] == list(AT)


def test_masks_without_a_list_and_colours_of_no_object(tmp_path, capsys):
    def ids(view):
        return np.uint8(seen(view)[2])

    six(tmp_path / "f" / "mask", ids)
    six(tmp_path / "f" / "rgb", lambda view: seen(view)[0])
    assert run(tmp_path / "f", tmp_path / "a.sqlite") == 0
    assert "objects named after their ids" in capsys.readouterr().out
    with omniscv.open_source(tmp_path / "a.sqlite") as source:
        image = omniscv.render(SMALL, Pose.from_angles((0, 0, 0)), source, ("object_mask",))
        shown = {source.objects().names()[label - 1] for label in np.unique(image.labels) if label}
    assert shown <= {f"id-{label}" for label in range(1, 30)}
    assert len(shown) > 5
    (tmp_path / "names.json").write_text(json.dumps({"Nothing": 200, "Neither": 201}))
    assert run(tmp_path / "f", tmp_path / "b.sqlite", "--names", tmp_path / "names.json") == 0
    out = capsys.readouterr().out
    assert "ids that no object has" in out
    assert "masks: 2 of 2 objects are in none" in out
    assert "labels are 0" in out
    assert render(tmp_path / "b.sqlite", "--modes", "mask", "--out", str(tmp_path / "o")) == 0
    error = capsys.readouterr().err
    assert "ids that no object has: label 0" in error
    assert "labels are 0: no pixel shows an object" in error
    assert cli.run(["doctor", str(tmp_path / "b.sqlite")]) == 1
    assert "0 of 13824" in capsys.readouterr().out


def test_an_option_that_acts_on_nothing_is_refused(tmp_path, capsys):
    six(tmp_path / "f", lambda view: seen(view)[0])
    (tmp_path / "a.json").write_text("[]")
    for words in (
        ["--depth", "ray-mm"],
        ["--names", tmp_path / "a.json"],
        ["--poses", tmp_path / "a.json"],
        ["--clip"],
    ):
        assert run(tmp_path / "f", tmp_path / "a.sqlite", *words) == 2
        assert f"{words[0][2:]}: expected pictures that it acts on" in capsys.readouterr().err
    (tmp_path / "heic").mkdir()
    (tmp_path / "heic" / "front.heic").touch()
    assert run(tmp_path / "heic", tmp_path / "a.sqlite") == 2
    assert "cannot read 'front.heic'" in capsys.readouterr().err
    six(tmp_path / "m", lambda view: np.full((view.height, view.width, 3), 9, np.uint8), "mask.png")
    for names in (None, {"Sofa": [300, 0, 0]}):
        (tmp_path / "a.json").write_text(json.dumps(names))
        assert run(tmp_path / "m", tmp_path / "a.sqlite", "--names", tmp_path / "a.json") == 2
        assert "a.json: expected names of ids, got" in capsys.readouterr().err
    assert not (tmp_path / "a.sqlite").exists()


# -- Panoramas and frames with poses ---------------------------------------------------------------------

WIDE = omniscv.cameras.create("equirectangular", 512, 256)
SMALL = omniscv.cameras.create("equirectangular", 96, 48)


def panorama(pose):
    """Colours, distances in 1/512 m (65535: none), labels as base 256 in RGB."""
    hits = traced(SCENE, WIDE, pose)
    depth = np.where(np.isfinite(hits.distance), np.round(hits.distance * 512), 65535)
    ids = np.zeros((*hits.label.shape, 3), np.uint8)
    ids[..., 1:] = np.stack([hits.label >> 8, hits.label & 255], axis=-1)
    return np.uint8(255 * hits.color + 0.5), depth.astype(np.uint16), ids


def judge(path, pose, modes, least=0.97):
    """Compare images of a recording with the traced truth; return the image."""
    with omniscv.open_source(path) as source:
        image = omniscv.render(SMALL, pose, source, modes, filter="nearest")
        names = source.objects().names()
    truth = traced(SCENE, SMALL, pose)
    if "lit" in modes:
        assert np.abs(image.lit - 255 * truth.color).mean() < 6
    if "depth" in modes:
        off, bound = np.abs(image.depth - truth.distance), image.depth_error
        assert np.isfinite(bound).mean() > 0.6
        assert (off <= bound)[np.isfinite(bound)].mean() > 0.995  # the truth of 1 in 200 lies beside an edge
    if "object_mask" in modes:
        objects = sorted(SCENE.objects)
        label = np.array([0, *(1 + objects.index(name) if name in objects else 0 for name in names)])
        assert (label[image.labels] == truth.label).mean() > least
    return image


def test_panoramas_with_truth_at_many_places(tmp_path, capsys):
    folder, poses = tmp_path / "panos", [Pose.from_angles(AT, yaw_deg=30), Pose.from_angles((-0.4, 0.5, 1.2))]
    folder.mkdir()
    for name, pose in zip(("a", "b"), poses, strict=True):
        lit, depth, ids = panorama(pose)
        Image.fromarray(lit).save(folder / f"{name}_rgb.png")
        Image.fromarray(depth).save(folder / f"{name}_depth.png")
        Image.fromarray(ids[..., 2]).save(folder / f"{name}_semantic.png")
    (tmp_path / "poses.csv").write_text("name,x,y,z,yaw\na_rgb.png,0.3,-0.2,1.45,30\nb,-0.4,0.5,1.2,0\n")
    (tmp_path / "names.json").write_text(json.dumps(["nothing", *sorted(SCENE.objects)]))
    words = ["--depth", "ray-1/512", "--missing", "65535", "--names", tmp_path / "names.json"]
    assert run(folder, tmp_path / "a.sqlite", *words) == 2
    assert "expected --poses FILE, or panoramas of one place, got 2 places" in capsys.readouterr().err
    assert run(folder, tmp_path / "a.sqlite", *words, "--poses", tmp_path / "poses.csv") == 0
    assert "layout latlong: 2 places, 2 of lit, 2 of depth, 2 of object_mask" in capsys.readouterr().out
    for pose in poses:
        judge(tmp_path / "a.sqlite", pose, ("lit", "depth"))
        judge(tmp_path / "a.sqlite", pose, ("object_mask",))
    with omniscv.open_source(tmp_path / "a.sqlite") as source:
        bound = omniscv.render(SMALL, poses[0], source, ("depth",)).depth_error
    assert np.median(bound) < 3 / 512  # steps of whole numbers; half a pixel's change of depth is 8 mm
    assert run(folder, tmp_path / "b.sqlite", "--depth", "planar-mm", "--poses", tmp_path / "poses.csv") == 2
    assert "which have no optical axis, got planar" in capsys.readouterr().err


def structured3d(folder, pose):
    lit, _, ids = panorama(pose)
    distance = traced(SCENE, WIDE, pose).distance
    full = folder / "2D_rendering/485/panorama/full"
    full.mkdir(parents=True)
    Image.fromarray(lit).save(full / "rgb_rawlight.png")
    Image.fromarray(np.uint16(np.round(distance * 1000))).save(full / "depth.png")
    Image.fromarray(np.uint16(ids[..., 2])).save(full / "instance.png")
    Image.fromarray(ids[..., 2]).save(full / "semantic.png")
    (full.parent / "camera_xyz.txt").write_text(" ".join(str(1000 * v) for v in pose.position))


NAME = "camera_0_office_1_frame_equirectangular_domain"


def two_d_three_ds(folder, pose):
    lit, depth, ids = panorama(pose)
    for kind, pixels in (("rgb", lit), ("depth", depth), ("semantic", ids)):
        (folder / "pano" / kind).mkdir(parents=True)
        Image.fromarray(pixels).save(folder / f"pano/{kind}/{NAME}_{kind}.png")
    (folder / "pano/pose").mkdir()
    file = folder / "pano/pose/camera_0_office_1_frame_equirectangular_domain_pose.json"
    R_c_w = pose.R_w_c.T
    matrix = np.column_stack([R_c_w, -R_c_w @ pose.position]).tolist()
    file.write_text(json.dumps({"camera_location": pose.position.tolist(), "camera_rt_matrix": matrix}))
    (folder.parent / "assets").mkdir()
    labels = json.dumps(["<UNK>", *sorted(SCENE.objects)])
    (folder.parent / "assets" / "semantic_labels.json").write_text(labels)


@pytest.mark.parametrize(("write", "name"), [(structured3d, "structured3d"), (two_d_three_ds, "2d3ds")])
def test_presets_of_panoramas(write, name, tmp_path, capsys):
    angles = {"yaw_deg": -90} if write is structured3d else {"yaw_deg": 40, "pitch_deg": 5, "roll_deg": -3}
    pose = Pose.from_angles(AT, **angles)
    write(tmp_path / "area", pose)
    assert run(tmp_path / "area", tmp_path / "a.sqlite") == 0
    out = capsys.readouterr().out
    assert f"layout {name}: 1 place" in out
    assert ("1 semantic.png are not taken" in out) == (write is structured3d)
    assert "heading" not in out
    judge(tmp_path / "a.sqlite", pose, ("lit", "depth"))
    if write is two_d_three_ds:
        judge(tmp_path / "a.sqlite", pose, ("object_mask",))
        file = next((tmp_path / "area/pano/pose").iterdir())
        said = json.loads(file.read_text())
        file.write_text(json.dumps(said | {"camera_location": [1, 2, 3]}))
        assert run(tmp_path / "area", tmp_path / "b.sqlite") == 2
        assert "expected a camera_rt_matrix that has its camera at camera_location" in capsys.readouterr().err
        file.write_text(json.dumps({"camera_location": said["camera_location"]}))
        assert run(tmp_path / "area", tmp_path / "c.sqlite") == 0
        assert "the heading of panoramas without camera_rt_matrix is not known" in capsys.readouterr().out


def replica(folder, views):
    K = {"w": 64, "h": 64, "fx": 32.0, "fy": 32.0, "cx": 31.5, "cy": 31.5, "scale": 6553.5}
    (folder.parent / "cam_params.json").write_text(json.dumps({"camera": K}))
    for i, view in enumerate(views):
        put(folder / f"results/frame{i:06d}.png", seen(view)[0])
        put(folder / f"results/depth{i:06d}.png", np.uint16(np.round(6553.5 * seen(view)[1])))
    matrices = [np.vstack([np.column_stack([v.pose.R_w_c, v.pose.position]), [0, 0, 0, 1]]) for v in views]
    np.savetxt(folder / "traj.txt", np.reshape(matrices, (-1, 16)))


def scannet(folder, views):
    (folder / "intrinsic").mkdir(parents=True)
    (folder / "pose").mkdir()
    K = np.eye(4)
    K[:2, :3] = [[32, 0, 31.5], [0, 32, 31.5]]
    np.savetxt(folder / "intrinsic/intrinsic_color.txt", K)
    for i, view in enumerate(views):
        put(folder / f"color/{i}.png", seen(view)[0])
        put(folder / f"depth/{i}.png", np.uint16(np.round(1000 * seen(view)[1][1::2, 1::2])))
        matrix = np.vstack([np.column_stack([view.pose.R_w_c, view.pose.position]), [0, 0, 0, 1]])
        np.savetxt(folder / f"pose/{i}.txt", matrix)
    np.savetxt(folder / "pose/0.txt", np.full((4, 4), -np.inf))


def kitti(folder, views):
    """Poses of camera 0; camera 2 is 6 cm to its right."""
    K, right = np.array([[32, 0, 31.5], [0, 32, 31.5], [0, 0, 1]]), np.array([0.06, 0, 0])
    for i, view in enumerate(views):
        put(folder / f"image_2/{i:06d}.png", seen(view)[0])
    rows = [np.column_stack([v.pose.R_w_c, v.pose.position - v.pose.R_w_c @ right]).ravel() for v in views]
    np.savetxt(folder / "poses.txt", rows)
    P0, P2 = np.column_stack([K, np.zeros(3)]), np.column_stack([K, -K @ right])
    lines = [f"{name}: " + " ".join(map(str, P.ravel())) for name, P in (("P0", P0), ("P2", P2))]
    (folder / "calib.txt").write_text("\n".join(lines) + "\n")


def icl_nuim(folder, views):
    """POV-Ray's left-handed axes: x right, y up, z ahead."""
    W, C, lines = np.array([[0, 0, 1], [-1, 0, 0], [0, 1, 0]]), np.diag([1, -1, 1]), []
    for i, view in enumerate(views):
        put(folder / f"rgb/{i}.png", seen(view)[0])
        put(folder / f"depth/{i}.png", np.uint16(np.round(5000 * seen(view)[1])))
        own = Pose(W.T @ view.pose.position, W.T @ view.pose.R_w_c @ C)
        lines.append(f"{i} " + " ".join(map(str, [*own.position, *own.quaternion()])))
    (folder / "livingRoom0.gt.freiburg").write_text("\n".join(lines))


def put(path, pixels):
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(path)


@pytest.mark.parametrize("write", [replica, scannet, kitti, icl_nuim])
def test_posed_pictures_of_published_datasets(write, tmp_path, capsys):
    poses = [Pose.from_angles(AT, yaw, 10, 5) for yaw in (0, 30)] + [Pose.from_angles((-0.4, 0.5, 1.2))]
    views = [View(pose, 90, 64, 64) for pose in poses]
    if write is icl_nuim:
        fov_deg = 2 * np.degrees(np.arctan(320 / 481.2))
        lens = omniscv.sources.base.Lens(480 / 481.2, 0, 0)
        views = [View(pose, fov_deg, 640, 480, lens) for pose in poses[1:]]
    write(tmp_path / "scene", views)
    assert run(tmp_path / "scene", tmp_path / "a.sqlite") == 0
    assert f"layout {write.__name__.replace('_', '-')}: 2 places" in capsys.readouterr().out
    if write is replica:
        (tmp_path / "cam_params.json").write_text('{"camera": {"scale": 1000}}')
        assert run(tmp_path / "scene", tmp_path / "b.sqlite") == 2
        assert "scale: expected 6553.5 of a metre, got 1000" in capsys.readouterr().err
    views = views[1:] if write is scannet else views
    with omniscv.open_source(tmp_path / "a.sqlite") as source:
        recorded = source.recorded_views()
        for view in views:
            (same,) = (
                v for v in recorded if v.width == view.width and np.allclose(v.pose.R_w_c, view.pose.R_w_c)
            )
            np.testing.assert_allclose(same.pose.position, view.pose.position, atol=1e-6)
            np.testing.assert_allclose(same.projection, view.projection, atol=1e-6)
            (lit,) = source.capture([Request(same, "lit")])
            np.testing.assert_array_equal(lit.pixels, seen(view)[0])
            if write in (replica, icl_nuim):
                (depth,) = source.capture([Request(same, "depth")])
                assert np.abs(depth.pixels - seen(view)[1]).max() < 2e-4


MINE = """
pictures: pinhole
place: 'color/(?P<i>\\d+)\\.png'
lit: 'color/{i}.png'
depth: {file: 'z/{i}.png', unit: 1/4000}
poses: {file: 'pose/{i}.txt', axes: opengl, inverse: true}
intrinsics: {fx: 32, fy: 32, cx: 31.5, cy: 31.5, centers: 0}
"""


def test_a_layout_of_the_user(tmp_path, capsys, monkeypatch):
    """Six pinhole frames, OpenGL's axes, world to camera, centres at whole numbers; a pose of infinity."""
    folder = tmp_path / "mine"
    for i, (yaw, pitch) in enumerate([*FACES.values(), (0, 0)]):
        view = View(Pose.from_angles(AT, yaw, pitch), 90, 64, 64)
        lit, planar, _ = seen(view)
        R_c_w = (view.pose.R_w_c @ np.diag([1, -1, -1])).T
        matrix = np.vstack([np.column_stack([R_c_w, -R_c_w @ AT]), [0, 0, 0, 1]])
        for kind in ("color", "z", "pose"):
            (folder / kind).mkdir(parents=True, exist_ok=True)
        Image.fromarray(lit).save(folder / f"color/{i}.png")
        Image.fromarray(np.uint16(np.round(planar * 4000))).save(folder / f"z/{i}.png")
        np.savetxt(folder / f"pose/{i}.txt", matrix if i < 6 else np.full((4, 4), -np.inf))
    (tmp_path / "mine.yaml").write_text(MINE)
    assert run(folder, tmp_path / "a.sqlite", "--layout", tmp_path / "mine.yaml") == 0
    out = capsys.readouterr().out
    assert "layout mine: 1 place, 6 of lit, 6 of depth" in out
    assert "1 frames left out: their poses are not finite" in out
    judge(tmp_path / "a.sqlite", Pose.from_angles(AT), ("lit", "depth"))
    monkeypatch.setattr(sequences, "_MOST_S", 1.0)
    (folder / ("a" * 60)).touch()
    for wrong, says in (
        (MINE.replace("z/{i}", "../z/{i}"), "expected a file in the folder, got '../z/0.png'"),
        (MINE.replace("z/{i}", "zz/{i}"), "depth: expected files zz/{i}.png, got none"),
        (MINE + "colour: x", "unknown key 'colour'"),
        (MINE.replace("(?P<i>", "(?P<i"), "expected a folder of layout mine, got error"),
        (MINE.replace("'color/(?P", "'(.+)+!color/(?P"), "place: expected a pattern that is matched with"),
    ):
        (tmp_path / "mine.yaml").write_text(wrong)
        assert run(folder, tmp_path / "b.sqlite", "--layout", tmp_path / "mine.yaml") == 2
        assert says in capsys.readouterr().err


def test_an_import_that_finds_nothing_says_what_takes_the_pictures(tmp_path, capsys):
    folder, poses = tmp_path / "mine", [Pose.from_angles(AT, yaw) for yaw in (0, 30)]
    for i, pose in enumerate(poses):
        put(folder / f"color/{i:04d}.png", seen(View(pose, 90, 64, 64))[0])
    assert run(folder, tmp_path / "a.sqlite") == 2
    assert "got 2 of lit: 0000, 0001; no poses; if they are posed, --poses" in capsys.readouterr().err
    rows = [" ".join(map(str, [*AT, *pose.quaternion()])) for pose in poses]
    (folder / "trajectory.txt").write_text("\n".join(rows))
    assert run(folder, tmp_path / "a.sqlite") == 2
    (line,) = capsys.readouterr().err.splitlines()
    layout = line.partition("takes them, with ")[2].removesuffix(" in it")
    for word, number in {"FX": "32", "FY": "32", "CX": "32", "CY": "32"}.items():
        layout = layout.replace(word, number)
    (tmp_path / "my.yaml").write_text(layout)
    assert run(folder, tmp_path / "a.sqlite", "--layout", tmp_path / "my.yaml") == 0
    with omniscv.open_source(tmp_path / "a.sqlite") as source:
        for view, pose in zip(source.recorded_views(), poses, strict=True):
            np.testing.assert_allclose(view.pose.R_w_c, pose.R_w_c, atol=1e-9)
            assert view.fov_deg == pytest.approx(90)


def made(tmp_path, camera):
    """Our own dataset of two frames as nerfstudio's folder, and their poses."""
    poses = [{"position": AT, "yaw_deg": 20.0, "pitch_deg": 10.0}, {"position": [-0.4, 0.5, 1.2]}]
    job = {
        "source": "scene://four-wall",
        "cameras": {"cam": camera},
        "poses": poses,
        "modes": ["lit", "depth"],
    }
    (tmp_path / "job.yaml").write_text(json.dumps({**job, "out": str(tmp_path / "set"), "face_size": 128}))
    assert cli.run(["dataset", "make", str(tmp_path / "job.yaml")]) == 0
    words = [
        "dataset",
        "export",
        str(tmp_path / "set"),
        "--to",
        "nerfstudio",
        "--out",
        str(tmp_path / "nerf"),
    ]
    assert cli.run(words) == 0
    return [Pose.from_angles(p["position"], p.get("yaw_deg", 0), p.get("pitch_deg", 0)) for p in poses]


@pytest.mark.parametrize("model", ["pinhole", "equirectangular"])
def test_our_export_for_nerfstudio_comes_in_again(model, tmp_path, capsys):
    camera = {"model": model, "width": 96, "height": 64 if model == "pinhole" else 48}
    camera |= {"fov_deg": 80} if model == "pinhole" else {}
    poses = made(tmp_path, camera)
    assert run(tmp_path / "nerf", tmp_path / "a.sqlite") == 0
    assert "layout nerfstudio: 2 places, 2 of lit, 2 of depth" in capsys.readouterr().out
    with omniscv.open_source(tmp_path / "a.sqlite") as source:
        views = source.recorded_views()
        pictures = sorted((tmp_path / "nerf/images").iterdir())
        for i, pose in enumerate(poses):
            of_pose = [view for view in views if np.allclose(view.pose.position, pose.position, atol=1e-6)]
            if model == "pinhole":
                (view,) = of_pose
                np.testing.assert_allclose(view.pose.R_w_c, pose.R_w_c, atol=1e-6)
                assert abs(view.fov_deg - 80) < 1e-9
                (lit,) = source.capture([Request(view, "lit")])
                np.testing.assert_array_equal(lit.pixels, np.asarray(Image.open(pictures[i])))
            else:
                camera_ = omniscv.cameras.from_dict(camera)
                image = omniscv.render(camera_, pose, source, ("lit", "depth"), filter="nearest")
                before = np.asarray(Image.open(pictures[i]), float)
                assert np.abs(image.lit - before)[4:-4].mean() < 5  # resampled to faces and back
                off = np.abs(image.depth - traced(SCENE, camera_, pose).distance)
                bounded = np.isfinite(image.depth_error)
                assert (off <= image.depth_error)[bounded].mean() > 0.99


def test_a_bent_picture_of_nerfstudio_is_made_straight(tmp_path, capsys):
    """A lens with distortion, traced through its own rays; judged by tracing what came in."""
    bent = {"k1": -0.2, "k2": 0.05, "p1": 0.002, "p2": -0.001}
    lens = {"fx": 90.0, "fy": 88.0, "cx": 66.0, "cy": 47.0}
    camera = omniscv.cameras.create("pinhole", 128, 96, **lens, distortion=[*bent.values()])
    pose = Pose.from_angles(AT, yaw_deg=35)
    (tmp_path / "n").mkdir()
    Image.fromarray(np.uint8(255 * traced(SCENE, camera, pose).color + 0.5)).save(tmp_path / "n/a.png")
    matrix = np.eye(4)
    matrix[:3] = np.column_stack([pose.R_w_c @ np.diag([1, -1, -1]), pose.position])
    frame = {"file_path": "./a", "transform_matrix": matrix.tolist()}
    given = {"fl_x": 90, "fl_y": 88, "cx": 66, "cy": 47, "w": 128, "h": 96, **bent, "frames": [frame]}
    (tmp_path / "n/transforms.json").write_text(json.dumps(given))
    assert run(tmp_path / "n", tmp_path / "a.sqlite") == 0
    assert "1 frames resampled to flat pictures" in capsys.readouterr().out
    with omniscv.open_source(tmp_path / "a.sqlite") as source:
        (view,) = source.recorded_views()
        (lit,) = source.capture([Request(view, "lit")])
    assert lit.pixels.min(axis=(0, 1)).max() > 0  # no black border
    assert np.abs(lit.pixels - seen(view)[0].astype(float)).mean() < 3
    frame["transform_matrix"] = (2 * matrix).tolist()
    (tmp_path / "n/transforms.json").write_text(json.dumps(given))
    assert run(tmp_path / "n", tmp_path / "b.sqlite") == 2
    assert "frames[0]: expected a matrix with the last row 0 0 0 1" in capsys.readouterr().err


def test_a_sequence_of_the_tum_benchmark(tmp_path, capsys):
    """Stamps that never coincide, a picture without a pose, Kinect's lens with centres at whole numbers."""
    folder = tmp_path / "rgbd_dataset_freiburg3_office"
    fov_deg = 2 * np.degrees(np.arctan(320 / 535.4))
    lens = omniscv.sources.base.Lens(539.2 / 535.4, 320.6 / 640 - 0.5, 248.1 / 480 - 0.5)
    poses = [Pose.from_angles(AT, yaw_deg=yaw) for yaw in (0, 40)]
    rgb, depth, truth = [], [], []
    for i, pose in enumerate(poses):
        lit, planar, _ = seen(View(pose, fov_deg, 160, 120, lens))
        for kind, pixels in (("rgb", lit), ("depth", np.uint16(np.round(planar * 5000)))):
            (folder / kind).mkdir(parents=True, exist_ok=True)
            Image.fromarray(pixels).save(folder / f"{kind}/{i}.png")
        rgb.append(f"{i}.000 rgb/{i}.png")
        depth.append(f"{i}.013 depth/{i}.png")
        truth.append(f"{i}.007 " + " ".join(map(str, [*AT, *pose.quaternion()])))
    for name, lines in (("rgb", [*rgb, "9 rgb/0.png"]), ("depth", depth), ("groundtruth", truth)):
        (folder / f"{name}.txt").write_text("# comment\n" + "\n".join(lines) + "\n")
    assert run(folder, tmp_path / "a.sqlite") == 0
    out = capsys.readouterr().out
    assert "layout tum: 1 place, 2 of lit, 2 of depth" in out
    assert "1 pictures left out: no pose within 0.02 s" in out
    with omniscv.open_source(tmp_path / "a.sqlite") as source:
        for view, pose in zip(source.recorded_views(), poses, strict=True):
            np.testing.assert_allclose(view.pose.R_w_c, pose.R_w_c, atol=1e-12)
            np.testing.assert_allclose(view.projection, np.array([535.4, 539.2, 320.6, 248.1]) / 4)
            (capture,) = source.capture([Request(view, "depth")])
            assert np.abs(capture.pixels - seen(view)[1]).max() <= 1.01 / 10000
    (tmp_path / "freiburg1").mkdir()
    folder = folder.rename(tmp_path / "freiburg1" / "mine")
    assert run(folder, tmp_path / "b.sqlite") == 2
    assert "expected --intrinsics FILE, a lens file, or a folder of the bench" in capsys.readouterr().err
    (folder / "rgb.txt").write_text("# file: 'rgbd_dataset_freiburg3_x.bag'\n" + "\n".join(rgb))
    assert run(folder, tmp_path / "b.sqlite") == 0
    assert "lens of freiburg3" in capsys.readouterr().out
