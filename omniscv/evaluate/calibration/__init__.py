"""The evaluation ``calibration``: r_vl from the images of straight lines, for six models of cameras.

For ten values of r_vl the parameter is estimated from five images each, and their mean compared with the
truth: from exact points of lines, from noisy ones, and from edges found in rendered rooms, where the
algorithm knows only the picture, its middle and the model. The paper's section Uncalibtoolbox.
"""

from collections.abc import Iterator, Sequence
from itertools import chain, product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from omniscv.cameras import Camera
from omniscv.compose.renderer import Renderer
from omniscv.evaluate import COLORS, INK, Figure, Report, Row, Settings, chart
from omniscv.evaluate.calibration.estimation import LineImages, calibrate, find_edges, group_by_line, models
from omniscv.geometry import Pose
from omniscv.geometry.pose import Array
from omniscv.planning import RenderOptions
from omniscv.sources.registry import open_source

OPTIONS: frozenset[str] = frozenset()

Triple = tuple[float, float, float]

NOISE_PX = 0.5
_LINES = 8
_POINTS = 60
_LEAST_NZ = 0.15
_SOUGHT = (0.3, 2.0)  # bounds of r_vl, in units
_LEAST_SHARE = 0.1  # number of points of a line, in units
_VIEWPOINTS: tuple[tuple[str, Triple, Triple], ...] = (
    ("scene://four-wall", (0.3, -0.4, 1.5), (35, -20, 10)),
    ("scene://four-wall", (-0.4, 0.3, 1.2), (160, 15, -12)),
    ("scene://four-wall", (0.2, -0.5, 1.7), (-70, -10, 20)),
    ("scene://six-wall", (0.0, 0.2, 1.4), (20, 20, 8)),
    ("scene://six-wall", (-0.3, -0.2, 1.6), (-130, -15, -15)),
)
"""Scenes, positions in metres, and yaw, pitch, roll in degrees of the axis that the image's middle sees."""

_MARKERS = "osD^vX"
_TOLERANCE_PERCENT = 2.0  # shaded in the chart


