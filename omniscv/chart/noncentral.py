"""Work against accuracy of non-central cameras: strategies and numbers of centres, measured and drawn."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mock_server import Hits, load_scene
from omniscv.cameras import Camera, create
from omniscv.captures.view import View
from omniscv.chart import pareto
from omniscv.chart.truth import TracedSource, traced, traced_mean
from omniscv.geometry import Array, Pose
from omniscv.render import render

WAYS: tuple[tuple[str, int | None], ...] = (
    ("cube", None),
    *(("faces", count) for count in (4, 16, 64, None)),
    ("strips", None),
    *(("reproject", count) for count in (2, 4, 8, 16)),
    *(("adaptive", count) for count in (2, 4, 8)),
)
"""Strategies and their optical centres; None: one per column or ring."""

LATENCIES_MS = (0, 5, 30)
DEFAULT = ("strips", None)

_POSE = Pose.from_angles((0.0, 0.0, 1.5), yaw_deg=20.0)
_MODES = ("lit", "object_mask", "depth")
_KEPT = 16
_LEAST = 1e-5  # an error of 0 is drawn here


@dataclass(frozen=True)
class Row:
    """One way to make one camera's image.

    Attributes:
        views: pictures captured, each in three modes; ``requests`` are views times modes.
        megapixels: captured, in one mode.
        wrong: part of the valid pixels whose label differs or whose depth is off by more than 1 %.
        unsure: part of the valid pixels that are marked.
        psnr_db: lit against the mean colour of each pixel.
        compose_s: planning and composing, without the captures.
        seconds: with each request answered after so many milliseconds, one after another.
    """

    camera: str
    strategy: str
    viewpoints: int | None
    default: bool
    views: int
    requests: int
    megapixels: float
    wrong: float
    unsure: float
    psnr_db: float
    compose_s: float
    seconds: dict[int, float]


def cameras(width: int) -> dict[str, Camera]:
    """The cameras that are charted, at a width."""
    square = {"width": width // 2, "height": width // 2}
    return {
        "panorama": create("noncentral-panorama", width=width, height=width // 2, radius=1.0),
        "ball": create("noncentral-spherical-mirror", **square, mirror_radius=0.3, distance=0.3, fov_deg=280),
        "cone": create("noncentral-conical-mirror", **square, half_angle_deg=55.0, distance=0.3),
    }


def measure(width: int = 384, progress: Callable[[int, int], None] | None = None) -> list[Row]:
    """Measures every way in the four-wall room.

    Args:
        width: of the panorama, px; mirrors are half as wide.
        progress: called with (images done, images in all).
    """
    scene = load_scene("four-wall")
    rows: list[Row] = []
    for name, camera in cameras(width).items():
        hits, mean = traced(scene, camera, _POSE), traced_mean(scene, camera, _POSE)
        for strategy, viewpoints in WAYS:
            rows.append(_measured(name, camera, strategy, viewpoints, hits, mean))
            if progress:
                progress(len(rows), 3 * len(WAYS))
    return rows


class _Counting(TracedSource):
    """Traces, and tells how long that took; keeps the last few views for their other modes."""

    def __init__(self) -> None:
        super().__init__(load_scene("four-wall"), lit=np.uint8)
        self.pixels, self.tracing_s = 0, 0.0

    def _trace(self, view: View) -> dict[str, NDArray[Any]]:
        started = time.perf_counter()
        if len(self._kept) >= _KEPT:
            del self._kept[next(iter(self._kept))]
        made = super()._trace(view)
        self.pixels += view.width * view.height
        self.tracing_s += time.perf_counter() - started
        return made


def _measured(
    name: str, camera: Camera, strategy: str, viewpoints: int | None, hits: Hits, mean: Array
) -> Row:
    source = _Counting()
    started = time.perf_counter()
    image = render(camera, _POSE, source, _MODES, strategy=strategy, viewpoints=viewpoints)
    compose_s = time.perf_counter() - started - source.tracing_s
    valid = image.valid & np.isfinite(mean).all(axis=-1)
    assert image.depth is not None
    assert image.lit is not None
    right = (image.labels == hits.label) & (np.abs(image.depth - hits.distance) <= 0.01 * hits.distance)
    off = (image.lit.astype(np.float64) / 255 - mean)[valid]
    unsure = image.layers.unsure
    requests = source.made * len(_MODES)
    return Row(
        name,
        strategy,
        viewpoints,
        default=(strategy, viewpoints) == DEFAULT,
        views=source.made,
        requests=requests,
        megapixels=source.pixels / 1e6,
        wrong=float(1 - right[valid].mean()),
        unsure=0.0 if unsure is None else float(unsure[valid].mean()),
        psnr_db=float(-10 * np.log10((off**2).mean())),
        compose_s=compose_s,
        seconds={latency: compose_s + requests * latency / 1e3 for latency in LATENCIES_MS},
    )


def write(rows: list[Row], out: Path) -> list[Path]:
    """Writes the measurements and draws them: ``chart-noncentral.json`` and ``chart-noncentral.png``."""
    out.mkdir(parents=True, exist_ok=True)
    data, picture = out / "chart-noncentral.json", out / "chart-noncentral.png"
    data.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n", encoding="utf-8")
    _draw(rows, picture)
    return [data, picture]


def _draw(rows: list[Row], path: Path) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    def wrong(row: Row) -> float:
        return max(row.wrong, _LEAST)

    panels: list[tuple[str, Callable[[Row], float], str, Callable[[Row], float]]] = [
        ("requests", lambda row: float(row.requests), "wrong label or depth, part", wrong),
        (
            "requests",
            lambda row: float(row.requests),
            "lit: rms error",
            lambda row: 10 ** (-row.psnr_db / 20),
        ),
        *(
            (f"seconds at {latency} ms a request", _seconds(latency), "wrong label or depth, part", wrong)
            for latency in LATENCIES_MS
        ),
    ]
    names = list(dict.fromkeys(row.camera for row in rows))
    figure = Figure(figsize=(3.6 * len(panels), 3.2 * len(names)), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(names), len(panels), squeeze=False)
    for name, line in zip(names, grid, strict=True):
        for (x_label, cost, y_label, error), axes in zip(panels, line, strict=True):
            pareto.draw(
                axes,
                [row for row in rows if row.camera == name],
                cost=cost,
                error=error,
                kind=lambda row: row.strategy,
                label=lambda row: "all" if row.viewpoints is None else str(row.viewpoints),
                is_default=lambda row: row.default,
            )
            axes.set_title(f"{name}: {y_label}", size=8)
            axes.set_xlabel(x_label, size=7)
            axes.tick_params(labelsize=6, which="both")
    grid[0][0].legend(fontsize=7)
    figure.suptitle(
        "Work against accuracy: strategies and optical centres (at the dots); ringed: the default", size=10
    )
    figure.savefig(path)


def _seconds(latency: int) -> Callable[[Row], float]:
    return lambda row: row.seconds[latency]
