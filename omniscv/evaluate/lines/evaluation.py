"""The evaluation ``lines``: lines in space from one non-central image.

The edges of a room, where the exact labels of an image change, are reconstructed from that image alone and
compared with the truth: free, with known gravity, and along the directions of a Manhattan world. The paper's
section on 3D line reconstruction.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from omniscv import cameras
from omniscv.cameras import Camera
from omniscv.compose.renderer import Renderer
from omniscv.errors import ArgumentError
from omniscv.evaluate.lines import plucker, reconstruction
from omniscv.evaluate.lines.chart import Segment, draw_cloud, draw_errors
from omniscv.evaluate.lines.true_edges import Seen, room_edges, seen_edges
from omniscv.evaluate.registry import Settings
from omniscv.evaluate.report import Figure, Report, Row
from omniscv.geometry import Pose
from omniscv.geometry.pose import Array
from omniscv.geometry.scene_geometry import Room
from omniscv.planning import RenderOptions
from omniscv.sources.registry import open_source

OPTIONS: frozenset[str] = frozenset()

_SCENE = "scene://four-wall"
_EXACT_POINTS = 60
_DOWN_W = np.array([0.0, 0.0, -1.0])
_AXIS = {"noncentral-panorama": np.array([0.0, 1.0, 0.0]), "noncentral-conical-mirror": np.array([0, 0, 1.0])}
_BASELINES_M = {
    ("panorama", "vertical"): 0.05,
    ("panorama", "horizontal"): 0.4,
    ("cone", "vertical"): 0.05,
    ("cone", "horizontal"): 0.1,
}
"""Effective baselines from which on a room's edge counts in the figures."""
_LEAST_BASELINE_M = 0.05  # of edges from exact points, and of drawn ones


class Setup(NamedTuple):
    """A camera and its pose."""

    name: str
    camera: Camera
    pose: Pose

    @property
    def axis(self) -> Array:
        """(3,) unit, of the camera's revolution, camera frame."""
        return _AXIS[self.camera.name]

    @property
    def gravity(self) -> Array:
        """(3,) unit, camera frame."""
        return _DOWN_W @ self.pose.R_w_c


def evaluate(settings: Settings) -> Report:
    """Reconstruct, and compare with the truth.

    Args:
        settings: with a source that knows its room, images are taken around its origin.

    Raises:
        ArgumentError: a source without a known room.
        OmniscvError: of the source.
    """
    setups = _setups(settings.quick)
    rows, exact = list[Row](), list[tuple[float, float]]()
    errors, cloud = settings.out / "lines.png", settings.out / "lines-cloud.png"
    with open_source(settings.source or _SCENE) as source:
        geometry, names = source.geometry(), source.objects().names()
        if geometry.room is None:
            raise ArgumentError("source: expected one with a known room, got none; try scene://four-wall")
        renderer = Renderer(source)
        options = RenderOptions(strategy="auto" if settings.source else "strips")
        for done, setup in enumerate(setups, start=1):
            exact += exact_errors(geometry.room, setup)
            image = renderer.render(setup.camera, setup.pose, ("lit", "object_mask", "depth"), options)
            seen = seen_edges(geometry, setup.camera, setup.pose, image["labels"], names)
            lines = reconstruct(seen, setup)
            rows += score(seen, lines, setup)
            if done == 1:
                draw_cloud(image, _segments(seen, lines["gravity"]), cloud)
            settings.progress(done, len(setups))
    draw_errors(rows, errors)
    about = {setup.name: {"camera": setup.camera.to_dict(), "pose": setup.pose.to_dict()} for setup in setups}
    return Report([_exact_figure(exact), *figures(rows)], rows, about, [errors, cloud])


def reconstruct(seen: Seen, setup: Setup) -> Mapping[str, list[Array]]:
    """Return the lines (6,), camera frame, by prior knowledge: free, gravity, Manhattan."""
    observed = [line for _, line in seen]
    level = [reconstruction.with_gravity(line, setup.gravity) for line in observed]
    return {
        "free": [reconstruction.free(line, setup.axis) for line in observed],
        "gravity": level,
        "Manhattan": reconstruction.manhattan(observed, level, setup.gravity),
    }


