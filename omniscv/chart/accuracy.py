"""Cost against doubt: what is captured, and how much of the image may be wrong, by camera and strategy."""

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes

from omniscv.cameras import Camera, create
from omniscv.chart import Tracer, drawing, traced
from omniscv.chart.drawing import COLORS, INK, MARKERS, MUTED, Dot, Look
from omniscv.chart.failures import wrong_depth
from omniscv.compose.cache import HeldCaptures
from omniscv.compose.renderer import render
from omniscv.geometry import Pose
from omniscv.progress import Steps, counted
from omniscv.render_options import PRICE, Price
from omniscv.sources.base import CapturesAlone, Request, Source
from omniscv.sources.scene import SceneSource, open_scene

QUICK = {"width": 64, "asked": (0.1,)}
PAPER = "the paper"
EXACT = "exact"
ASKED = "accuracy="
DEFAULT = "the default"
AIMS = (0.01, 0.003, 0.001, 0.0003)
MS_REQUEST, MS_MEGAPIXEL = PRICE
LATENCIES_MS = (5, 30)

_SIZES = (0.5, 1, 2, 4, 8)  # of faces, in quarters of the widest image
_Ways = dict[str, list[tuple[str, int | None, float]]]
_CENTRAL: _Ways = {PAPER: [("cube", None, 1)], EXACT: [("exact", None, size) for size in _SIZES]}
_NONCENTRAL: _Ways = {
    PAPER: [("cube", None, 1)],
    EXACT: [("exact", 16, 1), ("exact", 64, 1), ("exact", None, 1), ("exact", None, 2)],
}
"""Strategy, viewpoints and size of the faces of each way, by series."""
_LEAST_NONCENTRAL = 0.001
"""The least aim of cameras with several centres: smaller ones are not reached here."""
_BALL: Any = {"mirror_radius": 0.3, "distance": 0.3, "fov_deg": 280}
_POSE = Pose.from_angles((0.13, -0.21, 1.47), yaw_deg=20.0)
_MODES = ("object_mask", "depth")
_LEAST = 1e-4  # a share of 0 is drawn here
_CHEAPER = 1.5  # times, from which the title says so


@dataclass(frozen=True)
class Row:
    """One way to make one camera's image.

    Attributes:
        viewpoints: None: as many as the strategy takes.
        face_size: px; None: chosen for the aim.
        requests: of captures, in both modes.
        megapixels: captured, in both modes.
        seconds: of capturing by the model: 5 ms a request and 25 ms a megapixel; of a live source measured.
        seconds_at: by the model, by latency, in milliseconds of a request; empty where they are measured.
        doubtful: share of the valid pixels that are marked, or whose depth may be off by more than 1 %.
        wrong: share of the valid pixels whose label differs or whose depth is off by more than 1 %; None
            where the truth is not known.
        compose_s: time of planning and composing, without captures.
        accuracy: share of doubtful pixels that was asked for; None where face size and strategy were given.
    """

    camera: str
    series: str
    viewpoints: int | None
    face_size: int | None
    requests: int
    megapixels: float
    seconds: float
    seconds_at: dict[int, float]
    doubtful: float
    wrong: float | None
    compose_s: float
    accuracy: float | None


