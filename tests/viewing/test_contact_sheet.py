"""The sheet of many images: what its tiles show, read from the file."""

import numpy as np
import pytest
from PIL import Image

import omniscv
from omniscv import cameras
from omniscv.demo import contact_sheet, demo_cameras, tile, truths

MODES = ("lit", "object_mask", "depth", "normals")
POSE = omniscv.Pose.from_angles((0, 0, 1.5), yaw_deg=20)


@pytest.fixture(scope="module")
def room():
    with omniscv.open_source("scene://four-wall") as source:
        renderer = omniscv.Renderer(source)
        options = omniscv.RenderOptions(face_size=48)
        names = ("fisheye-equidistant", "equirectangular")
        shots = {name: cameras.model(name).example(48) for name in names}
        images = {name: renderer.render(camera, POSE, MODES, options) for name, camera in shots.items()}
        return images, source.objects()


def test_a_tile_shows_colours_at_full_size_and_three_truths_beside_them(room):
    images, _ = room
    image = images["fisheye-equidistant"]
    shown = tile(image, 5.0)
    assert shown.shape[0] == 48
    assert 4 / 3 * 48 <= shown.shape[1] <= 4 / 3 * 48 + 4
    np.testing.assert_array_equal(shown[:, :48][image.valid], image.lit[image.valid])
    outside = shown[:, :48][~image.valid]
    assert len(np.unique(outside, axis=0)) == 1


def test_the_sheet_holds_every_image_and_its_labels_have_the_colours_of_masks(room, tmp_path):
    images, objects = room
    path = contact_sheet(images, objects, tmp_path / "new" / "sheet.png", "two images")
    page = np.asarray(Image.open(path).convert("RGB"))
    assert page.shape[1] >= 8 / 3 * 48
    for image in images.values():  # pictures are scaled to fit: their mean colours are somewhere on the page
        mean = image.lit[image.valid].mean(axis=0)
        assert np.abs(page - mean).max(axis=2).min() < 24
        labels, _, normals = truths(image, 5.0)
        np.testing.assert_array_equal(labels[image.valid], image.object_mask[image.valid])
        turned = normals[image.valid].astype(float) / 127.5 - 1
        np.testing.assert_allclose(turned, image.normals[image.valid], atol=1 / 255)


def test_the_demo_shows_every_model_as_it_is_used():
    shown = demo_cameras(2)
    assert sorted(shown) == sorted(cameras.names())
    for name, (camera, pose) in shown.items():
        up = pose.R_w_c[2, 2]  # of the optical axis
        assert up == pytest.approx(np.sin(np.radians(cameras.model(name).typical_pitch_deg)), abs=1e-12)
        assert camera.width in (512, 1024)