def score(seen: Seen, lines: Mapping[str, list[Array]], setup: Setup) -> Iterator[Row]:
    """Yield the errors of all lines.

    Distances are between the points of the reconstructed and of the true line that the same pixel sees, the
    largest of all pixels.
    """
    for prior, found in lines.items():
        for (edge, observed), line in zip(seen, found, strict=True):
            true = edge.line_c(setup.pose)
            rays = observed.origins, observed.directions
            off = plucker.nearest_to_rays(line, *rays) - plucker.nearest_to_rays(true, *rays)
            yield {
                "image": setup.name,
                "camera": setup.name.split("-")[0],
                "prior": prior,
                "kind": edge.kind,
                "of": edge.of,
                "edge": edge.name,
                "points": len(observed.pixels),
                "baseline_m": plucker.effective_baseline(*rays),
                "direction_deg": plucker.angle_deg(line[:3], true[:3]),
                "distance_m": float(np.linalg.norm(off, axis=1).max()),
                "rms_px": observed.rms_px(line),
            }


def exact_errors(room: Room, setup: Setup) -> list[tuple[float, float]]:
    """Return (effective baseline, largest distance), metres, of lines from exact points of the edges."""
    errors = []
    for edge, _ in room_edges(room):
        points = edge.points_c(setup.pose, _EXACT_POINTS)
        pixels, valid = setup.camera.project(points)
        rays = setup.camera.unproject(pixels[valid])
        if valid.sum() >= _EXACT_POINTS // 2 and rays.valid.all():
            line = plucker.free_line(plucker.incidence(rays.origins, rays.directions), setup.axis)
            baseline = plucker.effective_baseline(rays.origins, rays.directions)
            errors.append((baseline, float(plucker.distance_to(line, points[valid]).max())))
    return errors


def figures(rows: Sequence[Row]) -> list[Figure]:
    """Return the worst errors of a room's edges with a sufficient effective baseline."""
    worst = []
    for (camera, kind), least in _BASELINES_M.items():
        for prior in dict.fromkeys(row["prior"] for row in rows):
            group = camera, kind, prior, "room"
            mine = [r for r in rows if (r["camera"], r["kind"], r["prior"], r["of"]) == group]
            mine = [row for row in mine if row["baseline_m"] >= least]
            for key, unit in (("distance_m", "m"), ("direction_deg", "deg")) if mine else ():
                name = f"{camera}, {kind} >= {least:g} m, {prior}: {key.split('_')[0]}"
                worst.append(Figure(name, max(row[key] for row in mine), unit, n=len(mine)))
    return worst


def _exact_figure(exact: Sequence[tuple[float, float]]) -> Figure:
    distances = [distance for baseline, distance in exact if baseline >= _LEAST_BASELINE_M]
    worst = max(distances, default=float("nan"))
    return Figure("exact points >= 0.05 m, free: distance", worst, "m", n=len(distances))


def _segments(seen: Seen, lines: Sequence[Array]) -> list[Segment]:
    """The lines with a sufficient effective baseline, between their outermost points in the image."""
    segments = []
    for (edge, observed), line in zip(seen, lines, strict=True):
        rays = observed.origins, observed.directions
        points = plucker.nearest_to_rays(line, *rays)
        along = points @ line[:3]
        if plucker.effective_baseline(*rays) >= _LEAST_BASELINE_M:
            ends = points[[along.argmin(), along.argmax()]]
            segments.append(Segment(ends, edge.ends_w, observed.pixels))
    return segments


def _setups(quick: bool) -> list[Setup]:
    """The paper's panorama, tilted by 10 degrees, and a cone above a camera that looks up, whose reflections
    lie on a circle of R_c = 0.47 m."""
    width = 640 if quick else 2048
    panorama = cameras.create("noncentral-panorama", width=width, height=width // 2, radius=1.0)
    first = Setup("panorama-1", panorama, Pose.from_angles((0.0, 0.0, 1.5), 20, 10, 0))
    if quick:
        return [first]
    shape = {"half_angle_deg": 55, "distance": 0.5}
    cone = cameras.create("noncentral-conical-mirror", width=1024, height=1024, **shape)
    return [
        first,
        Setup("panorama-2", panorama, Pose.from_angles((-0.3, 0.2, 1.3), 75, 10, 0)),
        Setup("panorama-3", panorama, Pose.from_angles((0.2, -0.2, 1.6), 130, 8, -6)),
        Setup("cone", cone, Pose.from_angles((0.0, 0.0, 1.0), 20, 80, 0)),
    ]
