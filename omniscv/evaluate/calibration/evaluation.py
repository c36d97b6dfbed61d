"""Calibration from the images of straight lines, for six models: the paper's section Uncalibtoolbox.

For ten values of r_vl the parameter is estimated from five images each, and their mean compared with the
truth: from exact points of lines, from noisy ones, and from edges found in rendered rooms, where the
algorithm is given nothing but the picture, its middle and the kind of camera.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from omniscv.cameras import Camera
from omniscv.compose.renderer import Renderer
from omniscv.evaluate.calibration import chart as calibration_chart
from omniscv.evaluate.calibration.edges import find_edges
from omniscv.evaluate.calibration.estimation import calibrate
from omniscv.evaluate.calibration.grouping import group_lines
from omniscv.evaluate.calibration.line_images import LineImages, models
from omniscv.evaluate.registry import Settings
from omniscv.evaluate.report import Figure, Report
from omniscv.geometry import Pose
from omniscv.geometry.pose import Array
from omniscv.planning import RenderOptions
from omniscv.sources.registry import open_source

OPTIONS: frozenset[str] = frozenset()

Kind = Literal["exact", "noisy", "rendered"]

NOISE_PX = 0.5
_LINES, _POINTS = 8, 60
_LEAST_NZ = 0.15
_SOUGHT = (0.3, 2.0)  # times the unit: where r_vl is looked for
_LEAST_SHARE = 0.1  # of the unit, in points of a line
_PLACES: tuple[tuple[str, tuple[float, float, float], tuple[float, float, float]], ...] = (
    ("scene://four-wall", (0.3, -0.4, 1.5), (35, -20, 10)),
    ("scene://four-wall", (-0.4, 0.3, 1.2), (160, 15, -12)),
    ("scene://four-wall", (0.2, -0.5, 1.7), (-70, -10, 20)),
    ("scene://six-wall", (0.0, 0.2, 1.4), (20, 20, 8)),
    ("scene://six-wall", (-0.3, -0.2, 1.6), (-130, -15, -15)),
)
"""Scenes, positions in metres, and yaw, pitch, roll in degrees of the axis that the image's middle sees."""


class Extent(NamedTuple):
    """How much is done.

    Attributes:
        unit_px: the unit of r_vl: the image circle's radius.
        values: r_vl, in units.
        images: for each of them.
    """

    unit_px: int
    values: Sequence[float]
    images: int

    @property
    def sought(self) -> tuple[float, float]:
        return _SOUGHT[0] * self.unit_px, _SOUGHT[1] * self.unit_px


_FULL = Extent(512, tuple(np.linspace(0.55, 1.45, 10).round(2).tolist()), 5)
_QUICK = Extent(384, (0.6, 1.0, 1.4), 1)

Row = Mapping[str, Any]


def evaluate(settings: Settings) -> Report:
    """Calibrate, and compare with the truth.

    Args:
        settings: with a source, all images are of it, around its origin.

    Raises:
        OmniscvError: of the source.
    """
    extent = _QUICK if settings.quick else _FULL
    cases = [(model, value) for model in models(extent.unit_px).values() for value in extent.values]
    total, done = len(cases) * (1 + extent.images), 0
    rows: list[Row] = []
    rng = np.random.default_rng(0)
    for model, value in cases:
        for image in range(extent.images):
            exact = line_points(model.camera(2 * extent.unit_px, value * extent.unit_px), rng)
            noisy = [each + NOISE_PX * rng.normal(size=each.shape) for each in exact]
            for kind, lines in (("exact", exact), ("noisy", noisy)):
                rows.append(_row(kind, model, value, image, calibrate(lines, model, *extent.sought), extent))
        done += 1
        settings.progress(done, total)
    for row in _rendered(cases, extent, settings.source):
        rows.append(row)
        done += 1
        settings.progress(done, total)
    chart = settings.out / "calibration.png"
    calibration_chart.draw(rows, chart)
    about = {"unit_px": extent.unit_px, "noise_px": NOISE_PX, "lines": _LINES, "points_of_a_line": _POINTS}
    return Report(figures(rows), rows, about, [chart])


