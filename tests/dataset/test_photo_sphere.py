"""Photo Sphere metadata, read by Pillow and by Exiv2."""

import io

import numpy as np
import pyexiv2
import pytest
from PIL import Image

import omniscv
from omniscv import dataset
from omniscv.dataset.media import photo_sphere_fields, with_photo_sphere
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
    with Image.open(path) as image, Image.open(io.BytesIO(plain)) as before:
        assert b"equirectangular" in image.info["xmp"]
        np.testing.assert_array_equal(np.asarray(image), np.asarray(before))


@pytest.mark.parametrize(("north_deg", "heading"), [(0, "0"), (90, "90"), (-90, "270"), (725, "5")])
def test_headings_count_from_north(north_deg, heading):
    pose = omniscv.Pose.from_angles((0, 0, 0))
    assert photo_sphere_fields(CAMERA, pose, north_deg)["PoseHeadingDegrees"] == heading


def test_a_dataset_tags_its_panoramas_and_nothing_else(tmp_path):
    fisheye = omniscv.cameras.create("fisheye-equidistant", width=32, height=32, fov_deg=180)
    with omniscv.open_source("scene://four-wall") as source:
        images = {
            each.name: omniscv.render(each, POSE, source, ("lit", "depth"), face_size=32)
            for each in (CAMERA, fisheye)
        }
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
    with pytest.raises(ArgumentError, match=r"media\.xmp: expected store .* png or jpg, got files and jxl"):
        dataset.Writer(tmp_path / "other", image_format="jxl", media={"xmp": True})
