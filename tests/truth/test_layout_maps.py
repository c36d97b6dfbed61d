"""Maps of edges and corners, against published numbers and their own symmetry."""

import numpy as np
import pytest
from scipy import ndimage
from support.rooms import L_SHAPE, PLAIN, room_of_plan

from omniscv import Pose, cameras
from omniscv.errors import ArgumentError
from omniscv.truth import project_layout
from omniscv.truth.layout_labels import exact_maps, original_maps

PANORAMA = cameras.create("equirectangular", 512, 256)


def record_of(plan=PLAIN, camera=PANORAMA, **angles):
    pose = Pose.from_angles((0, 0, 1.5), **angles)
    return project_layout(room_of_plan(plan), camera, pose), pose


def test_shares_of_the_known_room_are_those_of_the_reference():
    record, _ = record_of()
    edges, corners = exact_maps(record, PANORAMA)
    for picture, shares in ((edges, (0.1585, 0.1134)), (corners, (0.0532, 0.0265))):
        assert picture.max() >= 250
        found = [(picture / 255 >= 0.01).mean(), (picture / 255 > 0.1).mean()]
        assert found == pytest.approx(shares, abs=0.002)


def test_maps_turn_with_the_panorama():
    """A yaw of k columns to the left moves the image to the right, over the seam."""
    maps = exact_maps(record_of(L_SHAPE)[0], PANORAMA)
    turned = exact_maps(record_of(L_SHAPE, yaw_deg=360 * 389 / 512)[0], PANORAMA)
    for before, after in zip(maps, turned, strict=True):
        assert np.abs(np.roll(before, 389, axis=1).astype(int) - after).max() <= 1


def test_blobs_are_centred_on_the_corners_over_the_seam_too():
    """One corner is half a column from the seam, one is on it."""
    at_seam_deg = 180 - np.degrees(np.arctan2(3, 2))
    for yaw_deg in (at_seam_deg, at_seam_deg + 0.35):
        record, _ = record_of(yaw_deg=-yaw_deg)
        _, picture = exact_maps(record, PANORAMA)
        for corner in record["corners"]:
            u, v = corner["pixel"]
            centred = np.roll(picture, 256 - int(u), axis=1)
            blob = ndimage.label(centred > 30)[0]
            mine = np.where(blob == blob[min(int(v), 255), 256], centred, 0)
            row, column = ndimage.center_of_mass(mine)
            assert (column + 0.5, row + 0.5) == pytest.approx((256 + u - int(u), v), abs=0.5)


def test_what_is_no_layout_has_no_maps():
    with pytest.raises(ArgumentError, match="expected a record of a layout"):
        exact_maps({}, PANORAMA)


@pytest.mark.parametrize("name", ["equirectangular", "pinhole", "noncentral-conical-mirror", "push-broom"])
def test_blobs_have_the_width_of_the_pixels_at_the_middle(name):
    """A share of the pixels of a full turn there, beside a cone's tip too: of rays a pixel apart."""
    camera = cameras.model(name).example(128)
    beside = camera.unproject(camera.center + np.array([[0.5, 0.0], [1.5, 0.0]]))
    between = np.arccos(np.clip(beside.directions[0] @ beside.directions[1], -1, 1))
    turn = 2 * np.pi / between if between else camera.width  # parallel rays have no turn
    corner = {"pixel": [40.5, camera.height * 0.5 + 0.5], "in_image": True, "visible_room": True}
    _, drawn = exact_maps({"edges": [], "corners": [corner]}, camera, corner_sigma=3 / turn)
    row = camera.height // 2
    expected = 255 * np.exp(-0.5 * (np.arange(4) / 3) ** 2)
    assert drawn[row, 40:44] == pytest.approx(expected, rel=0.03)


def test_the_original_recipe_has_no_seam():
    panorama = cameras.create("equirectangular", 256, 128)
    record, pose = record_of(L_SHAPE, panorama)
    original = original_maps(record, panorama, pose)
    record, pose = record_of(L_SHAPE, panorama, yaw_deg=90)
    turned = original_maps(record, panorama, pose)
    for before, after in zip(original, turned, strict=True):
        assert np.abs(np.roll(before, 64, axis=1).astype(int) - after).max() <= 1
    camera = cameras.model("fisheye-equidistant").example(64)
    record = project_layout(room_of_plan(PLAIN), camera, pose)
    with pytest.raises(ArgumentError, match="an image that fills its rectangle"):
        original_maps(record, camera, pose)