def cameras(width: int) -> dict[str, Camera]:
    """Return the cameras of the chart, by name."""
    square = {"width": width // 4, "height": width // 4}
    return {
        "panorama": create("equirectangular", width, width // 2),
        "fisheye": create("fisheye-equidistant", width // 2, width // 2, fov_deg=185),
        "mirror ball": create("noncentral-spherical-mirror", **square, **_BALL),
        "non-central panorama": create("noncentral-panorama", width // 2, width // 4, radius=0.4),
    }


def measure(
    width: int = 512, asked: Sequence[float] = (0.03, *AIMS), progress: Steps | None = None
) -> list[Row]:
    """Measure all cameras in the four-wall room, by every series of strategies and by values of ``accuracy``.

    Args:
        width: of the panorama, px; the other images have a half or a quarter.
        asked: values of ``accuracy``.
        progress: is told how many ways are done; None: nobody.
    """
    scene = open_scene("scene://four-wall").scene
    live = SceneSource(scene, cached_views=1)
    return _measured(cameras(width), _POSE, live, scene, width // 4, asked, progress)


def measure_own(
    name: str,
    camera: Camera,
    pose: Pose,
    source: Source,
    asked: Sequence[float] = (0.03, *AIMS),
    progress: Steps | None = None,
) -> list[Row]:
    """Measure one camera in an open source, by every series of strategies.

    Seconds of capturing are modelled where it traces or replays, else measured; wrong pixels are known where
    it traces. Images are made of captures alone, as rays cannot judge images that are made by them.

    Args:
        name: of the camera, in the chart.
        camera: that is measured.
        pose: of the camera.
        source: an open one.
        asked: values of ``accuracy``.
        progress: is told how many ways are done; None: nobody.
    """
    tracer = source if source.capabilities.traces else None
    face_px = max(32, camera.width // 4)
    return _measured({name: camera}, pose, CapturesAlone(source), tracer, face_px, asked, progress)


def _measured(
    shot: dict[str, Camera],
    pose: Pose,
    live: Source,
    tracer: Tracer | None,
    face_px: int,
    asked: Sequence[float],
    progress: Steps | None,
) -> list[Row]:
    """Return the rows of cameras by name, each in every way; see :func:`measure_own`.

    Args:
        shot: the cameras.
        pose: of each.
        live: the source.
        tracer: has the truth; None where it is not known.
        face_px: size of a face of size 1.
        asked: values of ``accuracy``.
        progress: is told how many ways are done; None: nobody.
    """
    can = live.capabilities
    is_modelled = tracer is not None or can.dialect == "recording"
    ways = []
    truth = {}
    for name, camera in shot.items():
        for series, options in _ways(camera, face_px, asked):
            ways.append((name, camera, series, options))
        if tracer is not None:
            truth[name] = traced(tracer, camera, pose)
    rows: list[Row] = []
    for name, camera, series, options in counted(ways, progress):
        if not can.can_set_size:
            options.pop("face_size", None)
        source = HeldCaptures(live, {}, all_=True)
        render(camera, pose, source, _MODES, **options)
        started = time.perf_counter()
        image = render(camera, pose, source, _MODES, **options)  # of captures that are held
        compose_s = time.perf_counter() - started
        captures = image.effort.captures
        pixels = image.effort.megapixels * 1e6
        wrong = None
        if name in truth:
            off = (image["labels"] != truth[name].label) | wrong_depth(image["depth"], truth[name])
            wrong = float(off[image.valid].mean())
        seconds_at = {ms: Price(ms, MS_MEGAPIXEL).of(captures, pixels) / 1e3 for ms in LATENCIES_MS}
        seconds = seconds_at[LATENCIES_MS[0]] if is_modelled else _capturing_s(live, source.requests)
        seconds = max(seconds, _LEAST)  # where rays are traced, nothing is captured
        rows.append(
            Row(
                camera=name,
                series=series,
                viewpoints=options.get("viewpoints"),
                face_size=options.get("face_size"),
                requests=captures,
                megapixels=image.effort.megapixels,
                seconds=seconds,
                seconds_at=seconds_at if is_modelled else {},
                doubtful=image.doubtful,
                wrong=wrong,
                compose_s=compose_s,
                accuracy=options.get("accuracy"),
            )
        )
    return rows


def _capturing_s(source: Source, requests: Iterable[Request]) -> float:
    """Return the seconds in which a source captures requests."""
    started = time.perf_counter()
    for _ in source.capture(requests):
        pass
    return time.perf_counter() - started


def _ways(camera: Camera, face_px: int, asked: Sequence[float]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the series and the options of every way to make a camera's image."""
    for series, ways in (_CENTRAL if camera.central else _NONCENTRAL).items():
        for strategy, viewpoints, size in ways:
            face_size = round(size * face_px)
            yield series, {"strategy": strategy, "viewpoints": viewpoints, "face_size": face_size}
    yield DEFAULT, {}
    for aim in asked:
        if camera.central or aim >= _LEAST_NONCENTRAL:
            yield ASKED, {"accuracy": aim}


def write(rows: Sequence[Row], out: Path) -> list[Path]:
    """Write the measurements ``rows`` and draw them, a panel a camera: ``chart-accuracy`` as JSON, SVG and
    PNG in the folder ``out``."""
    names = list(dict.fromkeys(row.camera for row in rows))
    lines = (len(names) + 1) // 2
    figure, panels = drawing.figure(min(2, len(names)), 0.6 + 2.9 * lines, finding(rows), lines)
    looks: dict[str, Look] = {}
    for row in rows:
        if row.series not in (PAPER, DEFAULT, *looks):
            looks[row.series] = Look(COLORS[len(looks)], MARKERS[len(looks)], "-")
    looks |= {PAPER: Look(INK, "P", ""), DEFAULT: Look(INK, "*", "")}
    for name, axes in zip(names, panels, strict=False):
        _draw(axes, [row for row in rows if row.camera == name], looks)
        axes.set_title(name, size=10, color=INK)
    price = f"{MS_REQUEST:g} ms a request and {MS_MEGAPIXEL:g} ms a megapixel"
    figure.supxlabel(f"seconds of capturing: {price if rows[0].seconds_at else 'measured'}", size=9)
    hollow = "" if rows[0].wrong is None else " (hollow: truly wrong)"
    figure.supylabel(f"pixels in doubt, %{hollow}", size=9)
    handles = panels[-1].get_legend_handles_labels()
    panels[0].legend(*handles, loc="lower left", fontsize=8, frameon=False)
    return drawing.write(rows, figure, out, "chart-accuracy")


def _draw(axes: Axes, rows: Sequence[Row], looks: dict[str, Look]) -> None:
    """Draw a camera's ways: doubt by cost, hollow what is wrong where the truth is known, and the aims."""
    dots = []
    for row in rows:
        label = "" if row.accuracy is None else f"{100 * row.accuracy:g} %"
        dots.append(Dot(row.series, label, row.seconds, 100 * max(row.doubtful, _LEAST)))
    drawing.dots(axes, dots, looks)
    for row in rows:
        if row.wrong is not None:
            look = looks[row.series]
            wrong = 100 * max(row.wrong, _LEAST)
            axes.plot(row.seconds, wrong, look.marker, mfc="white", mec=look.color, ms=4, zorder=2)
    _draw_aims(axes)


def _draw_aims(axes: Axes) -> None:
    """Draw the aims as dotted lines."""
    limits = axes.get_xlim()
    for aim in AIMS:
        axes.axhline(100 * aim, color=MUTED, lw=0.7, ls=":", zorder=1)
        axes.annotate(
            f"{100 * aim:g} %", (limits[1], 100 * aim), (-2, 1), textcoords="offset points", size=6.5,
            color=MUTED, ha="right", va="bottom",
        )  # fmt: skip
    axes.set(xlim=limits, ylim=(100 * _LEAST / 1.5, 150))


def finding(rows: Sequence[Row]) -> str:
    """Return the title, which states the result: what an image no more doubtful than the paper's costs."""
    cheaper = []
    for camera in dict.fromkeys(row.camera for row in rows):
        rows_here = [row for row in rows if row.camera == camera]
        paper = next(row for row in rows_here if row.series == PAPER)
        ratio = paper.seconds / min(row.seconds for row in rows_here if row.doubtful <= paper.doubtful)
        if ratio >= _CHEAPER:
            cheaper.append(f"a {camera} {ratio:.0f} times cheaper")
    return "No more doubt than with the paper's full capture: " + (", ".join(cheaper) or "at no less cost")
