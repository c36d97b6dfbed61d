"""Where images fail: causes at growing strength, the error against exact truth, and the software's answer.

Captures come from the mock server with a fault; the doctor examines the same server.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import quote

import numpy as np
from matplotlib.axes import Axes

from omniscv import light
from omniscv.cameras import Camera, create
from omniscv.chart import drawing, traced
from omniscv.compose.image import OmniImage
from omniscv.compose.renderer import render
from omniscv.diagnostics.doctor import examine_address
from omniscv.errors import OmniscvError
from omniscv.geometry import Array, Pose
from omniscv.geometry.arrays import Mask
from omniscv.progress import Steps, counted
from omniscv.sources.registry import Deadlines, open_source
from omniscv.sources.scene import open_scene

if TYPE_CHECKING:
    from mock_server import Hits, Scene

QUICK = {"width": 32, "causes": ("radial depth",)}

ANSWERS = {
    "holds": ("#b6bcc6", "holds"),
    "refused": ("#0072b2", "refused"),
    "doctor": ("#009e73", "found by the doctor"),
    "marked": ("#56b4e9", "marked or bounded in the image"),
    "silent": ("#d55e00", "silent"),
}
"""Colour and legend of the software's answers. ``holds``: the image is as true as without the fault."""

COLUMNS = ("panorama", "exact", "8 viewpoints", "auto")
_RING: dict[str, dict[str, Any]] = {
    "exact": {"strategy": "exact"},
    "8 viewpoints": {"strategy": "exact", "viewpoints": 8},
    "auto": {},
}

_KEY = "Each cell: strength from weak to strong; its height: pixels wrong, 0.01 % to 100 %, logarithmic"
_LINE_IN = 0.36  # inches of a line of panels
_MODES = ("lit", "object_mask", "depth")
_FACE = 96 / 128  # px of a face for each of the image's width
_RADIUS_M = 0.4  # of the ring of viewpoints
_POSE = Pose.from_angles((0.13, -0.21, 1.47), yaw_deg=20.0)
_LEVELS = 8 / 255  # error from which a colour is wrong
_DEPTH = 0.01  # relative error from which depth is wrong
_SLACK = _DEPTH / 10  # relative error that a bound of depth may miss
_BROKEN = 0.002  # least increase of wrong pixels that counts, a share
_UNMARKED = 0.001  # least increase of unmarked pixels that counts, a share
_LEAST = 1e-4  # an error of 0 is drawn here
_DEADLINES: Deadlines = {"timeout_s": 60.0, "patience_s": 5.0}
_SLITS_PX = 8  # from slit to slit
_ROOM = """
sky: [0.6, 0.8, 0.9]
room: {{floor: [[-3, -3], [3, -3], [3, 3], [-3, 3]], height: 3,
  walls: [{{kind: plain, colors: [[0.8, 0.7, 0.6]]}}],
  floor_texture: {{kind: plain, colors: [[0.5, 0.4, 0.3]]}},
  ceiling_texture: {{kind: plain, colors: [[0.9, 0.9, 0.9]]}}}}
objects: {{Parts: {{texture: {{kind: plain, colors: [[0.2, 0.2, 0.2]]}}, solids: [{}]}}}}
"""

# A structure before a wall, metres:
_AHEAD_M = 2.6  # from the camera
_HALF_M = 2.5  # to either side
_PX_M = 2.5 / 48  # the width of a px of a face of 96


def _solids(name: str, strength: float) -> Iterator[str]:
    """Yield the solids of a cause whose strength is the size of what captures must show."""
    if name == "thin rods":
        for angle in np.arange(0, 2 * np.pi, np.pi / 8):
            at = f"[{2 * np.cos(angle):.4f}, {2 * np.sin(angle):.4f}, 1.5]"
            yield f"{{cylinder: [{strength / 2000}, 3], at: {at}}}"
        return
    pitch_m = _PX_M * (_SLITS_PX if name == "slit" else strength)
    for y in np.arange(-_HALF_M, _HALF_M, pitch_m):
        at = f"at: [{_AHEAD_M}, {y:.5f}, 1.5]"
        wide_m = pitch_m - strength * _PX_M if name == "slit" else 0.6 * pitch_m
        solid = f"box: [0.02, {wide_m:.5f}, 3]"
        if name == "relief":
            solid = f"cylinder: [{pitch_m / 2:.5f}, 3]"
        yield f"{{{solid}, {at}}}"


