"""Central cameras in all modalities: filters, face sizes and models, and finer ground truth."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import Camera, create
from omniscv.chart.truth import traced, traced_mean
from omniscv.compose.renderer import Renderer
from omniscv.geometry import Array, Pose
from omniscv.planning import Filter, ImageRays, RenderOptions, densities
from omniscv.planning.cost import cost
from omniscv.sources.scene import SceneSource, open_scene

if TYPE_CHECKING:
    from mock_server import Hits

FILTERS: tuple[Filter, ...] = ("nearest", "bilinear", "bicubic", "area")
SCALES = (0.5, 1.0, 2.0, 4.0)
"""Face sizes as multiples of the one that ``auto`` selects."""
TRUTH_SCALES = (2, 4)
"""How many times finer masks and depth are captured, beside the default 1."""

DEFAULT: tuple[float, Filter, int] = (1.0, "bilinear", 1)
WAYS = (
    *((scale, filter, 1) for scale, filter in product(SCALES, FILTERS)),
    *((*DEFAULT[:2], finer) for finer in TRUTH_SCALES),
)
"""Multiple of the automatic face size, filter, and ``truth_scale``."""

_POSE = Pose.from_angles((0.1, -0.2, 1.45), yaw_deg=27.0, pitch_deg=8.0, roll_deg=-5.0)
_ROUNDS = 5
_MODES = ("lit", "object_mask", "depth")
_SEAM_PX = 2.0


@dataclass(frozen=True)
class Row:
    """One way to compose one model's image.

    Attributes:
        truth_scale: how many times finer mask and depth are captured than lit.
        ms: time to compose lit, mask and depth with a new orientation from decoded captures: best of five.
        megapixels: captured, over all three modes.
        psnr_db, flip: lit against the mean colour of each pixel, by exact tracing.
        wrong_labels: fraction of the valid pixels.
        depth_median, depth_q99: relative error against the traced ray of each pixel.
        seam: rms error of lit within two face pixels of the cube's edges, divided by that elsewhere.
    """

    model: str
    filter: str
    face_size: int
    scale: float
    default: bool
    truth_scale: int
    ms: float
    megapixels: float
    psnr_db: float
    flip: float
    wrong_labels: float
    depth_median: float
    depth_q99: float
    seam: float

    @property
    def way(self) -> str:
        """The filter, and the scale of the ground truth."""
        return self.filter if self.truth_scale == 1 else f"{self.filter}, truth x {self.truth_scale}"


def models(width: int) -> dict[str, Camera]:
    """Return the cameras of the table, by name."""
    square = {"width": width, "height": width}
    return {
        "equirectangular": create("equirectangular", width=width, height=width // 2),
        "fisheye-equidistant": create("fisheye-equidistant", **square, fov_deg=185),
        "catadioptric-hyperbolic": create(
            "catadioptric-hyperbolic", **square, distance=1.0, semi_latus_rectum=0.4
        ),
    }


def measure(
    width: int = 512,
    progress: Callable[[int, int], None] | None = None,
    smallest_face: int = densities.SMALLEST,
) -> list[Row]:
    """Measure every way in the four-wall room.

    Args:
        width: of the images, px.
        progress: called with (images done, images in total).
        smallest_face: px of the smallest face that ``auto`` selects.
    """
    scene, cameras = open_scene("scene://four-wall").scene, models(width)
    rows: list[Row] = []
    for name, camera in cameras.items():
        hits, mean = traced(scene, camera, _POSE), traced_mean(scene, camera, _POSE)
        source, auto = SceneSource(scene), densities.face_size(ImageRays(camera).steps, smallest_face)
        for scale, filter, finer in WAYS:
            edge, default = round(auto * scale), (scale, filter, finer) == DEFAULT
            options = RenderOptions(filter=filter, face_size=edge, truth_scale=finer)
            measured = _measured(camera, Renderer(source), options, hits, mean)
            rows.append(Row(name, filter, edge, scale, default, finer, **measured))
            if progress:
                progress(len(rows), len(cameras) * len(WAYS))
    return rows


def _measured(
    camera: Camera, renderer: Renderer, options: RenderOptions, hits: Hits, mean: Array
) -> dict[str, float]:
    times, edge = [], renderer.task(camera, _POSE, options).edge
    plan_cost = cost("auto", [[renderer.task(camera, _POSE, options)]], _MODES, 0.0)
    for turn in range(1, _ROUNDS + 2):
        pose = Pose.from_angles(_POSE.position, yaw_deg=27.0 + turn, pitch_deg=8.0, roll_deg=-5.0)
        started = time.perf_counter()
        renderer.render(camera, pose, _MODES, options)
        times.append(time.perf_counter() - started)
    image = renderer.render(camera, _POSE, _MODES, options)
    lit = image["lit"].astype(np.float64) / 255
    inside = image.valid & np.isfinite(mean).all(axis=-1)
    square = ((lit - mean) ** 2).mean(axis=-1)
    off = np.abs(image["depth"] - hits.distance)[inside] / hits.distance[inside]
    near = inside & _near_edges(camera, edge)
    return {
        "ms": 1e3 * min(times[1:]),
        "megapixels": plan_cost.pixels / 1e6,
        "psnr_db": float(-10 * np.log10(square[inside].mean())),
        "flip": _flip(np.where(inside[..., None], mean, 0), np.where(inside[..., None], lit, 0), inside),
        "wrong_labels": float((image["labels"] != hits.label)[inside].mean()),
        "depth_median": float(np.median(off)),
        "depth_q99": float(np.quantile(off, 0.99)),
        "seam": float(np.sqrt(square[near].mean() / square[inside & ~near].mean())),
    }


def _near_edges(camera: Camera, edge: int) -> NDArray[np.bool_]:
    """Return which pixels have rays within two face pixels of an edge of the cube."""
    axes = np.sort(np.abs(camera.unproject().directions @ _POSE.rotation.T), axis=-1)
    with np.errstate(invalid="ignore"):
        return np.asarray((1 - axes[..., 1] / axes[..., 2]) * edge / 2 < _SEAM_PX)


def _flip(reference: Array, test: Array, inside: NDArray[np.bool_]) -> float:
    """Return the mean FLIP difference of two images (Andersson et al. 2020)."""
    import OpenImageIO

    first, second = (
        OpenImageIO.ImageBuf(np.ascontiguousarray(image, np.float32)) for image in (reference, test)
    )
    difference = OpenImageIO.ImageBufAlgo.FLIP_diff(first, second, hdr=0)
    return float(np.asarray(difference.get_pixels(OpenImageIO.FLOAT))[..., 0][inside].mean())
