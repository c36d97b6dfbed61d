"""Faces of 8192 px: cv2.remap takes no picture of 32767 px, so the atlas is laid out below that."""

import numpy as np
import pytest
from support.computed import Computed

import omniscv
from omniscv.cameras import create
from omniscv.compose.atlas import Atlas
from omniscv.compose.ray_lookup import look_up
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose, cube_rotations
from omniscv.sources.base import View

LARGE = 8192 + 8


def views(edge, count=6):
    rotations = [R_w_c for _, R_w_c in cube_rotations()] * 4
    return [View(Pose((0, 0, 0), R_w_c), 90.06, edge, edge) for R_w_c in rotations[:count]]


def test_six_large_faces_fit_and_do_not_overlap():
    atlas = Atlas(views(LARGE), range(4), support=2)
    assert max(atlas.shape) < 32767
    slots = [
        (*corner, corner[0] + level.width, corner[1] + level.height)
        for level in atlas.levels
        for corner in level.corners
    ]
    for i, (left, top, right, bottom) in enumerate(slots):
        assert 0 <= left < right <= atlas.shape[1]
        assert 0 <= top < bottom <= atlas.shape[0]
        for other in slots[:i]:
            assert left >= other[2] or right <= other[0] or top >= other[3] or bottom <= other[1]


def test_coordinates_in_large_faces_are_exact_to_a_hundredth_of_a_pixel():
    """float32 coordinates step by 1/512 px at 16384 and beyond, and the map's own rounding is as fine."""
    faces = views(LARGE)
    rays = np.random.default_rng(0).normal(size=(2000, 3))
    lookup = look_up(rays, faces)
    atlas = Atlas(faces, range(1), support=0)
    x, y = atlas.coordinates(lookup)
    for k, view in enumerate(faces):
        mine = lookup.view == k
        exact = view.project(rays[mine])[:, :2] + atlas.levels[0].corners[k] - 0.5
        np.testing.assert_allclose(np.stack([x, y], axis=1)[mine], exact, atol=0.005)


def test_more_than_fit_are_refused():
    with pytest.raises(ArgumentError, match="fit into 32766"):
        Atlas(views(LARGE, count=24), range(1), support=0)


def columns(view):
    """Pixels whose value is their column."""
    column = np.arange(view.width, dtype=np.float32)[None, :, None]
    return np.broadcast_to(column, (view.height, view.width, 3))


@pytest.mark.soak
def test_an_image_from_an_8192_px_face():
    camera = create("pinhole", width=64, height=64, fov_deg=60)
    pose = Pose.from_angles((0, 0, 0))
    given = {"strategy": "cube", "filter": "bilinear", "face_size": 8192}
    image = omniscv.render(camera, pose, Computed(columns), **given)
    u = (camera.project(camera.unproject().directions)[0][..., 0] - 32) / camera.focal
    np.testing.assert_allclose(image.lit[..., 0], LARGE / 2 + 4096 * u - 0.5, atol=0.01)