class Cause(NamedTuple):
    """A cause of failures.

    Attributes:
        name: of the row.
        unit: of the strengths.
        strengths: from weak to strong.
        query: of the mock server's address; ``{}`` is the strength.
        scene: name, or ``parts`` that the strength makes.
        sound: as ``query``, without the fault.
        checks: of the images.
    """

    name: str
    unit: str
    strengths: tuple[float | str, ...]
    query: str = ""
    scene: str = "four-wall"
    sound: str = ""
    checks: str = "none"

    def pose(self, strength: float | str) -> Pose:
        """Return the camera's pose: in the middle, or so near to a wall that viewpoints lie beyond it."""
        if self.name != "beyond a wall":
            return _POSE
        return Pose.from_angles((0.13, -2.5 + _RADIUS_M - float(strength) / 100, 1.47), yaw_deg=20.0)


def _fault(name: str, unit: str, *strengths: float | str, fault: str = "") -> Cause:
    """Return a cause that is a fault of the mock server, called as the cause unless ``fault`` is given."""
    return Cause(name, unit, strengths, f"fault={fault or name.replace(' ', '-')}={{}}")


_STILL = "time_step_s=0"
CAUSES = (
    _fault("exposure drift", "of the way", 0.001, 0.01, 0.1, 1),
    _fault("vignette", "in corners", 0.001, 0.01, 0.1, 1),
    _fault("bloom", "of the light", 0.001, 0.01, 0.1, 1),
    _fault("gloss", "", "Vase", "Picture", "Layout_Wall_2", "Layout_Floor"),
    _fault("glass", "", "Pole", "Picture", "Door", "Sofa"),
    _fault("jpeg", "quality lost", 1, 5, 20, 80),
    _fault("narrow field of view", "degrees", 0.01, 0.1, 1, 10, fault="narrow-fov"),
    _fault("poles turned", "degrees", 0.01, 0.1, 1, 10, fault="turned"),
    _fault("jitter", "px", 0.01, 0.1, 1, 10),
    _fault("far origin", "km", 1, 10, 100, 1000),
    _fault("stale", "images", 1, 3, 10, 30),
    _fault("growing world", "each depth", 1e-5, 1e-4, 1e-3, 1e-2, fault="moving-world"),
    Cause("moving objects", "s a frame", (1e-5, 1e-4, 1e-3, 1e-2), "time_step_s={}", "workshop", _STILL),
    _fault("radial depth", "of the way", 0.001, 0.01, 0.1, 1),
    _fault("depth mantissa", "bits", 10, 7, 4, 2),
    _fault("integer depth", "bits of 100 m", 24, 16, 12, 8, fault="depth-bits"),
    _fault("far plane", "m", 1000, 10, 3, 1),
    _fault("near plane", "cm", 1, 10, 100, 200),
    _fault("sky dome", "m", 1000000, 10000, 100, 10, fault="sky-dome")._replace(scene="open"),
    _fault("mask blur", "px", 0.1, 0.3, 1, 3),
    _fault("mask noise", "levels", 0.5, 1, 4, 16),
    _fault("near colours", "levels", 64, 4, 1, 0, fault="near-colors"),
    _fault("distortion", "in corners", 0.001, 0.01, 0.1, 1)._replace(scene="six-wall"),
    _fault("lit offset", "px", 0.1, 1, 10, 30)._replace(scene="six-wall"),
    _fault("depth scale", "too large", 0.001, 0.01, 0.1, 1)._replace(scene="six-wall"),
    # Strengths and scenes of the next three were drawn at random; no check was tuned on them.
    _fault("mask offset", "px", 0.12, 0.58, 0.76, 5),
    _fault("colour cast", "of red and blue", 0.0032, 0.055, 0.28, 0.29, fault="color-cast"),
    _fault("roll", "degrees", 0.012, 0.039, 5.3, 5.7)._replace(scene="six-wall"),
    Cause("thin rods", "mm", (100, 30, 10, 1), scene="parts"),
    # Touching pillars, slits every eight px, and bars, of so many captured px.
    Cause("relief", "px", (8, 4, 2, 1.3), scene="parts"),
    Cause("slit", "px", (1, 0.3, 0.1, 0.03), scene="parts"),
    Cause("beat", "px", (2, 1.3, 1.05, 1), scene="parts"),
    Cause("checked beat", "px", (2, 1.3, 1.05, 1), scene="parts", checks="beat"),
    Cause("beyond a wall", "cm", (1, 10, 30, 100)),
)


