"""A furnished room that Blender rendered, replayed: its walls are where make_room.py built them."""

from pathlib import Path

import numpy as np
import pytest
from support import recorded_room
from support.recorded_room import BORDER_PX, FACE_PX, MODES, PLACE

import omniscv
from omniscv.geometry import Pose, cube_rotations, pinhole
from omniscv.sources import Request, View

WALLS = {
    "Ceiling": ((0, 0, -1), -2.7),
    "Wall_Left": ((0, -1, 0), -2.2),
    "Wall_Right": ((0, 1, 0), -2.2),
    "Wall_Back": ((1, 0, 0), -2.8),
}
"""By object: the normal of what is seen of it, and where it is along that normal, metres."""
LENS_M = 1e-4
"""Blender draws samples within 0.005 px of the centres of pixels; floats have 2e-7 of 3 m."""
SIZE = FACE_PX + 2 * BORDER_PX
VIEWS = [
    View(Pose(PLACE, R_w_c), pinhole.fov_deg(SIZE, FACE_PX / 2), SIZE, SIZE) for _, R_w_c in cube_rotations()
]


@pytest.fixture(scope="module")
def source():
    with omniscv.open_source(Path(__file__).parents[3] / "captures/living-room.sqlite") as replay:
        yield replay


SLOW = pytest.param("noncentral", marks=pytest.mark.soak)  # planned for seconds; tests/planning has its like


@pytest.fixture(scope="module", params=["panorama", "fisheye", SLOW])
def image(request, source):
    return getattr(recorded_room, request.param)(source)


def points_w(image):
    directions = image.camera.unproject().directions @ image.pose.R_w_c.T
    return image.centers_w + image.depth[..., None] * directions


def seen(image, name):
    """The pixels that show an object, and whose captures show nothing else around them."""
    return (image.labels == image.objects.label(name)) & ~image["label_edge"]


def walls(image):
    """The walls of which an image has enough sure pixels: one is at the rim of the fisheye alone."""
    names = [name for name in WALLS if seen(image, name).sum() > 20]
    assert len(names) >= len(WALLS) - 1
    return names


def test_every_pixel_shows_an_object_or_the_window(image):
    """What is behind the panes is the sky, which is no object."""
    names = image.objects.names()
    assert len(names) > 30
    assert image.labels[image.valid].max() <= len(names)
    assert not image.labels[~image.valid].any()
    nothing = image.valid & (image.labels == 0)
    assert np.isposinf(image.depth[nothing]).all()
    assert nothing.sum() < 0.05 * image.valid.sum()
    assert {"Sofa", "Table", "Rug", "Floor", *WALLS} <= {
        names[label - 1] for label in np.unique(image.labels[image.labels > 0])
    }


def test_the_walls_are_where_they_were_built(image):
    points = points_w(image)
    for name in walls(image):
        normal, along = WALLS[name]
        here = seen(image, name)
        off = np.abs(points[here] @ normal - along)
        assert np.median(off - image["depth_error"][here] / 32) <= LENS_M, name  # depth is rounded so far
        assert np.max(off - image["depth_error"][here]) <= LENS_M, name


@pytest.mark.parametrize("image", ["panorama", "fisheye"], indirect=True)
def test_normals_are_those_of_the_walls(image):
    """The ceiling's paint is smooth; plaster has bumps, of which shading normals show the slopes."""
    normals_w = image.normals @ image.pose.R_w_c.T
    for name in walls(image):
        normal, _ = WALLS[name]
        found = normals_w[seen(image, name)]
        assert np.abs(np.linalg.norm(found, axis=-1) - 1).max() <= 1e-5
        slope_deg = np.degrees(np.arccos(np.clip(found @ normal, -1, 1)))
        assert np.median(slope_deg) <= (0.01 if name == "Ceiling" else 5.0), name


@pytest.mark.parametrize("number", [0, 5])
def test_at_the_centres_of_its_pixels_an_image_is_the_capture(number, source):
    image = recorded_room.face(source, number)
    inner = slice(BORDER_PX, -BORDER_PX)
    requests = [Request(VIEWS[number], mode) for mode in MODES]
    lit, ids, depth, normals = (each.pixels[inner, inner] for each in source.capture(requests))
    names = {instance: name for name, instance in source.objects().ids.items()}
    label = np.array([source.objects().label(names[i]) if i in names else 0 for i in range(1 + max(names))])
    assert np.array_equal(image.lit, lit)
    assert np.array_equal(image.labels, label[ids])
    lengths = View(Pose(PLACE, np.eye(3)), 90.0, FACE_PX, FACE_PX).ray_lengths()
    finite = np.isfinite(depth)
    assert np.array_equal(np.isfinite(image.depth), finite)
    off = np.abs(image.depth[finite] - (depth * lengths)[finite])
    assert (off <= image.depth_error[finite] / 32 + 1e-6 * image.depth[finite]).all()  # it is rounded so far
    assert np.allclose(image.normals @ image.pose.R_w_c.T, normals, atol=1e-5)
    assert np.ptp(lit) > 50
    assert len(np.unique(ids)) >= 2


@pytest.mark.parametrize("image", [SLOW], indirect=True)
def test_a_point_has_the_same_object_and_colour_from_a_circle_as_from_its_middle(source, image):
    """But where it is hidden from the middle, or shines."""
    points = points_w(image)
    kept = image.valid & np.isfinite(image.depth)
    same = []
    apart = []
    for view in VIEWS:
        lit, ids, depth = (each.pixels for each in source.capture(Request(view, mode) for mode in MODES[:3]))
        u, v, z = np.moveaxis(view.project(np.where(kept[..., None], points, 0)), -1, 0)
        inside = kept & (z > 0) & (np.abs(u - SIZE / 2) < FACE_PX / 2) & (np.abs(v - SIZE / 2) < FACE_PX / 2)
        row, column = v[inside].astype(int), u[inside].astype(int)
        met = np.abs(depth[row, column] - z[inside]) < 0.02 * z[inside]
        ids_here = np.array([0, *(source.objects().ids[name] for name in source.objects().names())])
        same.append((ids_here[image.labels[inside]] == ids[row, column])[met])
        apart.append(np.abs(image.lit[inside].astype(float) - lit[row, column]).max(axis=-1)[met])
    assert len(np.concatenate(same)) > 0.9 * kept.sum()
    assert np.concatenate(same).mean() > 0.98
    assert np.median(np.concatenate(apart)) <= 6
