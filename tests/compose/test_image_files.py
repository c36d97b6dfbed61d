"""The files of an image, read back by readers that did not write them.

PNG and JPEG by Pillow, EXR by the reference library, JSON by the standard library.
"""

import dataclasses
import json
from dataclasses import replace
from itertools import product

import cv2
import imagecodecs
import numpy as np
import OpenEXR
import pytest
from PIL import Image
from PIL.ExifTags import Base
from support.full_disk import largest_file

import mock_server
import omniscv
from omniscv.compose import files
from omniscv.compose.files import read
from omniscv.compose.layers import round_depth
from omniscv.errors import ArgumentError, OmniscvError, StorageError
from omniscv.sources.scene import SceneSource

MODES = ("lit", "object_mask", "depth", "normals")
POSE = omniscv.Pose.from_angles((0.1, -0.2, 1.5), yaw_deg=20.0, pitch_deg=7.0)
OPTIONS = {"strategy": "cube", "filter": "bicubic", "face_size": 48}
EXTREMES = [np.inf, np.float32(1e-45), np.float32(3.4e38), 1 / 3, 65504.0, 65536.5]
"""Values that a half float cannot hold, and +inf, which is no surface."""


@pytest.fixture(scope="module")
def image():
    """A fisheye in all modes, with pixels outside the field of view, extreme depths and unsure pixels."""
    camera = omniscv.cameras.create("fisheye-equidistant", width=70, height=61, fov_deg=190)
    with SceneSource(mock_server.load_scene("four-wall")) as source:
        image = omniscv.render(camera, POSE, source, MODES, **OPTIONS)
    depth = image.depth.copy()
    labels = image.labels.copy()
    depth[30, 20 : 20 + len(EXTREMES)] = EXTREMES
    labels[30, 20:23] = 1, 256, 65535
    unsure = np.zeros(image.valid.shape, bool)
    unsure[10:20, 30:50] = True
    return replace(image, layers={**image.layers, "depth": depth, "labels": labels, "unsure": unsure})


@pytest.fixture(scope="module")
def folder(image, tmp_path_factory):
    """Where the image is saved, twice: its colour in all formats."""
    out = tmp_path_factory.mktemp("files") / "new" / "folders"
    image.save(out, stem="pano-0")
    image.save(out, stem="photo", image_format="jpg")
    return out


def with_pillow(path):
    with Image.open(path) as opened:
        return opened.mode, np.array(opened)


def with_openexr(path):
    """Channels by name, and the header."""
    with OpenEXR.File(str(path), separate_channels=True) as opened:
        return {name: channel.pixels for name, channel in opened.channels().items()}, dict(opened.header())


def rgb(channels):
    """(H, W, 3) of the only three channels."""
    assert set(channels) == set("RGB")
    return np.stack([channels[name] for name in "RGB"], axis=-1)


def equal_bits(a, b):
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


def test_the_files_are_named_after_their_layers(image, tmp_path):
    written = image.save(tmp_path, stem="pano-0")
    pixels = ["lit.png", "object_mask.png", "labels.png", "depth.exr", "normals.exr"]
    layers = [*pixels, "unsure.png", "label_edge.png", "depth_error.exr", "json"]
    assert {path.name for path in written} == {*(f"pano-0.{name}" for name in layers), "objects.json"}
    assert sorted(written) == sorted(tmp_path.iterdir())


def test_pictures_hold_colours_labels_of_16_bits_and_white_marks(image, folder):
    forms = {"lit": "RGB", "object_mask": "RGB", "labels": "I;16", "label_edge": "L", "unsure": "L"}
    for layer, mode in forms.items():
        form, pixels = with_pillow(folder / f"pano-0.{layer}.png")
        assert form.startswith(mode)
        wanted = np.where(image[layer], 255, 0).astype(np.uint8) if mode == "L" else image[layer]
        assert equal_bits(pixels.astype(wanted.dtype), wanted)
    form, pixels = with_pillow(folder / "photo.lit.jpg")
    swapped = np.abs(image.lit[..., ::-1].astype(int) - image.lit)
    assert form == "RGB"
    assert np.abs(pixels.astype(int) - image.lit).mean() < 4 < swapped.mean() / 4