def line_points(camera: Camera, rng: np.random.Generator) -> list[Array]:
    """Return points, (60, 2) px from the image's middle, of eight lines that a camera sees."""
    found: list[Array] = []
    while len(found) < _LINES:
        normal = rng.normal(size=3)
        normal /= np.linalg.norm(normal)
        if abs(normal[2]) < _LEAST_NZ:
            continue
        along = np.cross(normal, (1.0, 0.0, 0.3))
        along /= np.linalg.norm(along)
        angle = rng.uniform(0, 2 * np.pi) + np.linspace(0, rng.uniform(0.8, 2.0), 4 * _POINTS)
        points = np.outer(np.cos(angle), along) + np.outer(np.sin(angle), np.cross(normal, along))
        pixels, seen = camera.project(points)
        if seen.sum() >= 2 * _POINTS:
            chosen = np.linspace(0, seen.sum() - 1, _POINTS).astype(int)
            found.append(pixels[seen][chosen] - camera.center)
    return found


def figures(rows: Sequence[Row]) -> list[Figure]:
    """Return, for each kind of input and each model, the largest error of the means of the images."""
    found = []
    for kind, model in dict.fromkeys((row["input"], row["model"]) for row in rows):
        means = means_of(rows, kind, model)
        worst = float(np.max([abs(100 * (mean / value - 1)) for value, mean, _ in means]))
        count = sum(row["input"] == kind and row["model"] == model for row in rows)
        found.append(Figure(f"r_vl error, {model}, {kind}", worst, "%", n=count))
    return found


def means_of(rows: Sequence[Row], kind: Kind, model: str) -> list[tuple[float, float, float]]:
    """Return (r_vl, mean and standard deviation of its estimates), in units, by r_vl; NaN where an image gave
    none."""
    mine = [row for row in rows if row["input"] == kind and row["model"] == model]
    found = []
    for value in dict.fromkeys(row["r_vl"] for row in mine):
        estimates = [row["estimate"] for row in mine if row["r_vl"] == value]
        found.append((value, float(np.mean(estimates)), float(np.std(estimates))))
    return found


def _rendered(cases: Sequence[tuple[LineImages, float]], extent: Extent, source: str | None) -> Iterator[Row]:
    """Estimates from pictures of rooms. All cameras of a place share its captures."""
    options = RenderOptions(strategy="cube", face_size=2 * extent.unit_px)
    for image, (address, position, angles) in enumerate(_PLACES[: extent.images]):
        with open_source(source or address) as opened:
            renderer = Renderer(opened)
            for model, value in cases:
                camera = model.camera(2 * extent.unit_px, value * extent.unit_px)
                pose = _facing(camera, position, angles)
                estimate = calibrated_image(renderer, camera, pose, model, extent, options)
                yield _row("rendered", model, value, image, estimate, extent)


def calibrated_image(
    renderer: Renderer,
    camera: Camera,
    pose: Pose,
    model: LineImages,
    extent: Extent,
    options: RenderOptions,
) -> float:
    """Return r_vl, px, of a rendered image. Of the camera only the image's middle is used."""
    image = renderer.render(camera, pose, ("lit",), options)
    edges = find_edges(image["lit"], image.valid)
    lines = group_lines(edges, camera.center, model, extent.sought, int(_LEAST_SHARE * extent.unit_px))
    return calibrate(lines, model, *extent.sought)


def _facing(camera: Camera, position: tuple[float, float, float], angles: tuple[float, float, float]) -> Pose:
    """The pose in which the image's middle sees in a direction: a mirror's shows what is behind."""
    yaw, pitch, roll = angles
    if camera.unproject(camera.center + 0.5).directions[2] < 0:
        yaw, pitch, roll = yaw + 180, -pitch, -roll
    return Pose.from_angles(position, yaw, pitch, roll)


def _row(kind: str, model: LineImages, value: float, image: int, estimate: float, extent: Extent) -> Row:
    found = estimate / extent.unit_px
    row = {"input": kind, "model": model.name, "r_vl": value, "image": image, "estimate": found}
    return {**row, "error_percent": 100 * (found / value - 1)}
