"""Panoramas: what is where, judged by FFmpeg, how pixels are spread, and where the sphere is cut."""

import itertools

import av
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cases import cases

from omniscv import cameras
from omniscv.cameras import create
from omniscv.cameras.panoramas import LAYOUTS

FACE = 64  # px
SIZES = {name: (FACE * len(rows[0]), FACE * len(rows)) for name, rows in LAYOUTS.items()}
AHEAD = {
    "F": (0, 0, 1), "R": (1, 0, 0), "B": (0, 0, -1), "L": (-1, 0, 0), "U": (0, -1, 0), "D": (0, 1, 0),
}  # fmt: skip


def cube(name, layout, **options):
    return create(name, *SIZES[layout], layout=layout, **options)


def solid_angles(camera):
    """(H, W) steradians of pixels: of the triangles between their corners' rays (Van Oosterom, Strackee)."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    inset = 1e-6  # corners on a border belong to one of two faces
    corners = [
        camera.unproject(np.stack([u + a, v + b], axis=-1)).directions
        for a, b in ((inset, inset), (1 - inset, inset), (1 - inset, 1 - inset), (inset, 1 - inset))
    ]

    def triangle(a, b, c):
        volume = np.abs((a * np.cross(b, c)).sum(axis=-1))
        return 2 * np.arctan2(volume, 1 + (a * b).sum(axis=-1) + (b * c).sum(axis=-1) + (c * a).sum(axis=-1))

    return triangle(*corners[:3]) + triangle(corners[0], *corners[2:])


def v360(camera, output):
    """The directions that FFmpeg puts into each pixel of an output format, from a panorama of them."""
    panorama = create("equirectangular", 1024, 512)
    directions = panorama.unproject().directions
    colours = np.round(32767.5 * (directions + 1)).astype(np.uint16)
    graph = av.filter.Graph()
    steps = [
        graph.add_buffer(width=1024, height=512, format="gbrp16le", time_base="1/25"),
        graph.add("v360", f"input=e:output={output}:w={camera.width}:h={camera.height}:interp=linear"),
        graph.add("buffersink"),
    ]
    graph.link_nodes(*steps).configure()
    frame = av.VideoFrame.from_ndarray(colours, format="gbrp16le")
    frame.pts = 0
    graph.push(frame)
    return graph.pull().to_ndarray().astype(float) / 32767.5 - 1


@pytest.mark.parametrize(
    ("name", "layout", "output"),
    [
        ("cube-map", "3x2", "c3x2"),
        ("cube-map", "strip", "c6x1:out_forder=frblud"),
        ("equiangular-cube", "3x2", "eac"),
    ],
)
def test_layouts_are_those_of_ffmpeg(name, layout, output):
    """Every pixel; FFmpeg's eac has 2 px of padding, and in it an approximation of its own."""
    options = {"padding_px": 2} if output == "eac" else {}
    camera = cube(name, layout, **options)
    expected = v360(camera, output)
    off = np.linalg.norm(camera.unproject().directions - expected, axis=-1)
    if options:
        assert off.max() <= 0.1
        off = np.concatenate([off[2 : FACE - 2, 2:-2], off[FACE + 2 : 2 * FACE - 2, 2:-2]])
    # The filter takes whole numbers for pixels' centres: it reads the panorama half a pixel off, 0.003 rad.
    assert off.max() <= 3.5e-3


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("name", ["cube-map", "equiangular-cube"])
def test_faces_look_where_the_table_says(name, layout):
    camera = cube(name, layout)
    own = name == "equiangular-cube" and layout == "3x2"
    for y, row in enumerate([("L", "F", "R"), ("D", "B", "U")] if own else LAYOUTS[layout]):
        for x, slot in enumerate(row):
            ray = camera.unproject((FACE * (x + 0.5), FACE * (y + 0.5)))
            assert ray.valid == (slot != " ")
            if ray.valid:
                np.testing.assert_allclose(ray.directions, AHEAD[slot[0]], atol=1e-15)


@pytest.mark.parametrize(
    ("name", "layout", "borders"),
    [("cube-map", "cross", 5), ("cube-map", "dice", 5), ("equiangular-cube", "3x2", 4)],
)
def test_faces_go_on_across_the_borders_of_these_layouts(name, layout, borders):
    """Rays on both sides of a border between two faces are neighbours: nothing is turned or mirrored."""
    camera = cube(name, layout)
    smooth_borders = 0
    for corner in itertools.product(range(0, camera.width, FACE), range(0, camera.height, FACE)):
        for across in np.eye(2):
            on_border = corner + np.arange(5.0, FACE, 6)[:, None] * (1 - across)
            a, b = (camera.unproject(on_border + step * across) for step in (-1e-6, 1e-6))
            if a.valid.all() and b.valid.all():
                smooth_borders += np.linalg.norm(a.directions - b.directions, axis=-1).max() < 1e-6
    assert smooth_borders == borders