@dataclass(frozen=True)
class Row:
    """A cause at a strength, by a strategy.

    Attributes:
        column: the panorama, or a strategy of a ring of viewpoints.
        wrong: share of the valid pixels with a wrong label, depth off by more than 1 %, or a colour of more
            than 8 levels outside what is seen within the pixel; None if refused.
        unmarked: share of the pixels that are wrong and not marked.
        said: one of ``ANSWERS``.
        findings: the names of what the doctor finds, beside what it finds without the fault.
        refusal: the error that was raised.
    """

    cause: str
    unit: str
    strength: float | str
    column: str
    wrong: float | None
    unmarked: float | None
    said: str
    findings: tuple[str, ...] = ()
    refusal: str = ""


class _Truth:
    """The hits of a camera's rays, and the range of colours within each pixel.

    ``special`` is an object that the fault ``gloss`` or ``glass`` mixes with other light.
    """

    def __init__(self, scene: Scene, camera: Camera, pose: Pose, special: tuple[str, str]) -> None:
        self.hits = traced(scene, camera, pose)
        around = []
        for dv, du in ((0, 0), *product((-0.5, 0.5), repeat=2)):
            rays = camera.unproject(camera.pixels() + np.array([du, dv]))
            directions = rays.directions @ pose.rotation.T
            origins = np.broadcast_to(pose.to_world(rays.origins), directions.shape)
            around.append(_color(scene, origins, directions, *special))
        self.least = np.nanmin(around, axis=0)
        self.most = np.nanmax(around, axis=0)

    def judge(self, image: OmniImage) -> tuple[float, float]:
        """Compare an image with the truth, pixel by pixel.

        Depth is wrong by :func:`wrong_depth`, a label if it is another one, and a colour if it is outside the
        range of the pixel by more than ``_LEVELS``.

        ``unsure`` marks all of them, ``depth_error`` a depth whose error it covers, ``label_edge`` a label. A
        colour is also marked where ``label_edge`` or a large ``depth_error`` says that the pixel may show
        another surface.

        Returns:
            The shares, 0 to 1, of the valid pixels that are wrong, and that are wrong and not marked.
        """
        wrong = wrong_depth(image["depth"], self.hits)
        unmarked = wrong & ~self._covered(image["depth"], image["depth_error"])
        wrong_label = image["labels"] != self.hits.label
        unmarked |= wrong_label & ~image["label_edge"]
        lit = image["lit"].astype(np.float64) / 255
        is_outside = (lit < self.least - _LEVELS) | (lit > self.most + _LEVELS)
        wrong_color = is_outside.any(axis=-1)
        is_exact = image["depth_error"] <= _DEPTH * image["depth"]  # False for NaN
        unmarked |= wrong_color & is_exact & ~image["label_edge"]
        unmarked &= ~image["unsure"]
        wrong |= wrong_label | wrong_color
        return float(wrong[image.valid].mean()), float(unmarked[image.valid].mean())

    def _covered(self, depth: Array, depth_error: Array) -> Mask:
        """Return where the true distance lies within ``depth_error`` metres of ``depth``, nearly; (H, W)."""
        with np.errstate(invalid="ignore"):
            beyond = np.abs(depth - self.hits.distance) - depth_error
            return np.asarray((beyond <= _SLACK * self.hits.distance) | np.isposinf(depth_error))


