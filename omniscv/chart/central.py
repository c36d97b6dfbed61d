"""Speed against accuracy of one panorama: filters, face sizes, and other programs with the same faces."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from importlib.util import find_spec
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import Camera, create
from omniscv.chart import drawing, traced_mean
from omniscv.chart.drawing import COLORS, INK, MARKERS, MUTED, Dot, Look
from omniscv.compose.cache import HeldCaptures
from omniscv.compose.renderer import Renderer
from omniscv.geometry import R_LEVEL, Pose, cube_rotations
from omniscv.planning import Filter, RenderOptions
from omniscv.progress import Steps, counted
from omniscv.sources.base import Capabilities, Request, View
from omniscv.sources.scene import SceneSource, open_scene

FILTERS: tuple[Filter, ...] = ("nearest", "bilinear", "bicubic", "area")
SCALES = (0.5, 1.0, 2.0)
"""Face sizes as multiples of a quarter of the image's width, which has the same pixels per degree."""
DEFAULT: tuple[Filter, float] = ("bilinear", 1.0)

QUICK = {"width": 64}
_POSITION = (0.1, -0.2, 1.45)
_LEVEL = Pose.from_angles(_POSITION)
_WARMING = 2  # rounds that are not measured
_ROUNDS = 9  # that are measured, of which the best counts
_WHITE = 255.0  # of 8 bits

Image = NDArray[np.uint8]
_Way = tuple[str, int, str]
"""The filter or the other program, the face size, px, and what is kept of the map: see :class:`Row`."""
_Ways = dict[_Way, Callable[[int], Image]]
"""Functions that compose the image in a round."""


@dataclass(frozen=True)
class Row:
    """One way to compose the panorama.

    Attributes:
        name: the filter, or the other program.
        width: of the panorama, px.
        face_size: px.
        map: ``kept`` from image to image, ``new`` for an orientation not seen before, ``none`` kept.
        ours: whether it is omniscv.
        default: whether it is nearest to ``filter="auto"`` and ``face_size="auto"``.
        ms: time to compose one image in colour from decoded faces: the best of nine, in turn with the others.
        rms: error of the colours, grey levels of 255, against each pixel's mean by exact tracing; NaN for
            the limit, which composes no image.
    """

    name: str
    width: int
    face_size: int
    map: str
    ours: bool
    default: bool
    ms: float
    rms: float