def test_how_evenly_pixels_are_spread():
    """The largest pixel's solid angle over the smallest's: 3^1.5 for a fine plain cube map."""
    ratio = {}
    for name in ("cube-map", "equiangular-cube", "octahedral"):
        size = (6 * FACE, FACE, "strip") if "cube" in name else (256, 256)
        angles = solid_angles(create(name, *size[:2], **({"layout": size[2]} if size[2:] else {})))
        assert angles.sum() == pytest.approx(4 * np.pi, rel=1e-4)
        ratio[name] = angles.max() / angles.min()
    assert ratio["cube-map"] == pytest.approx(3**1.5, rel=0.05)
    assert ratio["equiangular-cube"] == pytest.approx(2**0.5, rel=0.02)
    assert 4 < ratio["octahedral"] < 5.2


def test_equal_area_pixels_are_equal():
    """Archimedes: 2 pi per height."""
    camera = create("cylindrical", 90, 60, fov_v_deg=180, profile="equal-area")
    rows = camera.unproject(np.stack([np.full(61, 45.0), np.arange(61.0)], axis=-1))
    np.testing.assert_allclose(np.diff(rows.directions[:, 1]), 2 / 60, rtol=1e-12)


def test_mercator_is_conformal_and_square_at_its_usual_limit():
    camera = create("cylindrical", 512, 512, fov_v_deg=2 * 85.0511287798066, profile="mercator")
    pixels = np.random.default_rng(1).uniform(1, 511, (500, 2))
    ray = camera.unproject(pixels).directions
    across = camera.unproject(pixels + np.array([1e-4, 0])).directions - ray
    down = camera.unproject(pixels + np.array([0, 1e-4])).directions - ray
    np.testing.assert_allclose(np.linalg.norm(across, axis=1), np.linalg.norm(down, axis=1), rtol=1e-4)


def test_miller_rows():
    """Snyder 1987, p. 88: y = ln(tan(45 deg + 0.4 phi)) / 0.8; the pole at 2.3034125."""
    camera = create("cylindrical", 64, 1000, fov_v_deg=180, profile="miller")
    phi = np.radians([90, 60, 30, -75])
    pixels, _ = camera.project(np.stack([0 * phi, -np.sin(phi), np.cos(phi)], axis=-1))
    expected = np.log(np.tan(np.pi / 4 + 0.4 * phi)) / 0.8
    np.testing.assert_allclose((1 - pixels[:, 1] / 500) * 2.3034125, expected, atol=1e-7)


PANORAMAS = [("equirectangular", {}), ("cylindrical", {"fov_v_deg": 180})]
every_panorama = pytest.mark.parametrize(("name", "parameters"), PANORAMAS)


@every_panorama
def test_poles_and_the_direction_behind(name, parameters):
    """Straight up is the first row, straight down the last, in all columns; x = 0.0 and x = -0.0 are one."""
    camera = cameras.create(name, width=64, height=32, **parameters)
    pixels, seen = camera.project(np.array([[0.0, 0, -1], [-0.0, 0, -1]]))
    assert seen.all()
    assert set(pixels[:, 0]) <= {0.0, 64.0}
    rays = camera.unproject(np.array([[0.0, 16], [64.0, 16]])).directions
    np.testing.assert_allclose(rays, [(0, 0, -1)] * 2, rtol=0, atol=2e-16)
    for metres in (1e-300, 1e-9, 1.0, 1e9, 1e149):
        (up, down), seen = camera.project(metres * np.array([[0, -1.0, 0], [0, 1.0, 0]]))
        assert seen.all()
        assert (up[1], down[1]) == (0, 32)
    for row, y in ((0, -1), (32, 1)):
        rays = camera.unproject(np.stack([np.arange(65.0), np.full(65, row)], axis=-1))
        assert rays.valid.all()
        np.testing.assert_allclose(rays.directions, [(0, y, 0)] * 65, rtol=0, atol=1e-16)


@every_panorama
@cases(15)
@given(st.floats(-16, 0), st.sampled_from([-1, 1]), st.floats(-1.5, 1.5))
def test_the_seam(name, parameters, exponent, side, elevation):
    """Behind the camera: a hair to the left is the left border, a hair to the right the right one."""
    camera = cameras.create(name, width=64, height=32, **parameters)
    aside = side * 10**exponent
    level = np.cos(elevation)
    point = [level * np.sin(aside), -np.sin(elevation), -level * np.cos(aside)]
    pixel, seen = camera.project(point)
    assert seen
    expected = aside / (2 * np.pi) * 64
    assert pixel[0] == pytest.approx(64 - expected if side > 0 else -expected, abs=1e-12)