def _color(scene: Scene, origins: Array, directions: Array, fault: str, name: str) -> Array:
    """Return (..., 3) colours, of an object with half of the light from what it faces, or from behind it."""
    hits = scene.trace(origins, directions)
    if not name:
        return hits.color
    at = hits.label == scene.label(name)
    start = origins[at]
    ray = directions[at]
    normal = hits.normal[at]
    if fault == "gloss":
        start = start + hits.distance[at, None] * ray + 1e-6 * normal
        ray = ray - 2 * (ray * normal).sum(axis=-1, keepdims=True) * normal
    other = scene.trace(start, ray, (name,) if fault == "glass" else ()).color
    color = hits.color.copy()
    color[at] = light.light_to_srgb((light.srgb_to_light(color[at]) + light.srgb_to_light(other)) / 2)
    return color


def wrong_depth(depth: Array, hits: Hits) -> Mask:
    """Return where ``depth`` is off from the distance of ``hits`` by more than 1 %, or one of them is
    endless."""
    endless = np.isposinf(depth) & np.isposinf(hits.distance)
    with np.errstate(invalid="ignore"):
        return np.asarray(~endless & ~(np.abs(depth - hits.distance) <= _DEPTH * hits.distance))


def measure(width: int = 128, progress: Steps | None = None, causes: Sequence[str] = ()) -> list[Row]:
    """Measure causes at all strengths.

    Args:
        width: of the images, px.
        progress: is told how many strengths are done; None: nobody.
        causes: their names; all if none is named.
    """
    steps = []
    for cause in CAUSES:
        if not causes or cause.name in causes:
            steps += [(cause, strength) for strength in cause.strengths]
    rows: list[Row] = []
    sound: dict[str, _Outcome] = {}
    with TemporaryDirectory() as folder:
        for cause, strength in counted(steps, progress):
            scene = _scene(cause, strength, Path(folder))
            pose = cause.pose(strength)
            base = scene if cause.query else "four-wall"
            if base not in sound:
                sound[base] = _examine(base, cause.sound, width, _POSE)
            query = cause.query.format(strength)
            outcome = _examine(scene, query, width, pose, cause.checks)
            rows += _rows(cause, strength, outcome, sound[base])
    return rows


class _Outcome(NamedTuple):
    """The errors of a server's images, by column, and the names of the doctor's findings."""

    images: dict[str, tuple[float, float] | str]
    findings: frozenset[str]


