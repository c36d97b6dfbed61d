"""Metadata of pictures, read by Pillow and Exiv2; videos, decoded by FFmpeg; and their boxes."""

import io
from dataclasses import replace

import av
import cv2
import numpy as np
import pyexiv2
import pytest
from PIL import Image

import omniscv
from omniscv import dataset
from omniscv.dataset import Frame
from omniscv.dataset.media import photo_sphere_fields, video_boxes, with_photo_sphere, write_video
from omniscv.errors import ArgumentError

CAMERA = omniscv.cameras.create("equirectangular", width=64, height=32)
POSE = omniscv.Pose.from_angles((1, 2, 1.5), yaw_deg=90, pitch_deg=-5, roll_deg=2.5)
PIXELS = np.random.default_rng(2).integers(0, 256, (32, 64, 3), np.uint8)


def encoded(image_format, **options):
    file = io.BytesIO()
    Image.fromarray(PIXELS).save(file, image_format, **options)
    return file.getvalue()


@pytest.mark.parametrize("image_format", ["PNG", "JPEG"])
def test_other_programs_read_the_fields_and_the_same_pixels(tmp_path, image_format):
    plain = encoded(image_format)
    path = tmp_path / f"a.{image_format.lower()}"
    path.write_bytes(with_photo_sphere(plain, photo_sphere_fields(CAMERA, POSE)))
    with pyexiv2.Image(str(path)) as file:
        found = {key.removeprefix("Xmp.GPano."): value for key, value in file.read_xmp().items()}
    assert found == photo_sphere_fields(CAMERA, POSE)
    assert {
        "ProjectionType": "equirectangular",
        "FullPanoWidthPixels": "64",
        "FullPanoHeightPixels": "32",
        "CroppedAreaImageWidthPixels": "64",
        "CroppedAreaImageHeightPixels": "32",
        "CroppedAreaLeftPixels": "0",
        "CroppedAreaTopPixels": "0",
        "PoseHeadingDegrees": "270",  # the middle looks along the world's Y, west of a north along X
        "PosePitchDegrees": "-5",
        "PoseRollDegrees": "2.5",
    }.items() <= found.items()
    for north_deg, heading in ((0, "0"), (90, "90"), (-90, "270"), (725, "5")):
        level = photo_sphere_fields(CAMERA, omniscv.Pose.from_angles((0, 0, 0)), north_deg)
        assert level["PoseHeadingDegrees"] == heading
    with Image.open(path) as image, Image.open(io.BytesIO(plain)) as before:
        assert b"equirectangular" in image.info["xmp"]
        np.testing.assert_array_equal(np.asarray(image), np.asarray(before))


def test_a_dataset_tags_its_panoramas_and_nothing_else(tmp_path):
    fisheye = omniscv.cameras.create("fisheye-equidistant", width=32, height=32, fov_deg=180)
    with omniscv.open_source("scene://four-wall") as source:
        shots = [omniscv.render(of, POSE, source, ("lit", "depth"), face_size=32) for of in (CAMERA, fisheye)]
        images = {image.camera.name: image for image in shots}
    with dataset.Writer(tmp_path, media={"xmp": True, "north": 10}) as writer:
        for key, image in images.items():
            writer.add(key, image)
    assert dataset.check(tmp_path, deep=True) == []
    headings = {}
    for frame in dataset.open(tmp_path):
        np.testing.assert_array_equal(frame.layer("lit"), images[frame.key].lit)
        with pyexiv2.Image(str(frame.files["lit"])) as file:
            headings[frame.key] = file.read_xmp().get("Xmp.GPano.PoseHeadingDegrees")
    assert headings == {"equirectangular": "280", "fisheye-equidistant": None}
    for way, got in (({"image_format": "tiff"}, "files and tiff"), ({"store": "fast"}, "fast and png")):
        with pytest.raises(ArgumentError, match=rf"media\.xmp: expected store .* png or jpg, got {got}"):
            dataset.Writer(tmp_path / "other", media={"xmp": True}, **way)
    image = images["equirectangular"]
    light = replace(image, layers={**image.layers, "lit": image["lit"].astype(np.float32)})
    with dataset.Writer(tmp_path / "light", media={"xmp": True}) as writer:
        with pytest.raises(ArgumentError, match=r"media\.xmp: expected colours of 8 bits, got light"):
            writer.add("light", light)
        writer.add("colour", image)


def frames(folder, model="equirectangular", count=5, width=64, height=32):
    camera = omniscv.cameras.create(model, width=width, height=height)
    for i in range(count):
        ramp = np.add.outer(np.arange(height) * 3, np.arange(width) * 2) + 10 * i
        cv2.imwrite(str(folder / f"{i}.png"), np.repeat(ramp[..., None] % 256, 3, axis=2).astype(np.uint8))
    files = [{"lit": folder / f"{i}.png"} for i in range(count)]
    return [Frame(f"{i}", "pano", camera, POSE, of, {}, time_ns=i * 10**8) for i, of in enumerate(files)]