@pytest.mark.parametrize(
    ("layer", "unit", "kind", "comments"),
    [
        ("depth", "metre", "along the ray", ("metres", "+inf")),
        ("normals", "1", "unit normal of", ("camera",)),
    ],
)
def test_exr_is_float32_to_the_bit_and_says_what_it_is(image, folder, layer, unit, kind, comments):
    """Compressed as ZIP: readers before OpenEXR 3.5 have no Zstandard."""
    channels, header = with_openexr(folder / f"pano-0.{layer}.exr")
    assert equal_bits(rgb(channels) if layer == "normals" else channels.pop("Y"), image[layer])
    assert (header["unit"], header["compression"]) == (unit, OpenEXR.ZIP_COMPRESSION)
    assert kind in header["kind"]
    assert all(each in header["comments"] for each in comments)
    assert "x right, y down, z forward" in header["frame"]


def test_colours_of_floats_go_to_exr_and_those_of_bytes_can(image, tmp_path):
    lit = (image.lit / np.float32(255)) ** np.float32(2.2) * 4
    changed = replace(image, layers={**image.layers, "lit": lit})
    for image_format in ("png", "jpg"):
        names = {path.name for path in changed.save(tmp_path / image_format, "hdr", image_format)}
        assert {name for name in names if name.startswith("hdr.lit")} == {"hdr.lit.exr"}
        assert equal_bits(rgb(with_openexr(tmp_path / image_format / "hdr.lit.exr")[0]), lit)
    image.save(tmp_path, "a", "exr")
    codes = np.rint(rgb(with_openexr(tmp_path / "a.lit.exr")[0]).astype(np.float64) * 255)
    assert np.array_equal(codes, image.lit)


def test_the_json_describes_the_image(image, folder):
    found = json.loads((folder / "pano-0.json").read_text(encoding="utf-8"))
    assert omniscv.cameras.from_dict(found["camera"]) == image.camera
    pose = omniscv.Pose.from_dict(found["pose"])
    assert np.array_equal(pose.position, POSE.position)
    assert np.array_equal(pose.rotation, POSE.rotation)
    options = dataclasses.asdict(omniscv.RenderOptions(**OPTIONS))
    assert found["options"] == {**options, "sky": [], "capture_ms": [5.0, 25.0]}
    assert (found["source"]["scene"], found["versions"]["omniscv"]) == ("four-wall", omniscv.__version__)
    assert (found["unsure_pixels"], found["unknown_mask_colors"]) == (200, [])


def test_objects_name_the_labels_and_the_colours_of_masks(image, folder):
    objects = json.loads((folder / "objects.json").read_text(encoding="utf-8"))
    assert [objects[str(1 + rank)]["name"] for rank in range(len(objects))] == image.objects.names()
    _, labels = with_pillow(folder / "pano-0.labels.png")
    _, mask = with_pillow(folder / "pano-0.object_mask.png")
    shown = [label for label in np.unique(labels) if str(label) in objects]
    assert len(shown) > 5
    for label in shown:
        untouched = labels == label
        untouched[30, 20:23] = False  # where the fixture writes labels
        assert np.all(mask[untouched] == objects[str(label)]["mask_color"])


def test_no_file_holds_the_time_of_writing(folder):
    assert not any("capDate" in with_openexr(path)[1] for path in folder.glob("*.exr"))
    assert not any(b"tIME" in path.read_bytes() for path in folder.glob("*.png"))
    with Image.open(folder / "photo.lit.jpg") as opened:
        assert not {Base.DateTime, Base.DateTimeOriginal} & set(opened.getexif())