def _examine(scene: str, query: str, width: int, pose: Pose, checks: str = "none") -> _Outcome:
    """Return the outcome of images ``width`` px wide of a mock server, and of the doctor's examination."""
    size = {"width": width, "height": width // 2}
    face_size = round(_FACE * width)
    ring = create("noncentral-panorama", **size, radius=_RADIUS_M)
    fault, _, name = query.removeprefix("fault=").partition("=")
    special = (fault, name) if fault in ("gloss", "glass") else ("", "")
    address = f"mock://{scene}?seed=1&{query}"
    exact = open_scene(f"scene://{scene}").scene
    images: dict[str, tuple[float, float] | str] = {}
    truth: dict[bool, _Truth] = {}
    for column in COLUMNS:
        camera = ring if column in _RING else create("equirectangular", **size)
        if camera.central not in truth:
            truth[camera.central] = _Truth(exact, camera, pose, special)
        try:
            with open_source(address, exposure="game", **_DEADLINES) as source:
                options = {"face_size": face_size, "checks": checks, **_RING.get(column, {})}
                image = render(camera, pose, source, _MODES, **options)
        except OmniscvError as refusal:
            images[column] = f"{type(refusal).__name__}: {refusal}"
        else:
            images[column] = truth[camera.central].judge(image)
    if address.endswith("&") and pose is not _POSE:
        return _Outcome(images, frozenset())  # a sound server
    try:
        findings = examine_address(address, pose.position, **_DEADLINES)
    except OmniscvError as refusal:
        return _Outcome(images, frozenset({type(refusal).__name__}))
    return _Outcome(images, frozenset(finding.name for finding in findings if finding.verdict != "ok"))


def _scene(cause: Cause, strength: float | str, folder: Path) -> str:
    """Return the name of a cause's scene, or the path of one that is written into the folder."""
    if cause.scene != "parts":
        return cause.scene
    path = folder / f"{cause.name.replace(' ', '-')}-{strength}.yaml"
    path.write_text(_ROOM.format(", ".join(_solids(cause.name, float(strength)))))
    return quote(str(path))


def _rows(cause: Cause, strength: float | str, outcome: _Outcome, sound: _Outcome) -> Iterator[Row]:
    """Yield the rows of a cause at a strength; ``sound`` is the outcome without the fault."""
    findings = tuple(sorted(outcome.findings - sound.findings))
    for column, result in outcome.images.items():
        base = sound.images[column]
        assert not isinstance(base, str), base
        where = (cause.name, cause.unit, strength, column)
        if isinstance(result, str):
            yield Row(*where, wrong=None, unmarked=None, said="refused", findings=findings, refusal=result)
            continue
        wrong, unmarked = result
        if wrong <= base[0] + _BROKEN and unmarked <= base[1] + _BROKEN:
            answer = "holds"
        elif findings:
            answer = "doctor"
        else:
            answer = "marked" if unmarked <= base[1] + _UNMARKED else "silent"
        yield Row(*where, wrong, unmarked, answer, findings)


def write(rows: Sequence[Row], out: Path) -> list[Path]:
    """Write the measurements ``rows`` and draw them: ``chart-failures`` as JSON, SVG and PNG in the folder
    ``out``."""
    causes = list(dict.fromkeys(row.cause for row in rows))
    size = 1.2 + _LINE_IN * len(causes)
    title = f"{finding(rows)}. {_KEY}"
    figure, panels = drawing.figure(len(COLUMNS), size, title, len(causes), shared=True)
    for axes, (cause, column) in zip(panels, product(causes, COLUMNS), strict=True):
        _draw(axes, [row for row in rows if (row.cause, row.column) == (cause, column)])
    for axes, column in zip(panels, COLUMNS, strict=False):
        axes.set_title(column, size=10, color=drawing.INK)
    for axes, cause in zip(panels[:: len(COLUMNS)], causes, strict=True):
        rows_here = [row for row in rows if row.cause == cause]
        strengths = f"{rows_here[0].strength} to {rows_here[-1].strength}"
        text = f"{cause}\n{strengths} {rows_here[0].unit}"
        axes.set_ylabel(text, rotation=0, ha="right", va="center", size=8, color=drawing.INK)
    for color, label in ANSWERS.values():
        panels[0].plot([], [], "o", color=color, label=label, ms=6)
    figure.legend(loc="outside lower center", ncols=len(ANSWERS), frameon=False, fontsize=8.5)
    return drawing.write(rows, figure, out, "chart-failures")


def _draw(axes: Axes, rows: Sequence[Row]) -> None:
    """Draw the share of wrong pixels by strength, and the software's answers."""
    axes.semilogy(range(len(rows)), [_height(row) for row in rows], color="#c3c9d2", lw=1.2, zorder=1)
    for i, row in enumerate(rows):
        color = ANSWERS[row.said][0]
        if row.said == "refused":
            axes.plot(i, _height(row), "x", ms=5.5, zorder=2, color=color, mew=2)
        else:
            axes.plot(i, _height(row), "o", ms=5.5, zorder=2, color=color, mew=0)
    axes.set(ylim=(_LEAST / 2, 6), xlim=(-0.5, max(len(rows), 1) - 0.5))
    axes.tick_params(left=False, bottom=False, labelleft=False, labelbottom=False, which="both")
    for side in axes.spines.values():
        side.set(color="#d5d9e0", lw=0.6)


def _height(row: Row) -> float:
    """Return the share of wrong pixels as it is drawn: all of a refused image, and not 0."""
    return 1.0 if row.wrong is None else max(row.wrong, _LEAST)


def finding(rows: Sequence[Row]) -> str:
    """Return the title, which states the result."""
    failures = sum(row.said != "holds" for row in rows)
    silent = sum(row.said == "silent" for row in rows)
    return f"Of {failures} failures, {failures - silent} are refused, found or marked; {silent} are silent"
