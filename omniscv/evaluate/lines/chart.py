"""Pictures of reconstructed lines: their errors over the effective baseline, and the segments in the room."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from omniscv.compose.image import OmniImage
from omniscv.evaluate.report import BLUE, GREEN, INK, RED, Row, chart
from omniscv.geometry.pose import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLORS = {"free": RED, "gravity": BLUE, "Manhattan": GREEN}
_MARKERS = {"vertical": "^", "horizontal": "o", "oblique": "D"}
_LIMITS = {"distance_m": (1e-3, 10.0), "direction_deg": (1e-3, 90.0)}
_MOST_POINTS = 10000


class Segment(NamedTuple):
    """A reconstructed segment.

    Attributes:
        ends_c: (2, 3) metres, camera frame.
        true_w: (2, 3) metres, world frame, the ends of the true edge.
        pixels: (N, 2) px of the image that show it.
    """

    ends_c: Array
    true_w: Array
    pixels: Array


def draw_errors(rows: Sequence[Row], path: Path) -> None:
    """Draw the errors over the effective baseline."""
    groups: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["prior"], row["kind"], row["camera"]), []).append(row)
    labels = {"distance_m": "largest distance, m", "direction_deg": "direction, deg"}
    with chart(path, 1000, 480) as drawing:
        panels = drawing.subplots(1, 2)
        for axes, (key, label) in zip(panels, labels.items(), strict=True):
            for (prior, kind, camera), mine in groups.items():
                values = np.clip([row[key] for row in mine], *_LIMITS[key])
                face = _COLORS[prior] if camera == "panorama" else "none"
                style = {"fc": face, "ec": _COLORS[prior], "marker": _MARKERS[kind]}
                axes.scatter([row["baseline_m"] for row in mine], values, s=28, lw=0.9, **style)
            axes.set(xscale="log", yscale="log", xlabel="effective baseline, m", ylabel=label)
            axes.xaxis.set_major_formatter("{x:g}")
            axes.xaxis.set_minor_formatter("")
            axes.yaxis.set_major_formatter("{x:g}")
            axes.grid(True, which="both", lw=0.4, alpha=0.4)
        for prior, color in _COLORS.items():
            panels[0].scatter([], [], s=28, c=color, label=prior, lw=0)
        for kind in dict.fromkeys(kind for _, kind, _ in groups):
            panels[0].scatter([], [], s=28, c=INK, marker=_MARKERS[kind], label=f"{kind} edge", lw=0)
        panels[0].scatter([], [], s=28, fc="none", ec=INK, label="outlined: conical mirror", lw=0.9)
        panels[0].legend(fontsize=8)
        panels[1].set_title("what is beyond an axis is drawn at its end", size=9)
        finding = "Lines from one non-central image need baseline; gravity makes up for much of it"
        drawing.suptitle(finding, size=11)


def draw_cloud(image: OmniImage, segments: Sequence[Segment], path: Path) -> None:
    """Draw the image with its edges, and three views of the segments among the true points.

    As in the paper: segments red, truth black, optical centres blue.
    """
    points = image.points()
    points = points[:: -(-len(points) // _MOST_POINTS)]
    views = (("from above and beside", 35.0, 30.0), ("from above", 0.0, 90.0), ("from beside", 0.0, 0.0))
    with chart(path, 1000, 800) as drawing:
        grid = drawing.add_gridspec(2, 3, height_ratios=(1.15, 1))
        axes = drawing.add_subplot(grid[0, :])
        axes.imshow(image["lit"], extent=(0, image.camera.width, image.camera.height, 0))
        for segment in segments:
            axes.plot(*segment.pixels.T, ".", color=RED, ms=1.5)
        axes.set_axis_off()
        axes.set_title("edges between walls, floor and ceiling, from labels", size=9)
        for i, (title, turn_deg, lift_deg) in enumerate(views):
            axes = drawing.add_subplot(grid[1, i])
            _draw_view(axes, image, points, segments, _projection(turn_deg, lift_deg))
            axes.set_title(title, size=9)
        finding = f"{len(segments)} edges of a room, reconstructed from one image, among its true points"
        drawing.suptitle(finding, size=11)


def _draw_view(
    axes: Axes, image: OmniImage, points_w: Array, segments: Sequence[Segment], projection: Array
) -> None:
    axes.plot(*projection @ points_w.T, ".", color=INK, ms=0.5, alpha=0.25)
    centers = np.unique(np.round(image.centers_w.reshape(-1, 3), 6), axis=0)
    axes.plot(*projection @ centers.T, ".", color=BLUE, ms=1.5)
    up = image.pose.position + np.array([[0, 0, 0], [0, 0, 0.8]])
    axes.plot(*projection @ up.T, "-", color=GREEN, lw=1.5)
    for segment in segments:
        axes.plot(*projection @ segment.true_w.T, "-", color=INK, lw=2.5, alpha=0.6)
        axes.plot(*projection @ image.pose.to_world(segment.ends_c).T, "-", color=RED, lw=1.5)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=7)
    axes.set_xlabel("m", size=7)


def _projection(turn_deg: float, lift_deg: float) -> Array:
    """(2, 3) a parallel projection of world points: seen from -Y, turned about Z, and lifted."""
    turn, lift = np.radians([turn_deg, lift_deg])
    right = np.array([np.cos(turn), np.sin(turn), 0.0])
    back = np.array([-np.sin(turn), np.cos(turn), 0.0])
    return np.array([right, np.sin(lift) * back + np.cos(lift) * np.array([0.0, 0.0, 1.0])])