def test_a_stem_that_is_no_file_name_and_an_unknown_format_are_refused(image, tmp_path):
    for stem in ("", ".", "a/b", "../a", "/a", "a/", None, 3):
        with pytest.raises(ArgumentError, match=r"stem: expected the start of a file name"):
            image.save(tmp_path / "out", stem=stem)
    for image_format in ("PNG", "tif", ".png", "", None, "jxl"):
        with pytest.raises(ArgumentError, match=r"image_format: expected one of png, jpg, .*; got"):
            image.save(tmp_path / "out", image_format=image_format)
    assert list(tmp_path.iterdir()) == []


def test_a_layer_that_cannot_be_written_leaves_no_part_and_the_file_before(image, tmp_path):
    for image_format, shape, dtype, says in (
        ("tiff", (4, 0, 3), np.uint8, "to write it, got"),
        ("png", (4, 0, 3), np.uint8, r"uint8 or uint16 .*; got uint8 of shape \(4, 0, 3\)"),
        ("jpg", (1, 65501, 3), np.uint8, r"uint8 .* 65500 a side .*; got uint8"),
        ("jpg", (4, 4, 3), np.uint16, "uint8 pixels .*; got uint16 .* choose png"),
    ):
        image.save(tmp_path, "a", image_format)
        before = (tmp_path / f"a.lit.{image_format}").read_bytes()
        wrong = replace(image, layers={"lit": np.zeros(shape, dtype)})
        with pytest.raises(OmniscvError, match=rf"a\.lit\..*{image_format}: expected {says}"):
            wrong.save(tmp_path, "a", image_format)
        assert (tmp_path / f"a.lit.{image_format}").read_bytes() == before
        assert [path.name for path in tmp_path.iterdir() if "part" in path.name] == []


def test_a_full_disk_is_one_line_that_names_the_file(image, tmp_path):
    lit = replace(image, layers={"lit": np.random.default_rng(0).integers(0, 256, (90, 90, 3), np.uint8)})
    for image_format, size in product(("png", "jpg", "exr", "tiff"), (0, 7000)):
        says = rf"{tmp_path}/a.lit.{image_format}: .*File too large; free space there"
        with largest_file(size), pytest.raises(StorageError, match=says):
            lit.save(tmp_path, "a", image_format)
        assert list(tmp_path.iterdir()) == []


def test_the_doubtful_share_counts_each_pixel_once(tmp_path):
    """Pixels at label edges, unsure ones, and those whose depth may be off by more than 1 %; not the sky."""
    camera = omniscv.cameras.create("equirectangular", 4, 2)
    valid = np.array([[True, True, True, True], [True, True, True, False]])
    edge, unsure = np.zeros((2, 2, 4), bool)
    edge[0, 0] = unsure[0, 0] = unsure[0, 1] = edge[1, 3] = True
    depth = np.array([[2, 2, np.inf, 2], [2, 2, np.inf, 0]], np.float32)
    error = np.array([[0, 0, 0, 0.03], [0.01, np.inf, np.inf, 9]], np.float32)
    layers = {"label_edge": edge, "unsure": unsure, "depth": depth, "depth_error": error}
    image = omniscv.OmniImage(camera=camera, pose=POSE, valid=valid, layers=layers, centers_w=POSE.position)
    assert image.doubtful == 5 / 7
    image.save(tmp_path, doubt=True)
    np.testing.assert_array_equal(read(tmp_path / "image.doubt.png", "doubt"), image.doubt)
    assert dataclasses.replace(image, layers={}).doubtful == 0


@pytest.mark.parametrize("image_format", ["png", "tiff"])
def test_layers_read_back_are_those_in_memory(image, tmp_path, image_format):
    image = replace(image, layers={**image.layers, "unsure": np.zeros(image.valid.shape, bool)})
    image.save(tmp_path, "a", image_format)
    assert json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))["blank"] == ["unsure"]
    for name in image.layers.keys() - {"unsure"}:
        (path,) = (each for each in tmp_path.glob(f"a.{name}.*"))
        again = read(path, name)
        layer = image[name]
        assert again.dtype == layer.dtype
        if name == "depth_error":
            assert (again >= layer).all()
            np.testing.assert_array_equal(again, as_half_floats(layer))
        else:
            np.testing.assert_array_equal(again, layer)
    with pytest.raises(ArgumentError, match="expected float32 pixels of depth"):
        read(tmp_path / "a.object_mask.png", "depth")
    with pytest.raises(ArgumentError, match="expected a picture of depth"):
        read(tmp_path / "nothing.exr", "depth")


