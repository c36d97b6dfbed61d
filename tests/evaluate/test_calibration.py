"""r_vl from the images of lines: exact, noisy, and found in pictures; and the formulas of line images."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import omniscv
from omniscv.evaluate import Settings, run
from omniscv.evaluate import calibration as calibration
from omniscv.evaluate.calibration.estimation import calibrate, find_edges, group_by_line, models

UNIT = 512
MODELS = models(UNIT)
NAMES = sorted(MODELS)
SOUGHT = (0.3 * UNIT, 2.0 * UNIT)


def points_of(name, value, seed):
    camera = MODELS[name].camera(2 * UNIT, value * UNIT)
    return calibration.line_points(camera, np.random.default_rng(seed))


def estimate(lines, name):
    return calibrate(lines, MODELS[name], *SOUGHT) / UNIT


@pytest.mark.parametrize(("name", "value"), [*zip(NAMES, (0.57, 0.73, 0.89, 1.05, 1.21, 1.43), strict=True)])
def test_exact_points_give_r_vl(name, value):
    assert estimate(points_of(name, value, 1), name) == pytest.approx(value, rel=1e-6)


@pytest.mark.parametrize("name", ["equi-solid", "hyper-catadioptric"])
def test_noisy_points_give_r_vl(name):
    value = 0.85
    rng = np.random.default_rng(2)
    estimates = []
    for seed in range(2):
        lines = points_of(name, value, seed)
        noisy = [line + rng.normal(scale=0.5, size=line.shape) for line in lines]
        estimates.append(estimate(noisy, name))
    assert np.mean(estimates) == pytest.approx(value, rel=5e-3)


def test_curves_other_than_lines_are_ignored_and_radial_ones_alone_give_nan():
    turn = np.linspace(0, 5, 60)
    circle = np.column_stack([np.cos(turn), np.sin(turn)])
    places = (100, 90, 60), (-200, 50, 90), (40, -220, 45)
    lines = [*points_of("equi-angular", 0.8, 3), *((x, y) + size * circle for x, y, size in places)]
    assert estimate(lines, "equi-angular") == pytest.approx(0.8, rel=1e-3)
    radial = [np.outer(np.linspace(50, 400, 40), (np.cos(a), np.sin(a))) for a in (0.3, 1.1, 2.0)]
    assert np.isnan(estimate(radial, "stereographic"))
    assert np.isnan(estimate([], "stereographic"))


def polygon(corners, size=400):
    """A bright polygon, exact to 1/16 px of its coverage."""
    shown = np.zeros((size * 16, size * 16), np.uint8)
    cv2.fillPoly(shown, [np.round(np.array(corners) * 16 - 0.5).astype(np.int32)], 200)
    grey = shown.reshape(size, 16, size, 16).mean(axis=(1, 3))
    return np.repeat(np.round(20 + grey)[..., None], 3, axis=-1).astype(np.uint8)


CORNERS = [(70.3, 80.7), (310.2, 120.4), (280.9, 330.1), (60.4, 290.6)]


def test_edges_are_found_to_a_part_of_a_pixel_and_break_at_corners():
    chains = [chain for chain in find_edges(polygon(CORNERS), np.ones((400, 400), bool)) if len(chain) > 100]
    assert len(chains) == 4
    for points in chains:
        off = []
        for a, b in zip(np.array(CORNERS), np.roll(CORNERS, -1, axis=0), strict=True):
            along = (b - a) / np.linalg.norm(b - a)
            off.append(np.abs((points - a) @ [-along[1], along[0]]))
        nearest = min(off, key=np.median)
        assert np.median(nearest) <= 0.05
        assert np.sqrt((nearest**2).mean()) <= 0.2  # the corners, which the blur rounds, included


def test_the_rim_of_an_image_circle_is_no_edge():
    row, column = np.mgrid[:300, :300] - 149.5
    circle = np.hypot(row, column) < 120
    lit = np.where(circle[..., None], 180, 0).astype(np.uint8).repeat(3, axis=-1)
    assert sum(map(len, find_edges(lit, circle))) == 0
    assert sum(map(len, find_edges(lit, np.ones_like(circle)))) > 600


def test_points_of_a_chain_are_grouped_by_line():
    lines = points_of("stereographic", 0.9, 4)[:3]
    groups = group_by_line([np.concatenate(lines)], MODELS["stereographic"], SOUGHT, 40)
    assert len(groups) == 3
    for group in groups:
        of = [(np.abs(group[:, None] - line).sum(axis=-1).min(axis=1) < 1e-6).mean() for line in lines]
        assert max(of) >= 0.9


def test_pictures_of_a_room_give_r_vl():
    unit = 256
    value = 0.9
    model = models(unit)["hyper-catadioptric"]
    camera = model.camera(2 * unit, value * unit)
    options = omniscv.RenderOptions(strategy="cube", face_size=384)
    pose = calibration.facing(camera, (0.3, -0.4, 1.5), (35, -20, 10))
    extent = calibration.Extent(unit, (value,), 1)
    with omniscv.open_source("scene://four-wall") as source:
        renderer = omniscv.Renderer(source)
        found = calibration.calibrate_image(renderer, camera, pose, model, extent, options)
    assert found == pytest.approx(value * unit, rel=0.02)


@pytest.mark.soak
def test_the_whole_evaluation_reaches_its_figures(tmp_path):
    report = run("calibration", Settings(tmp_path))
    limits = {"exact": 1e-4, "noisy": 0.5, "rendered": 2.0}  # percent
    assert len(report.figures) == 18
    assert len(report.rows) == 3 * 6 * 10 * 5
    for figure in report.figures:
        assert figure.value <= limits[figure.name.rsplit(", ", 1)[1]], figure
    assert all(path.stat().st_size > 10_000 for path in report.written)


def test_a_figure_is_the_largest_error_of_a_mean_in_which_failed_images_count(tmp_path):
    start = {"input": "rendered", "model": "stereographic"}
    estimates = (0.5, 0.4), (0.5, 0.61), (1.0, 0.9), (1.0, 1.12)
    rows = [{**start, "r_vl": value, "image": i, "estimate": x} for i, (value, x) in enumerate(estimates)]
    (figure,) = calibration.figures(rows)
    assert figure.name == "r_vl error, stereographic, rendered"
    assert (figure.unit, figure.n, figure.paper) == ("%", 4, None)
    assert figure.value == pytest.approx(1.0)
    means = calibration.means_of(rows[2:], "rendered", "stereographic")
    assert means == pytest.approx(np.array([(1.0, 1.01, 0.11)]))
    rows[0]["estimate"] = float("nan")
    assert np.isnan(calibration.figures(rows)[0].value)
    calibration.draw(rows, tmp_path / "chart.png")
    assert cv2.imread(str(tmp_path / "chart.png")).shape == (480, 1000, 3)


SIZE = 1024
VALUES = st.floats(0.5, 1.5).map(lambda value: value * SIZE / 2)


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=10)
@given(v=VALUES, share=st.floats(0.05, 0.98), seed=st.integers(0, 999))
def test_points_of_a_line_are_on_its_image_and_the_slope_is_that_of_alpha(name, v, share, seed):
    most = {"orthogonal": v, "equi-solid": 1.41 * v, "equi-angular": 1.99 * v}.get(name, SIZE / 2)
    r = share * min(most, SIZE / 2)
    model = MODELS[name]
    h = 1e-5 * r
    before, after = (model.alpha(np.array(r + step), v) for step in (-h, h))
    assert model.slope(np.array(r), v) == pytest.approx((after - before) / (2 * h), rel=1e-6, abs=1e-6)
    camera = model.camera(SIZE, v)
    rng = np.random.default_rng(seed)
    start, along = rng.normal(size=(2, 3))
    points = start + np.linspace(-5, 5, 40)[:, None] * along
    pixels, seen = camera.project(points)
    normal = np.cross(start, along) / np.linalg.norm(np.cross(start, along))
    if "catadioptric" in name:  # the image's middle sees -z
        normal[2] = -normal[2]
    x, y = (pixels[seen] - camera.center).T
    value = normal[0] * x + normal[1] * y - normal[2] * model.alpha(np.hypot(x, y), v)
    assert np.abs(value).max(initial=0) <= 1e-8 * v
