"""Speed against accuracy of central cameras: filters x face sizes x models, measured and drawn."""

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
from omniscv.chart import pareto
from omniscv.chart.truth import TracedSource, traced, traced_mean
from omniscv.compose import Composer
from omniscv.geometry import Array, Pose
from omniscv.plan import sampling
from omniscv.render import render

FILTERS = ("nearest", "bilinear", "bicubic", "area")
SCALES = (0.5, 1.0, 2.0, 4.0)
"""Face sizes, as multiples of the one that ``auto`` takes."""

_POSE = Pose.from_angles((0.1, -0.2, 1.45), yaw_deg=27.0, pitch_deg=8.0, roll_deg=-5.0)
_ROUNDS = 5
_MODES = ("lit", "object_mask", "depth")
_SEAM_PX = 2.0
_LEAST = 1e-8  # an error of 0 is drawn here


@dataclass(frozen=True)
class Row:
    """One way to compose one model's image.

    Attributes:
        ms: composing lit, mask and depth with a new orientation, captures decoded: the best of five.
        psnr_db, flip: lit against the mean colour of each pixel, by exact tracing.
        wrong_labels: part of the valid pixels.
        depth_median, depth_q99: relative error against each pixel's own ray.
        seam: rms error of lit within two face pixels of the cube's edges, over that elsewhere.
    """

    model: str
    filter: str
    face_size: int
    scale: float
    default: bool
    ms: float
    psnr_db: float
    flip: float
    wrong_labels: float
    depth_median: float
    depth_q99: float
    seam: float


def models(width: int) -> dict[str, Camera]:
    """The cameras that are charted, at a width."""
    square = {"width": width, "height": width}
    return {
        "equirectangular": create("equirectangular", width=width, height=width // 2),
        "fisheye-equidistant": create("fisheye-equidistant", **square, fov_deg=185),
        "catadioptric-hyperbolic": create(
            "catadioptric-hyperbolic", **square, distance=1.0, semi_latus_rectum=0.4
        ),
    }


def measure(width: int = 512, progress: Callable[[int, int], None] | None = None) -> list[Row]:
    """Measures every way in the four-wall room.

    Args:
        width: of the images, px.
        progress: called with (images done, images in all).
    """
    scene = load_scene("four-wall")
    rows: list[Row] = []
    cameras = models(width)
    total = len(cameras) * len(SCALES) * len(FILTERS)
    for name, camera in cameras.items():
        truth = _Truth(scene_hits=traced(scene, camera, _POSE), mean=traced_mean(scene, camera, _POSE))
        auto = sampling.face_size(camera)
        for scale in SCALES:
            source = TracedSource(scene, lit=np.uint8)
            for filter in FILTERS:
                edge = round(auto * scale)
                default = scale == 1.0 and filter == "bilinear"
                rows.append(_measured(name, camera, source, filter, edge, scale, default, truth))
                if progress:
                    progress(len(rows), total)
    return rows


@dataclass(frozen=True)
class _Truth:
    scene_hits: Hits
    mean: Array


def _measured(
    name: str,
    camera: Camera,
    source: TracedSource,
    filter: str,
    edge: int,
    scale: float,
    default: bool,
    truth: _Truth,
) -> Row:
    composer = Composer()

    def composed(turn: float) -> Any:
        pose = Pose.from_angles(_POSE.t_w_c, yaw_deg=27.0 + turn, pitch_deg=8.0, roll_deg=-5.0)
        return render(camera, pose, source, _MODES, filter=filter, face_size=edge, composer=composer)

    times = []
    for turn in range(1, _ROUNDS + 2):
        started = time.perf_counter()
        composed(float(turn))
        times.append(time.perf_counter() - started)
    image = composed(0.0)
    lit, mean = image.lit.astype(np.float64) / 255, truth.mean
    inside = image.valid & np.isfinite(mean).all(axis=-1)
    square = ((lit - mean) ** 2).mean(axis=-1)
    hits = truth.scene_hits
    off = np.abs(image.depth - hits.distance)[inside] / hits.distance[inside]
    near = inside & _near_edges(camera, edge)
    return Row(
        name,
        filter,
        edge,
        scale,
        default,
        ms=1e3 * min(times[1:]),
        psnr_db=float(-10 * np.log10(square[inside].mean())),
        flip=_flip(np.where(inside[..., None], mean, 0), np.where(inside[..., None], lit, 0), inside),
        wrong_labels=float((image.labels != hits.label)[inside].mean()),
        depth_median=float(np.median(off)),
        depth_q99=float(np.quantile(off, 0.99)),
        seam=float(np.sqrt(square[near].mean() / square[inside & ~near].mean())),
    )


def _near_edges(camera: Camera, edge: int) -> NDArray[np.bool_]:
    """Pixels whose rays are within two face pixels of an edge of the cube."""
    axes = np.sort(np.abs(camera.unproject().directions @ _POSE.R_w_c.T), axis=-1)
    with np.errstate(invalid="ignore"):
        return np.asarray((1 - axes[..., 1] / axes[..., 2]) * edge / 2 < _SEAM_PX)


def _flip(reference: Array, test: Array, inside: NDArray[np.bool_]) -> float:
    """Mean of FLIP, the difference that people see when they flip between two images (Andersson, 2020)."""
    import OpenImageIO

    first, second = (
        OpenImageIO.ImageBuf(np.ascontiguousarray(each, dtype=np.float32)) for each in (reference, test)
    )
    difference = OpenImageIO.ImageBufAlgo.FLIP_diff(first, second, hdr=0)
    return float(np.asarray(difference.get_pixels(OpenImageIO.FLOAT))[..., 0][inside].mean())


def write(rows: list[Row], out: Path) -> list[Path]:
    """Writes the measurements and draws them: ``chart-central.json`` and ``chart-central.png``."""
    out.mkdir(parents=True, exist_ok=True)
    data, picture = out / "chart-central.json", out / "chart-central.png"
    data.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n", encoding="utf-8")
    _draw(rows, picture)
    return [data, picture]


def _draw(rows: list[Row], path: Path) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    errors: list[tuple[str, Callable[[Row], float]]] = [
        ("lit: rms error, parts of white", lambda row: float(10 ** (-row.psnr_db / 20))),
        ("labels: part that is wrong", lambda row: max(row.wrong_labels, _LEAST)),
        ("depth: 99th percentile of relative error", lambda row: max(row.depth_q99, _LEAST)),
    ]
    names = list(dict.fromkeys(row.model for row in rows))
    figure = Figure(figsize=(4.6 * len(errors), 3.4 * len(names)), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(names), len(errors), squeeze=False)
    for name, line in zip(names, grid, strict=True):
        for (title, error), axes in zip(errors, line, strict=True):
            pareto.draw(
                axes,
                [row for row in rows if row.model == name],
                cost=lambda row: row.ms,
                error=error,
                kind=lambda row: row.filter,
                label=lambda row: str(row.face_size),
                is_default=lambda row: row.default,
            )
            axes.set_title(f"{name} - {title}", size=8)
            axes.set_xlabel("ms an image in lit, mask and depth, new orientation", size=7)
            axes.tick_params(labelsize=6, which="both")
    grid[0][0].legend(fontsize=7)
    figure.suptitle(
        "Speed against accuracy: filters and face sizes (px at the dots); ringed: the default", size=10
    )
    figure.savefig(path)