def as_half_floats(bounds, every=32):
    """The least half floats that are not less, found among all of 6 binary digits, or of 11."""
    halves = np.arange(0, 0x7C01, every, dtype=np.uint16).view(np.float16).astype(np.float64)  # 0 to +inf
    return halves[np.searchsorted(halves, bounds.astype(np.float64))]


def test_bounds_are_rounded_up_to_half_floats(tmp_path):
    """Also below their least normal number, 6.1e-5 m, and beyond their largest, 65504 m."""
    spread = 2.0 ** np.random.default_rng(4).uniform(-30, 20, 5000)
    ends = [0, 1e-45, 6e-8, 6.1e-5, 1 / 3, 1, 65504, 65505, 65519, 65520, 3e38, np.inf]
    bounds = np.array([*spread, *ends], np.float32)[None]
    files.write({"depth_error": bounds}, {}, None, tmp_path, "a")
    written = read(tmp_path / "a.depth_error.exr", "depth_error")
    np.testing.assert_array_equal(written, as_half_floats(bounds, every=1))


def foreign(path):
    """The pixels of a file of floats as other programs read them."""
    if path.suffix == ".npy":
        return [np.load(path)]
    bgr = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    own = imagecodecs.tiff_decode(path.read_bytes())
    return [own, bgr[..., ::-1]] if bgr.ndim == 3 else [own, bgr, with_pillow(path)[1]]


@pytest.mark.parametrize("depth_format", ["tiff", "npy"])
def test_other_forms_of_depth_are_float32_to_foreign_readers(image, tmp_path, depth_format):
    """TIFF by OpenCV, Pillow and imagecodecs' own reader; NPY by NumPy: what is in memory, bit for bit."""
    image.save(tmp_path, "a", depth_format=depth_format)
    for name in ("depth", "depth_error", "normals"):
        path = tmp_path / f"a.{name}.{depth_format}"
        np.testing.assert_array_equal(read(path, name), image[name])
        assert all(equal_bits(pixels, image[name]) for pixels in foreign(path))
    with pytest.raises(ArgumentError, match="depth_format: expected one of exr, tiff, npy; got 'exrs'"):
        image.save(tmp_path, "a", depth_format="exrs")


def test_depth_has_no_more_digits_than_its_bound_knows():
    """Against float64: it moves by 1/32 of its bound at most, which then holds both; the rest stays."""
    rng = np.random.default_rng(3)
    depth = np.float32(10.0 ** rng.uniform(-6, 6, (50, 200)))
    error = np.float32(depth * 10.0 ** rng.uniform(-9, 2, depth.shape))
    depth[0] = np.inf
    error[1] = np.inf
    error[2] = 0
    depth[3] = 0
    rounded, bound = round_depth(depth, error)
    np.testing.assert_array_equal(rounded[:4], depth[:4])
    assert (rounded[4:] > 0).all()
    moved = np.abs(rounded[2:].astype(np.float64) - depth[2:])
    assert (moved <= error[2:] / 32.0).all()
    assert (bound[2:] >= moved + error[2:]).all()
    step = 2.0 ** np.floor(np.log2(error[4:] / 16.0))
    coarse = (step > 2.0**-18 * depth[4:]) & (step < 2.0**-13 * depth[4:])
    assert (np.fmod(rounded[4:].astype(np.float64), step)[coarse] == 0).all()  # digits that compress are gone
    np.testing.assert_array_equal(bound, as_half_floats(bound))
    again = round_depth(rounded, error)
    np.testing.assert_array_equal(again[0], rounded)