class Extent(NamedTuple):
    """Sizes and numbers of images.

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
        """Bounds of r_vl, px."""
        return _SOUGHT[0] * self.unit_px, _SOUGHT[1] * self.unit_px


_FULL = Extent(512, tuple(np.linspace(0.55, 1.45, 10).round(2).tolist()), 5)
_QUICK = Extent(384, (0.6, 1.0, 1.4), 1)


def evaluate(settings: Settings) -> Report:
    """Calibrate, and compare with the truth; all images show a source that is given."""
    extent = _QUICK if settings.quick else _FULL
    cases = list(product(models(extent.unit_px).values(), extent.values))
    steps = chain(_from_points(cases, extent), _from_images(cases, extent, settings.source))
    rows = list[Row]()
    for done, estimates in enumerate(steps, start=1):
        rows += estimates
        settings.progress(done, len(cases) * (1 + extent.images))
    about = {"unit_px": extent.unit_px, "noise_px": NOISE_PX, "lines": _LINES, "points_of_a_line": _POINTS}
    return Report(figures(rows), rows, about, [draw(rows, settings.out / "calibration.png")])


def figures(rows: Sequence[Row]) -> list[Figure]:
    """Return, for each kind of input and each model, the largest error of the means of the images."""
    largest = []
    for source, model in dict.fromkeys((row["input"], row["model"]) for row in rows):
        value, mean, _ = means_of(rows, source, model).T
        count = sum(row["input"] == source and row["model"] == model for row in rows)
        worst = float(np.abs(100 * (mean / value - 1)).max())
        largest.append(Figure(f"r_vl error, {model}, {source}", worst, "%", n=count))
    return largest


def means_of(rows: Sequence[Row], source: str, model: str) -> Array:
    """Return (V, 3) r_vl, mean and standard deviation of its estimates, in units; NaN where one failed.

    Args:
        rows: of all estimates.
        source: the kind of input: ``exact``, ``noisy`` or ``rendered``.
        model: its name.
    """
    estimates: dict[float, list[float]] = {}
    for row in rows:
        if row["input"] == source and row["model"] == model:
            estimates.setdefault(row["r_vl"], []).append(row["estimate"])
    means = []
    for r_vl, of_r_vl in estimates.items():
        means.append((r_vl, np.mean(of_r_vl), np.std(of_r_vl)))
    return np.array(means)


def line_points(camera: Camera, rng: np.random.Generator) -> list[Array]:
    """Return points, (60, 2) px from the image's middle, of eight lines that a ``camera`` sees.

    The planes of the lines are drawn by ``rng``.
    """
    lines = list[Array]()
    while len(lines) < _LINES:
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
            spaced = np.linspace(0, seen.sum() - 1, _POINTS).astype(int)
            lines.append(pixels[seen][spaced] - camera.center)
    return lines


def calibrate_image(
    renderer: Renderer, camera: Camera, pose: Pose, model: LineImages, extent: Extent, options: RenderOptions
) -> float:
    """Return r_vl, px, from a rendered image. Of the camera only the image's middle is used.

    Args:
        renderer: of the scene.
        camera: of the image.
        pose: of the camera, world frame.
        model: of the camera.
        extent: sizes, and bounds of r_vl.
        options: of the image.
    """
    image = renderer.render(camera, pose, ("lit",), options)
    chains = []
    for pixels in find_edges(image["lit"], image.valid):
        chains.append(pixels - camera.center)
    lines = group_by_line(chains, model, extent.sought, int(_LEAST_SHARE * extent.unit_px))
    return calibrate(lines, model, *extent.sought)


def _from_points(cases: Sequence[tuple[LineImages, float]], extent: Extent) -> Iterator[list[Row]]:
    """Yield the estimates of a case from exact and from noisy points of lines."""
    rng = np.random.default_rng(0)
    for model, value in cases:
        rows = []
        for image in range(extent.images):
            exact = line_points(model.camera(2 * extent.unit_px, value * extent.unit_px), rng)
            noisy = []
            for points in exact:
                noisy.append(points + NOISE_PX * rng.normal(size=points.shape))
            for source, lines in (("exact", exact), ("noisy", noisy)):
                estimate = calibrate(lines, model, *extent.sought)
                rows.append(_row(source, model, value, image, estimate, extent))
        yield rows


def _from_images(
    cases: Sequence[tuple[LineImages, float]], extent: Extent, source: str | None
) -> Iterator[list[Row]]:
    """Yield estimates from pictures of rooms. All cameras of a viewpoint share its captures."""
    options = RenderOptions(strategy="cube", face_size=2 * extent.unit_px)
    for image, (address, position, angles) in enumerate(_VIEWPOINTS[: extent.images]):
        with open_source(source or address) as opened:
            renderer = Renderer(opened)
            for model, value in cases:
                camera = model.camera(2 * extent.unit_px, value * extent.unit_px)
                pose = facing(camera, position, angles)
                estimate = calibrate_image(renderer, camera, pose, model, extent, options)
                yield [_row("rendered", model, value, image, estimate, extent)]


def facing(camera: Camera, position: Triple, angles: Triple) -> Pose:
    """Return the pose of a ``camera``, world frame, in which the image's middle sees in a given direction.

    ``position`` is in metres, ``angles`` are yaw, pitch and roll of the direction, degrees. The middle of a
    mirror's image sees backwards.
    """
    yaw, pitch, roll = angles
    if camera.unproject(camera.center + 0.5).directions[2] < 0:
        yaw = yaw + 180
        pitch = -pitch
        roll = -roll
    return Pose.from_angles(position, yaw, pitch, roll)


def _row(source: str, model: LineImages, value: float, image: int, estimate: float, extent: Extent) -> Row:
    units = estimate / extent.unit_px
    row = {"input": source, "model": model.name, "r_vl": value, "image": image}
    return row | {"estimate": units, "error_percent": 100 * (units / value - 1)}


def draw(rows: Sequence[Row], path: Path) -> Path:
    """Draw the paper's plot for rendered images: estimated over true r_vl, and the error; return ``path``.

    Dots are means of a value's images, bars their standard deviations. ``rows`` are those of all estimates.
    """
    rendered = [row for row in rows if row["input"] == "rendered"]
    names = list(dict.fromkeys(row["model"] for row in rendered))
    values = [row["r_vl"] for row in rendered]
    ends = [min(values) - 0.1, max(values) + 0.1]
    with chart(path, 1000, 480) as drawing:
        axes, errors = drawing.subplots(1, 2, width_ratios=(1, 1.15))
        axes.plot(ends, ends, color=INK, lw=1, label="truth")
        errors.axhspan(-_TOLERANCE_PERCENT, _TOLERANCE_PERCENT, color="#9aa3b2", alpha=0.2, lw=0)
        errors.axhline(0, color=INK, lw=1)
        for number, name in enumerate(names):
            true, mean, spread = means_of(rows, "rendered", name).T
            style: dict[str, Any] = {"color": COLORS[number], "marker": _MARKERS[number], "ms": 5, "ls": ""}
            style |= {"capsize": 2, "elinewidth": 1}
            axes.errorbar(true, mean, spread, label=name, **style)
            shifted = true + 0.008 * (number - (len(names) - 1) / 2)
            errors.errorbar(shifted, 100 * (mean / true - 1), 100 * spread / true, **style)
        unit = "image circle's radius"
        axes.set(xlabel=f"true $r_{{vl}}$ / {unit}", ylabel=f"estimated $r_{{vl}}$ / {unit}", aspect="equal")
        errors.set(xlabel=f"true $r_{{vl}}$ / {unit}", ylabel="error of the mean, %")
        errors.set_title(f"grey: within {_TOLERANCE_PERCENT:g} %; bars: standard deviation", size=9)
        axes.legend(fontsize=8)
        for panel in (axes, errors):
            panel.grid(True, lw=0.4, alpha=0.5)
        drawing.suptitle(_title(rendered, len(names)), size=11)
    return path


def _title(rendered: Sequence[Row], model_count: int) -> str:
    """Return the title of the chart: the largest error, and the number of images a value."""
    images = 1 + max(row["image"] for row in rendered)
    largest = [figure.value for figure in figures(rendered)]
    worst = max(largest, key=lambda value: (np.isnan(value), value))
    finding = f"Lines in rendered rooms give r_vl within {worst:.1f} % for {model_count} camera models"
    if not np.isfinite(worst):
        finding = "Lines in rendered images do not give r_vl everywhere"
    counted = f"{images} images" if images > 1 else f"{images} image"
    return f"{finding}\n({counted} a value)"
