"""Requests against accuracy of non-central cameras, by strategy and number of optical centres."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from omniscv.cameras import Camera, create
from omniscv.chart import drawing
from omniscv.chart.drawing import COLORS, INK, MARKERS, Dot, Look
from omniscv.chart.truth import traced, traced_mean
from omniscv.compose.image import OmniImage
from omniscv.compose.renderer import render
from omniscv.geometry import Array, Pose
from omniscv.sources.base import Capture, Request, Source, SourceWrapper, View
from omniscv.sources.scene import SceneSource, open_scene

if TYPE_CHECKING:
    from mock_server import Hits

PAPER = "cube"
WAYS: tuple[tuple[str, int | None], ...] = (
    (PAPER, None),
    *(("faces", count) for count in (4, 16, 64, None)),
    *(("strips", count) for count in (4, 16, 64, None)),
    *(("reproject", count) for count in (2, 4, 8, 16)),
    *(("adaptive", count) for count in (2, 4, 8)),
)
"""Strategies and numbers of optical centres; None: one per column or ring. The paper captures cube maps."""

QUICK = {"width": 48}

LATENCIES_MS = (5, 30)
DEFAULT = ("strips", None)

_POSE = Pose.from_angles((0.0, 0.0, 1.5), yaw_deg=20.0)
_MODES = ("lit", "object_mask", "depth")
_KEPT = 16
_LEAST = 1e-5  # an error of 0 is drawn here


@dataclass(frozen=True)
class Row:
    """One way to make one camera's image.

    Attributes:
        views: number of captured views; ``requests``: of captures, over all modes.
        megapixels: captured, in one mode.
        wrong: fraction of the valid pixels whose label differs or whose depth is off by more than 1 %.
        unsure: fraction of the valid pixels that are marked as unsure.
        psnr_db: lit against the mean colour of each pixel.
        compose_s: time of planning and composing, without captures.
        seconds: total time by latency in milliseconds of one request, without parallel requests.
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
    """Return the cameras of the chart, by name."""
    square = {"width": width // 2, "height": width // 2}
    return {
        "panorama": create("noncentral-panorama", width=width, height=width // 2, radius=1.0),
        "ball": create("noncentral-spherical-mirror", **square, mirror_radius=0.3, distance=0.3, fov_deg=280),
        "cone": create("noncentral-conical-mirror", **square, half_angle_deg=55.0, distance=0.3),
    }


def measure(
    width: int = 384,
    progress: Callable[[int, int], None] | None = None,
    face_size: int | Literal["auto"] = "auto",
) -> list[Row]:
    """Measure every strategy in the four-wall room.

    Args:
        width: of the panorama, px; mirrors are half as wide.
        progress: called with (images done, images in total).
        face_size: px of a 90 degree face.
    """
    scene = open_scene("scene://four-wall").scene
    rows: list[Row] = []
    for name, camera in cameras(width).items():
        hits, mean = traced(scene, camera, _POSE), traced_mean(scene, camera, _POSE)
        for strategy, viewpoints in WAYS:
            source = _Counting(SceneSource(scene, cached_views=_KEPT))
            started = time.perf_counter()
            image = render(
                camera, _POSE, source, _MODES, strategy=strategy, viewpoints=viewpoints, face_size=face_size
            )
            compose_s = time.perf_counter() - started - source.seconds
            row = Row(
                name,
                strategy,
                viewpoints,
                default=(strategy, viewpoints) == DEFAULT,
                views=len(source.views),
                requests=source.requests,
                megapixels=sum(view.width * view.height for view in source.views) / 1e6,
                compose_s=compose_s,
                seconds={ms: compose_s + source.requests * ms / 1e3 for ms in LATENCIES_MS},
                **_accuracy(image, hits, mean),
            )
            rows.append(row)
            if progress:
                progress(len(rows), 3 * len(WAYS))
    return rows


class _Counting(SourceWrapper):
    """Counts requests and views, and measures the time of the captures."""

    def __init__(self, source: Source) -> None:
        super().__init__(source)
        self.requests, self.views, self.seconds = 0, set[View](), 0.0

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        captures = self._source.capture(requests)
        while True:
            started = time.perf_counter()
            capture = next(captures, None)
            self.seconds += time.perf_counter() - started
            if capture is None:
                return
            self.requests += 1
            self.views.add(capture.view)
            yield capture


def _accuracy(image: OmniImage, hits: Hits, mean: Array) -> dict[str, float]:
    valid = image.valid & np.isfinite(mean).all(axis=-1)
    near = np.abs(image["depth"] - hits.distance) <= 0.01 * hits.distance
    off = (image["lit"].astype(np.float64) / 255 - mean)[valid]
    return {
        "wrong": float(1 - ((image["labels"] == hits.label) & near)[valid].mean()),
        "unsure": 0.0 if image.unsure is None else float(image.unsure[valid].mean()),
        "psnr_db": float(-10 * np.log10((off**2).mean())),
    }


def write(rows: Sequence[Row], out: Path) -> list[Path]:
    """Write the measurements and draw them, one panel per camera: ``chart-noncentral`` as JSON, SVG and PNG.

    ``reproject`` is not drawn: it is ``adaptive`` without its further rounds.
    """
    drawn = [row for row in rows if row.strategy != "reproject"]
    by_camera = _by_camera(drawn)
    names = list(by_camera)
    dots = {name: [_dot(row, group) for row in group] for name, group in by_camera.items()}
    figure, panels = drawing.figure(len(names), 4.4, finding(rows))
    series = list(dict.fromkeys(row.strategy for row in drawn if row.strategy != PAPER))
    looks = {name: Look(COLORS[i], MARKERS[i], "-") for i, name in enumerate(series)}
    looks[PAPER] = Look(INK, "P", "")
    for name, axes in zip(names, panels, strict=True):
        drawing.dots(axes, dots[name], looks)
        drawing.plain(axes.xaxis, (1, 3))
        axes.xaxis.set_major_formatter(_with_seconds)
        axes.set_title(name, size=10)
    panels[0].set_ylabel("pixels with a wrong label or depth, %", size=9)
    figure.supxlabel("requests; seconds at 5 ms a request; at 30 ms", size=9)
    for name, axes in zip(names, panels, strict=True):
        drawing.label(axes, dots[name], looks)
    return drawing.write(rows, figure, out, "chart-noncentral")


def _dot(row: Row, all_rows: Sequence[Row]) -> Dot:
    """Return a dot; the ends of a curve are labelled with viewpoints, the last also with the strategy."""
    curve = [other for other in all_rows if other.strategy == row.strategy]
    count = "all" if row.viewpoints is None else str(row.viewpoints)
    text = f"{row.strategy} {count}" if curve[-1] is row else count if curve[0] is row else ""
    text = "the paper" if row.strategy == PAPER else text
    return Dot(row.strategy, text, row.requests, 100 * max(row.wrong, _LEAST), row.default)


def _with_seconds(requests: float, position: float = 0.0) -> str:
    """Return the text of a tick: requests, and seconds at each latency."""
    return "\n".join([drawing.number(requests), *(f"{requests * ms / 1e3:.3g} s" for ms in LATENCIES_MS)])


def finding(rows: Sequence[Row]) -> str:
    """Return the title, which states the result."""
    as_true, nearly, worse = [], [], []
    for group in _by_camera(rows).values():
        paper = next(row for row in group if row.strategy == PAPER)
        better = [row.requests for row in group if row.wrong <= paper.wrong and row is not paper]
        as_true.append(paper.requests / min(better, default=paper.requests))
        adaptive = (row for row in group if row.strategy == "adaptive")
        few = min(adaptive, key=lambda row: row.wrong, default=paper)
        nearly.append(paper.requests / few.requests)
        worse.append(100 * (few.wrong - paper.wrong))
    text = f"As true as the paper's full capture with {_span(as_true)} times fewer requests"
    if max(nearly) > 1:
        text += f"; with {_span(nearly)} times fewer, at most {max(worse):.2f} % more of the pixels are wrong"
    return text


def _by_camera(rows: Sequence[Row]) -> dict[str, list[Row]]:
    return {
        name: [row for row in rows if row.camera == name] for name in dict.fromkeys(r.camera for r in rows)
    }


def _span(values: Sequence[float]) -> str:
    return f"{min(values):.0f} to {max(values):.0f}"
