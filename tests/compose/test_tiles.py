"""Large images are composed a block of rows at a time, to the same bytes; large faces lie in one atlas."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import omniscv
from mock_server import load_scene
from omniscv import cameras
from omniscv.compose.atlas import Atlas
from omniscv.depth.ray_lookup import look_up
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose, cube_rotations
from omniscv.planning import FILTERS
from omniscv.planning.rays import BYTES_PER_RAY, ImageRays
from omniscv.sources.base import View
from omniscv.sources.scene import SceneSource
from tests.cameras.examples import example_cameras
from tests.support.cases import cases

SOURCE = SceneSource(load_scene("four-wall"), cached_views=2000)
MODES = ("lit", "object_mask", "depth", "normals")
POSE = Pose.from_angles((0.3, -0.2, 1.4), yaw_deg=20.0, pitch_deg=5.0)
CAMERAS = example_cameras()
CENTRAL = [camera for camera in CAMERAS.values() if camera.central]

pytestmark = pytest.mark.usefixtures("all_cores")


def same_in_tiles(camera, rows, options):
    tile_bytes = rows * camera.width * BYTES_PER_RAY
    renderers = omniscv.Renderer(SOURCE, cache_bytes=0, tile_bytes=tile_bytes), omniscv.Renderer(SOURCE)
    tiled, whole = (renderer.render(camera, POSE, MODES, options) for renderer in renderers)
    assert tiled.layers.keys() == whole.layers.keys()
    for name, layer in whole.layers.items():
        assert (tiled[name].dtype, tiled[name].tobytes()) == (layer.dtype, layer.tobytes()), name
    assert np.array_equal(tiled.valid, whole.valid)
    assert np.array_equal(tiled.centers_w, whole.centers_w)


@cases(12)
@given(
    st.sampled_from(CENTRAL),
    st.integers(1, 70),
    st.sampled_from(FILTERS),
    st.sampled_from(["auto", "cube"]),
    st.sampled_from([8, 32]),
    st.sampled_from(["captured", "from-depth"]),
)
def test_tiles_of_any_height_show_the_same(camera, rows, filter, strategy, face_size, normals):
    options = omniscv.RenderOptions(strategy, filter=filter, face_size=face_size, normals=normals)
    same_in_tiles(camera, rows, options)


@pytest.mark.parametrize("camera", CENTRAL[::4], ids=lambda camera: camera.name)
def test_what_plans_need_of_the_rays_is_the_same(camera):
    """Face sizes and single views decide what is requested: a recording must hold the same."""
    tiled = ImageRays(camera, 3 * camera.width * BYTES_PER_RAY)
    whole = ImageRays(camera)
    assert np.array_equal(tiled.steps, whole.steps, equal_nan=True)
    assert np.array_equal(tiled.directions, whole.directions, equal_nan=True)
    assert (tiled.face_size, tiled.typical_step) == (whole.face_size, whole.typical_step)
    one = tiled.holding_view
    other = whole.holding_view
    assert np.array_equal(one.half, other.half)
    assert one.focal_px == other.focal_px or not np.isfinite(other.half).all()


def peak_bytes(job):
    tracemalloc.start()
    made = job()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak, made


def test_a_tiled_image_never_holds_its_map():
    """Of a pixel it holds 21 bytes: colour, depth, its error, marks, its number. A ray alone takes 24."""
    camera = cameras.create("equirectangular", width=1024, height=512)
    pixels = camera.width * camera.height
    renderer = omniscv.Renderer(SOURCE, cache_bytes=0, tile_bytes=4 * pixels)
    options = omniscv.RenderOptions(face_size=64)
    renderer.render(camera, POSE, ("lit", "depth"), options)  # captures are made, kernels compiled
    peak, image = peak_bytes(lambda: renderer.render(camera, POSE, ("lit", "depth"), options))
    assert 21 * pixels < peak < 40 * pixels
    assert image.valid.all()
    assert renderer.nbytes == 0


def test_face_sizes_are_found_with_less_than_the_rays():
    camera = cameras.create("equirectangular", width=1024, height=512)
    peak, rays = peak_bytes(lambda: ImageRays(camera, 1 << 20))
    found, size = peak_bytes(lambda: rays.face_size)
    assert peak < 8 * rays.valid.size
    assert found < 32 * rays.valid.size
    assert size == ImageRays(camera).face_size


LARGE = 8192 + 8


def views(edge, count=6):
    rotations = [R_w_c for _, R_w_c in cube_rotations()] * 4
    return [View(Pose((0, 0, 0), R_w_c), 90.06, edge, edge) for R_w_c in rotations[:count]]


def test_six_large_faces_fit_and_do_not_overlap_and_more_are_refused():
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
    with pytest.raises(ArgumentError, match="fit into 32766"):
        Atlas(views(LARGE, count=24), range(1), support=0)


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
