"""Pictures of reconstructed lines: their errors over the effective baseline, and the segments in the room."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from omniscv.compose.image import OmniImage
from omniscv.geometry.pose import Array
from omniscv.storage.local import whole_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLORS = {"free": "#d55e00", "gravity": "#0072b2", "Manhattan": "#009e73"}
_MARKERS = {"vertical": "^", "horizontal": "o", "oblique": "D"}
_INK, _FOUND, _CENTERS, _UP = "#1c2330", "#d55e00", "#0072b2", "#009e73"
_SHOWN = {"distance_m": (1e-3, 10.0), "direction_deg": (1e-3, 90.0)}
_MOST_POINTS = 10000


class Segment(NamedTuple):
    """A reconstructed segment.

    Attributes:
        ends_c: (2, 3) metres, camera frame.
        true_w: (2, 3) metres, world frame, the ends of the true edge.
        pixels: (N, 2) px, where the image shows it.
    """

    ends_c: Array
    true_w: Array
    pixels: Array


def draw_errors(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write the chart of errors over the effective baseline."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4.8), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, 2)
    labels = "largest distance, m", "direction, deg"
    for axes, key, label in zip(panels, ("distance_m", "direction_deg"), labels, strict=True):
        for look in dict.fromkeys(_look(row) for row in rows):
            prior, kind, camera = look
            mine = [row for row in rows if _look(row) == look]
            at = [row["baseline_m"] for row in mine], np.clip([row[key] for row in mine], *_SHOWN[key])
            face = _COLORS[prior] if camera == "panorama" else "none"
            axes.scatter(*at, s=28, fc=face, ec=_COLORS[prior], marker=_MARKERS[kind], lw=0.9)
        axes.set(xscale="log", yscale="log", xlabel="effective baseline, m", ylabel=label)
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter("")
        axes.yaxis.set_major_formatter("{x:g}")
        axes.grid(True, which="both", lw=0.4, alpha=0.4)
    for prior, color in _COLORS.items():
        panels[0].scatter([], [], s=28, c=color, label=prior, lw=0)
    for kind in dict.fromkeys(row["kind"] for row in rows):
        panels[0].scatter([], [], s=28, c=_INK, marker=_MARKERS[kind], label=f"{kind} edge", lw=0)
    panels[0].scatter([], [], s=28, fc="none", ec=_INK, label="outlined: conical mirror", lw=0.9)
    panels[0].legend(fontsize=8)
    panels[1].set_title("what is beyond an axis is drawn at its end", size=9)
    figure.suptitle(
        "Lines from one non-central image need baseline; gravity makes up for much of it", size=11
    )
    with whole_file(path) as part:
        figure.savefig(part)


def _look(row: Mapping[str, Any]) -> tuple[str, str, str]:
    """What a row's dot looks like depends on."""
    return row["prior"], row["kind"], row["camera"]


def draw_cloud(image: OmniImage, segments: Sequence[Segment], path: Path) -> None:
    """Write the image with its edges, and three views of the segments among the true points: as in the
    paper in red the segments, in black the truth, in blue the optical centres."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 8), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 3, height_ratios=(1.15, 1))
    axes = figure.add_subplot(grid[0, :])
    axes.imshow(image["lit"], extent=(0, image.camera.width, image.camera.height, 0))
    for segment in segments:
        axes.plot(*segment.pixels.T, ".", color=_FOUND, ms=1.5)
    axes.set_axis_off()
    axes.set_title("edges between walls, floor and ceiling, from labels", size=9)
    points = image.points()
    points = points[:: -(-len(points) // _MOST_POINTS)]
    views = (("from above and beside", 35.0, 30.0), ("from above", 0.0, 90.0), ("from beside", 0.0, 0.0))
    for i, (title, turn, lift) in enumerate(views):
        axes = figure.add_subplot(grid[1, i])
        _draw_view(axes, image, points, segments, _flattened(turn, lift))
        axes.set_title(title, size=9)
    figure.suptitle(
        f"{len(segments)} edges of a room, reconstructed from one image, among its true points", size=11
    )
    with whole_file(path) as part:
        figure.savefig(part)


def _draw_view(
    axes: Axes, image: OmniImage, points_w: Array, segments: Sequence[Segment], flat: Array
) -> None:
    axes.plot(*flat @ points_w.T, ".", color=_INK, ms=0.5, alpha=0.25)
    centers = np.unique(np.round(image.centers_w.reshape(-1, 3), 6), axis=0)
    axes.plot(*flat @ centers.T, ".", color=_CENTERS, ms=1.5)
    up = image.pose.position + np.array([[0, 0, 0], [0, 0, 0.8]])
    axes.plot(*flat @ up.T, "-", color=_UP, lw=1.5)
    for segment in segments:
        axes.plot(*flat @ segment.true_w.T, "-", color=_INK, lw=2.5, alpha=0.6)
        axes.plot(*flat @ image.pose.to_world(segment.ends_c).T, "-", color=_FOUND, lw=1.5)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=7)
    axes.set_xlabel("m", size=7)


def _flattened(turn_deg: float, lift_deg: float) -> Array:
    """(2, 3) what makes world points a parallel projection: seen from -Y, turned, and lifted."""
    turn, lift = np.radians([turn_deg, lift_deg])
    right = np.array([np.cos(turn), np.sin(turn), 0.0])
    back = np.array([-np.sin(turn), np.cos(turn), 0.0])
    return np.array([right, np.sin(lift) * back + np.cos(lift) * np.array([0.0, 0.0, 1.0])])