def decoded(data):
    with av.open(io.BytesIO(data)) as container:
        frames = list(container.decode(video=0))
        # Before PyAV 19, iterating gave what is filed under the types:
        kinds = [{getattr(each, "type", each).name for each in frame.side_data} for frame in frames]
        return [(frame.to_ndarray(format="rgb24"), kind) for frame, kind in zip(frames, kinds, strict=True)]


def test_the_boxes_are_those_of_the_specification():
    stereo = "0000000d737433640000000000"
    sphere = "0000005873763364"
    header = "000000147376686400000000" + "6f6d6e6973637600"
    projection = "0000003c70726f6a"
    turned = "0000001870726864" + "00" * 16
    equirectangular = "0000001c65717569" + "00" * 20
    assert video_boxes().hex() == stereo + sphere + header + projection + turned + equirectangular


def test_panoramas_alone_are_spheres_and_their_frames_the_same(tmp_path):
    path = write_video(frames(tmp_path), tmp_path / "a" / "video.mp4", rate=10)
    data = path.read_bytes()
    shown = decoded(data)
    assert len(shown) == 5
    for i, (pixels, kinds) in enumerate(shown):
        assert {"SPHERICAL", "STEREO3D"} <= kinds
        expected = cv2.imread(str(tmp_path / f"{i}.png"))[..., ::-1].astype(int)
        smooth = np.abs(np.diff(expected, axis=1, append=0)).max(axis=2) < 9  # the ramp starts again
        assert np.abs(pixels - expected)[smooth].mean() < 3  # of 256, lossy at a quality of 18
    assert not list(tmp_path.glob("a/.*"))
    flat = write_video(frames(tmp_path, "pinhole"), tmp_path / "flat.mp4").read_bytes()
    assert not {"SPHERICAL", "STEREO3D"} & decoded(flat)[0][1]


def by_filters(path):
    """The first picture, by the filter that ffmpeg puts in by itself."""
    with av.open(str(path)) as container:
        graph = av.filter.Graph()
        start = graph.add_buffer(template=container.streams.video[0])
        rgb = graph.add("format", "rgb24")
        end = graph.add("buffersink")
        start.link_to(rgb)
        rgb.link_to(end)
        graph.configure()
        graph.push(next(container.decode(video=0)))
        return graph.pull().to_ndarray()


def by_pyav(path):
    return decoded(path.read_bytes())[0][0]


def by_opencv(path):
    return cv2.VideoCapture(str(path)).read()[1][..., ::-1]


@pytest.mark.parametrize("reader", [by_pyav, by_filters, by_opencv])
@pytest.mark.parametrize("size", [(280, 140), (1280, 640)], ids=["small", "large"])
def test_a_video_says_what_its_colours_are_and_readers_get_them_back(reader, size, tmp_path):
    """Players take BT.601 for small pictures that say nothing, BT.709 for large ones."""
    colors = np.array(
        [(255, 0, 0), (0, 255, 0), (0, 0, 255), (200, 30, 120), (20, 200, 180), (255,) * 3, (0,) * 3]
    )
    (frame,) = frames(tmp_path, count=1, width=size[0], height=size[1])
    patch = size[0] // len(colors)
    picture = np.zeros((size[1], size[0], 3), np.uint8)
    for i, color in enumerate(colors):
        picture[:, i * patch : (i + 1) * patch] = color
    cv2.imwrite(str(frame.files["lit"]), picture[..., ::-1])
    path = write_video([frame], tmp_path / "colors.mp4")
    middles = reader(path)[size[1] // 2, patch // 2 + patch * np.arange(len(colors))].astype(int)
    assert np.abs(middles - colors).max() <= 4
    with av.open(str(path)) as container:
        shown = next(container.decode(video=0))
        coding = container.streams.video[0].codec_context
        assert (int(shown.colorspace), int(shown.color_range)) == (1, 1)  # BT.709, limited
        assert (int(coding.color_primaries), int(coding.color_trc)) == (1, 1)


def test_wrong_videos_and_options_are_refused(tmp_path):
    for shown, rate, says in (
        ([], 10, "expected the frames of one camera, got none"),
        (frames(tmp_path, width=33), 10, "expected an even width and height"),
        (frames(tmp_path), 0, "rate: expected a finite number > 0"),
    ):
        with pytest.raises(ArgumentError, match=says):
            write_video(shown, tmp_path / "a.mp4", rate=rate)