def measure(width: int = 2048, progress: Steps | None = None) -> list[Row]:
    """Measure every way in the four-wall room.

    Args:
        width: of the panorama, px.
        progress: is told how many rounds are done; None: nobody.
    """
    camera = create("equirectangular", width=width, height=width // 2)
    scene = open_scene("scene://four-wall").scene
    ways: _Ways = {}
    for scale in SCALES:
        edge = round(width / 4 * scale)
        fixed = Capabilities(can_set_size=False, can_set_fov=False, image_size=(edge, edge), fov_deg=90.0)
        source = HeldCaptures(SceneSource(scene, fixed, cached_views=1), {}, all_=True)
        for filter in FILTERS:
            options = RenderOptions("cube", face_size=edge, filter=filter)
            ways[filter, edge, "kept"] = _ours(Renderer(source), camera, options, new=False)
            if filter == DEFAULT[0]:
                ways[filter, edge, "new"] = _ours(Renderer(source), camera, options, new=True)
    edge = round(width / 4)
    faces = _faces(SceneSource(scene), edge)
    for name, peer in peers(faces, camera).items():
        ways[name, edge, "none" if name == PAPER else "kept"] = peer
    limit = ("cv2.remap, map ready", edge, "kept")
    ways[limit] = remap_limit(camera, list(faces.values()))
    times = _best_ms(ways, progress)
    mean = traced_mean(scene, camera, _LEVEL)
    rows = []
    for (name, size, kept), way in ways.items():
        ours = name in FILTERS
        default = ours and (name, size) == (DEFAULT[0], round(width / 4 * DEFAULT[1]))
        off = np.nan if (name, size, kept) == limit else _WHITE * (way(0) / _WHITE - mean)
        rms = float(np.sqrt(np.square(off).mean()))
        rows.append(Row(name, width, size, kept, ours, default, times[name, size, kept], rms))
    return rows


def _faces(source: SceneSource, edge: int) -> dict[str, Image]:
    """Return the colours (edge, edge, 3) of the six faces of a cube, by name."""
    requests = []
    names = []
    for name, rotation in cube_rotations():
        names.append(name)
        requests.append(Request(View(Pose(_LEVEL.position, rotation), 90.0, edge, edge), "lit"))
    faces = {}
    for name, capture in zip(names, source.capture(requests), strict=True):
        faces[name] = capture.pixels
    return faces


def _ours(renderer: Renderer, camera: Camera, options: RenderOptions, *, new: bool) -> Callable[[int], Image]:
    """Return a function of the round that composes the image: level, or with ``new`` turned by the round."""

    def compose(turn: int) -> Image:
        pose = Pose.from_angles(_POSITION, yaw_deg=0.7 * turn) if new else _LEVEL
        return np.asarray(renderer.render(camera, pose, ("lit",), options)["lit"])

    return compose


def _best_ms(ways: _Ways, progress: Steps | None) -> dict[_Way, float]:
    """Return the time of each way, ms: the best of nine rounds, after two that warm up."""
    best_ms = dict.fromkeys(ways, math.inf)
    for turn in counted(range(_WARMING + _ROUNDS), progress):
        for key, way in ways.items():
            started = time.perf_counter()
            way(turn)
            if turn >= _WARMING:
                best_ms[key] = min(best_ms[key], 1e3 * (time.perf_counter() - started))
    return best_ms


def write(rows: Sequence[Row], out: Path) -> list[Path]:
    """Write the measurements ``rows`` and draw them: ``chart-central`` as JSON, SVG and PNG in the folder
    ``out``."""
    figure, (axes,) = drawing.figure(1, 4.6, finding(rows))
    ways = [_dot(row) for row in rows if np.isfinite(row.rms)]
    looks: dict[str, Look] = {}
    for filter, color, marker in zip(FILTERS, COLORS, MARKERS, strict=False):
        looks[filter] = Look(color, marker, "-")
    for dot in ways:
        looks.setdefault(dot.series, Look(INK, "P", ""))
    drawing.dots(axes, ways, looks)
    for row in rows:
        if not np.isfinite(row.rms):
            axes.axvline(row.ms, color=MUTED, lw=1, ls="--", zorder=1)
            axes.annotate(
                f"limit: {row.name}", (row.ms, 0.02), (3, 0), xycoords=("data", "axes fraction"),
                textcoords="offset points", size=8, color=MUTED, rotation=90, va="bottom",
            )  # fmt: skip
    axes.set_xlabel("ms to compose one panorama from decoded faces (hollow: including its map)", size=9)
    axes.set_ylabel("rms error, grey levels of 255", size=9)
    axes.legend(fontsize=8, frameon=False)
    return drawing.write(rows, figure, out, "chart-central")


def _dot(row: Row) -> Dot:
    """Return a row as a dot: of ours with the face size, hollow where the map is new."""
    hollow = row.map != "kept"
    if not row.ours:
        return Dot("others", row.name, row.ms, row.rms, row.default and not hollow, hollow)
    label = "" if hollow else str(row.face_size)
    return Dot(row.name, label, row.ms, row.rms, row.default and not hollow, hollow)


def finding(rows: Sequence[Row]) -> str:
    """Return the title: sizes, speed, whether another program is nearer to the truth, and the front."""
    ours = next(row for row in rows if row.default and row.map == "kept")
    drawn = [row for row in rows if np.isfinite(row.rms)]
    others = [row for row in drawn if not row.ours]
    beaten = []
    for row in others:
        if row.ms > ours.ms:
            beaten.append(f"{row.ms / ours.ms:.1f} times as fast as {row.name}")
    truest = min(others, key=lambda row: row.rms)
    truth = "none of them is nearer to the truth"
    if not truest.rms >= ours.rms:
        truth = f"{truest.name} is nearer to the truth by {1 - truest.rms / ours.rms:.1%}"
    best = drawing.front([_dot(row) for row in drawn])
    in_front = []
    for row in drawn:
        if _dot(row) in best:
            in_front.append(f"{row.name} {row.face_size}" if row.ours else row.name)
    sizes = f"6 x {ours.face_size}\N{SUPERSCRIPT TWO} to {ours.width} x {ours.width // 2} px"
    speed = f"{ours.ms:.1f} ms, {', '.join(beaten)}"
    return f"{sizes}, {ours.name}: {speed}; {truth}. Front: {', '.join(in_front)}"


Peer = Callable[[int], Image]
"""Composes the image; the number of the round is not used."""

PAPER = "the paper's algorithm"


def peers(faces: Mapping[str, Image], camera: Camera) -> dict[str, Peer]:
    """Return the installed peers by name; the paper's algorithm is always among them.

    Args:
        faces: (edge, edge, 3) of the cube, by name.
        camera: whose image they compose.
    """
    in_order = [faces[name] for name, _ in cube_rotations()]
    installed: dict[str, Peer] = {PAPER: lambda turn: paper(in_order, camera)}
    if find_spec("py360convert"):
        import py360convert

        size = (camera.height, camera.width)
        form = {"mode": "bilinear", "cube_format": "list"}
        convert = partial(py360convert.c2e, list(in_order), *size, **form)
        installed["py360convert"] = lambda turn: np.asarray(convert(), np.uint8)
    if find_spec("av"):
        installed["ffmpeg v360"] = _v360(in_order, camera)
    return installed


def paper(faces: Sequence[Image], camera: Camera) -> Image:
    """Compose as OmniSCV (2020): the colour of each pixel is that of the face's pixel that its ray meets.

    Nothing is kept from image to image.

    Args:
        faces: (edge, edge, 3) of the cube, in the order of :func:`omniscv.geometry.cube_rotations`.
        camera: a central one.
    """
    rays = camera.unproject().directions @ R_LEVEL.T
    R_w_f = np.array([rotation for _, rotation in cube_rotations()])
    face = (rays @ R_w_f[:, :, 2].T).argmax(axis=-1)
    p_f = np.einsum("hwi,hwij->hwj", rays, R_w_f[face])
    edge = len(faces[0])
    at = (edge / 2 * (1 + p_f[..., :2] / p_f[..., 2:])).astype(np.int64).clip(0, edge - 1)
    image: Image = np.stack(faces)[face, at[..., 1], at[..., 0]]
    return image


def remap_limit(camera: Camera, faces: Sequence[Image]) -> Peer:
    """Return the limit of sampling with OpenCV on a CPU: one remap with a map that is ready.

    Args:
        camera: of whose size images are sampled.
        faces: (edge, edge, 3) of a cube.
    """
    import cv2

    atlas = np.ascontiguousarray(np.concatenate(faces, axis=1))
    rng = np.linspace(1, len(faces[0]) - 2, camera.width, dtype=np.float32)
    x = np.tile(rng, (camera.height, 1)) + np.float32(0.37)
    y = np.repeat(rng[: camera.height, None], camera.width, axis=1) + np.float32(0.21)
    return lambda turn: np.asarray(cv2.remap(atlas, x, y, cv2.INTER_LINEAR), np.uint8)


def _v360(faces: Sequence[Image], camera: Camera) -> Peer:
    """Return ffmpeg's filter, which keeps its map from frame to frame."""
    import av

    upper = np.concatenate(faces[:3], axis=1)
    lower = np.concatenate(faces[3:], axis=1)
    picture = np.concatenate([upper, lower])
    time_base = Fraction(1, 25)
    graph = av.filter.Graph()
    frames = count()
    height, width = picture.shape[:2]
    start = graph.add_buffer(width=width, height=height, format=av.VideoFormat("rgb24"), time_base=time_base)
    options = f"input=c3x2:output=e:in_forder=frblud:w={camera.width}:h={camera.height}:interp=linear"
    way = graph.add("v360", options)
    end = graph.add("buffersink")
    start.link_to(way)
    way.link_to(end)
    graph.configure()

    def compose(turn: int) -> Image:
        frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
        frame.time_base = time_base
        frame.pts = next(frames)
        graph.push(frame)
        composed: Any = graph.pull()
        return np.asarray(composed.to_ndarray(format="rgb24"), np.uint8)

    return compose
