"""Growth of time and memory with image size, poses, cameras at one viewpoint, and viewpoints."""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from omniscv.cameras import create
from omniscv.chart import drawing
from omniscv.chart.drawing import COLORS, INK, MARKERS
from omniscv.compose.renderer import Renderer
from omniscv.geometry import Pose
from omniscv.planning import RenderOptions
from omniscv.sources.base import Capture, Request, Source, SourceWrapper
from omniscv.sources.scene import open_scene

TITLE = "Time and memory against size, poses, cameras at a place, and viewpoints"
QUICK = {"width": 64, "most": 2}

_MODES = ("lit", "depth")
_TRACED_PX = 128
_MOST = 128
_POSE = Pose.from_angles((0.1, -0.2, 1.45), yaw_deg=20.0)


@dataclass(frozen=True)
class Row:
    """One job in its own process.

    Attributes:
        series: the quantity that grows.
        count: its value: megapixels, or a number of things.
        cpu_s: processor time of all cores for planning and composing; captures cost nothing.
        peak_mb: peak memory of the process.
        idle_mb: peak memory before the job, with everything imported and compiled.
    """

    series: str
    count: float
    cpu_s: float
    peak_mb: float
    idle_mb: float


class _RepeatedCaptures(SourceWrapper):
    """Captures of any size that cost next to nothing: one small view per orientation, its pixels repeated."""

    def __init__(self, source: Source) -> None:
        super().__init__(source)
        self._captures: dict[Request, Capture] = {}

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        for request in requests:
            view = request.view
            pose = Pose(_POSE.position, view.pose.rotation)
            small = replace(request, view=replace(view, pose=pose, width=_TRACED_PX, height=_TRACED_PX))
            if small not in self._captures:
                (self._captures[small],) = self._source.capture([small])
            rows, columns = (np.arange(n) * _TRACED_PX // n for n in (view.height, view.width))
            yield Capture(request, view, self._captures[small].pixels[np.ix_(rows, columns)])


def _sizes(renderer: Renderer, width: int, count: int) -> float:
    """Compose one panorama from six faces of a quarter of its width; return its megapixels."""
    wide = 2 * round(width * (count / _MOST) ** 0.5 / 2)
    camera = create("equirectangular", width=wide, height=wide // 2)
    renderer.render(camera, _POSE, _MODES, RenderOptions("cube", face_size=max(wide // 4, 8)))
    return camera.width * camera.height / 1e6


def _poses(renderer: Renderer, width: int, count: int) -> float:
    """Compose panoramas at ``count`` positions, each in another orientation."""
    camera = create("equirectangular", width=width // 16, height=width // 32)
    for i in range(count):
        pose = Pose.from_angles((0.01 * i, 0, 1.5), yaw_deg=3.7 * i)
        renderer.render(camera, pose, _MODES, RenderOptions("cube", face_size=max(width // 64, 8)))
    return count


def _cameras(renderer: Renderer, width: int, count: int) -> float:
    """Compose ``count`` fisheye images of one viewpoint and instant."""
    size = {"width": width // 32, "height": width // 32}
    images = [(create("fisheye-equidistant", **size, fov_deg=170 + i / 4), _POSE) for i in range(count)]
    for _ in renderer.render_together(images, _MODES, RenderOptions("cube", face_size=max(width // 64, 8))):
        pass
    return count


def _viewpoints(renderer: Renderer, width: int, count: int) -> float:
    """Compose one non-central panorama captured from ``count`` optical centres.

    Its circle is so small that no rays are marched: their cost grows with pixels.
    """
    camera = create("noncentral-panorama", width=width // 16, height=width // 32, radius=0.04)
    options = RenderOptions("cube", viewpoints=count, face_size=max(width // 64, 8))
    renderer.render(camera, _POSE, _MODES, options)
    return count


SIZE = "Mpx of the image"
SERIES: dict[str, Callable[[Renderer, int, int], float]] = {
    SIZE: _sizes,
    "poses": _poses,
    "cameras at a place": _cameras,
    "viewpoints": _viewpoints,
}


def measure(
    width: int = 16384,
    most: int = _MOST,
    progress: Callable[[int, int], None] | None = None,
    series: Sequence[str] | None = None,
) -> list[Row]:
    """Measure every job in its own process.

    Args:
        width: of the largest panorama, px; images of other jobs are proportional.
        most: ratio of the largest job to the smallest; powers of two up to it are measured.
        progress: called with (jobs done, jobs in total).
        series: some of :data:`SERIES`; all if not given.
    """
    counts = [1 << k for k in range(int(np.log2(most)) + 1)]
    largest = _MOST // counts[-1]  # sizes are fractions of the largest
    jobs = [
        (name, width, count * (largest if name == SIZE else 1))
        for name in series or SERIES
        for count in counts
    ]
    rows = []
    for job in jobs:
        with ProcessPoolExecutor(1, get_context("spawn")) as alone:
            rows.append(alone.submit(_measured, *job).result())
        if progress:
            progress(len(rows), len(jobs))
    return rows


def _measured(series: str, width: int, count: int) -> Row:
    """Run one job, after two of the smallest."""
    with open_scene("scene://four-wall") as scene:
        source, job = _RepeatedCaptures(scene), SERIES[series]
        for few in (1, 2):
            job(Renderer(source), min(width, 1024), few)
        idle_mb = _peak_mb()
        started = time.process_time()
        measured = job(Renderer(source), width, count)
        return Row(series, measured, time.process_time() - started, _peak_mb(), idle_mb)


def _peak_mb() -> float:
    """Return the peak memory of this process, without that of its parent before the start."""
    status = Path("/proc/self/status")
    if status.exists():
        (line,) = [line for line in status.read_text().splitlines() if line.startswith("VmHWM")]
        return int(line.split()[1]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (
        1 << (20 if sys.platform == "darwin" else 10)
    )


def slope(rows: Sequence[Row], quantity: str) -> float:
    """Return the slope of a series on logarithmic axes by least squares: 1 if twice as much costs twice.

    Only the last two doublings count: constant costs dominate small jobs.
    """
    most = max(row.count for row in rows)
    rows = [row for row in rows if row.count > most / 5]
    counts, values = [row.count for row in rows], [getattr(row, quantity) for row in rows]
    return float(np.polyfit(np.log(counts), np.log(values), 1)[0])


def write(rows: Sequence[Row], out: Path) -> list[Path]:
    """Write the measurements and draw them: ``chart-growth`` as JSON, SVG and PNG."""
    figure, (seconds, memory) = drawing.figure(2, 4.4, finding(rows))
    panels = (seconds, "CPU seconds", "cpu_s"), (memory, "peak memory, MB", "peak_mb")
    for axes, unit, quantity in panels:
        axes.set(xscale="log", yscale="log")
        for series, color, marker in zip(SERIES, COLORS, MARKERS, strict=False):
            group = [row for row in rows if row.series == series]
            text = f"{series}: slope {round(slope(group, quantity), 2) + 0.0:.2f}"
            counts, values = [row.count for row in group], [getattr(row, quantity) for row in group]
            axes.plot(counts, values, marker + "-", color=color, lw=1.2, ms=5, label=text)
        for axis in (axes.xaxis, axes.yaxis):
            drawing.plain(axis, (1,))
        axes.margins(y=0.12)
        axes.grid(True, which="major", color="#d5d9e0", lw=0.5, zorder=0)
        axes.tick_params(labelsize=8, colors=INK)
        axes.set_xlabel("how many, or megapixels", size=9)
        axes.set_ylabel(unit, size=9)
        axes.legend(fontsize=7.5, loc="upper left", framealpha=0.9)
    for axes, room in ((memory, 4), (seconds, 6)):  # for the legend
        low, high = axes.get_ylim()
        axes.set_ylim(low, high * room)
    return drawing.write(rows, figure, out, "chart-growth")


def finding(rows: Sequence[Row]) -> str:
    """Return the title, which states the result."""
    by = {series: [row for row in rows if row.series == series] for series in SERIES}
    slopes = [slope(mine, "cpu_s") for mine in by.values()]
    largest = max(by[SIZE], key=lambda row: row.count)
    flat = [series for series in list(SERIES)[1:] if slope(by[series], "peak_mb") < 0.2]
    more = f"; more {' or '.join(flat)} take no more memory" if flat else ""
    return (
        f"Twice as much takes about twice the time, or less (slopes {min(slopes):.2f} to {max(slopes):.2f}); "
        f"{largest.count:.0f} Mpx take {largest.peak_mb / 1024:.1f} GB{more}"
    )
