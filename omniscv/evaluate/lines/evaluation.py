"""Lines in space from one non-central image: the paper's section on 3D line reconstruction.

The edges of a room, where the exact labels of an image change, are reconstructed from that image alone and
compared with the truth: free, with known gravity, and along the directions of a Manhattan world.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from omniscv import cameras
from omniscv.cameras import Camera
from omniscv.compose.renderer import Renderer
from omniscv.errors import ArgumentError
from omniscv.evaluate.lines import chart as lines_chart
from omniscv.evaluate.lines import plucker, priors
from omniscv.evaluate.lines.noncentral import effective_baseline, free_line
from omniscv.evaluate.lines.true_edges import Seen, room_edges, seen_edges
from omniscv.evaluate.registry import Settings
from omniscv.evaluate.report import Figure, Report
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
_WELL = {
    ("panorama", "vertical"): 0.05,
    ("panorama", "horizontal"): 0.4,
    ("cone", "vertical"): 0.05,
    ("cone", "horizontal"): 0.1,
}
"""Effective baselines, metres, from which on a room's edge counts in the figures."""
_EXACT_FROM_M = _DRAWN_M = 0.05

Row = Mapping[str, Any]


class Shot(NamedTuple):
    """An image to take: its camera, and from where."""

    name: str
    camera: Camera
    pose: Pose

    @property
    def axis(self) -> Array:
        return _AXIS[self.camera.name]

    @property
    def gravity(self) -> Array:
        return _DOWN_W @ self.pose.R_w_c


def evaluate(settings: Settings) -> Report:
    """Reconstruct, and compare with the truth.

    Args:
        settings: with a source, images are taken around its origin; it knows its room.

    Raises:
        ArgumentError: a source without a room.
        OmniscvError: of the source.
    """
    shots = _shots(settings.quick)
    rows: list[Row] = []
    exact: list[tuple[float, float]] = []
    chart, cloud = settings.out / "lines.png", settings.out / "lines-cloud.png"
    with open_source(settings.source or _SCENE) as source:
        geometry, names = source.geometry(), source.objects().names()
        room = geometry.room
        if room is None:
            raise ArgumentError(
                "source: expected one that knows its room, got one without; try scene://four-wall"
            )
        renderer = Renderer(source)
        options = RenderOptions(strategy="auto" if settings.source else "strips")
        for done, shot in enumerate(shots):
            exact += exact_errors(room, shot)
            image = renderer.render(shot.camera, shot.pose, ("lit", "object_mask", "depth"), options)
            seen = seen_edges(geometry, shot.camera, shot.pose, image["labels"], names)
            found = reconstructed(seen, shot)
            rows += scored(seen, found, shot)
            if done == 0:
                lines_chart.draw_cloud(image, _segments(seen, found), cloud)
            settings.progress(done + 1, len(shots))
    lines_chart.draw_errors(rows, chart)
    about = {shot.name: {"camera": shot.camera.to_dict(), "pose": shot.pose.to_dict()} for shot in shots}
    return Report([_exact_figure(exact), *figures(rows)], rows, about, [chart, cloud])


def reconstructed(seen: Seen, shot: Shot) -> Mapping[str, list[Array]]:
    """Return the lines (6,), camera frame, by what is known beforehand."""
    observed = [each for _, each in seen]
    level = [priors.with_gravity(each, shot.gravity) for each in observed]
    return {
        "free": [priors.free(each, shot.axis) for each in observed],
        "gravity": level,
        "Manhattan": priors.manhattan(observed, level, shot.gravity),
    }


def scored(seen: Seen, found: Mapping[str, list[Array]], shot: Shot) -> Iterator[Row]:
    """Yield the errors of all lines; distances are between the points of the line that was found and of the
    true one which the same pixel sees, the largest of all pixels."""
    for prior, lines in found.items():
        for (edge, observed), line in zip(seen, lines, strict=True):
            true = edge.line_c(shot.pose)
            rays = observed.origins, observed.directions
            off = plucker.nearest_to_rays(line, *rays) - plucker.nearest_to_rays(true, *rays)
            yield {
                "image": shot.name,
                "camera": shot.name.split("-")[0],
                "prior": prior,
                "kind": edge.kind,
                "of": edge.of,
                "edge": edge.name,
                "points": len(observed.pixels),
                "baseline_m": effective_baseline(*rays),
                "direction_deg": plucker.angle_deg(line[:3], true[:3]),
                "distance_m": float(np.linalg.norm(off, axis=1).max()),
                "rms_px": observed.rms_px(line),
            }


def exact_errors(room: Room, shot: Shot) -> list[tuple[float, float]]:
    """Return (effective baseline, largest distance), metres, of lines from exact points of the edges."""
    found = []
    for edge, _ in room_edges(room):
        points = edge.points_c(shot.pose, _EXACT_POINTS)
        pixels, valid = shot.camera.project(points)
        rays = shot.camera.unproject(pixels[valid])
        if valid.sum() >= _EXACT_POINTS // 2 and rays.valid.all():
            line = free_line(plucker.incidence(rays.origins, rays.directions), shot.axis)
            baseline = effective_baseline(rays.origins, rays.directions)
            found.append((baseline, float(plucker.distance_to(line, points[valid]).max())))
    return found


def figures(rows: Sequence[Row]) -> list[Figure]:
    """Return the worst errors of a room's edges of a sufficient effective baseline."""
    found = []
    for (camera, kind), least in _WELL.items():
        for prior in dict.fromkeys(row["prior"] for row in rows):
            wanted = camera, kind, prior, "room"
            mine = [r for r in rows if (r["camera"], r["kind"], r["prior"], r["of"]) == wanted]
            well = [row for row in mine if row["baseline_m"] >= least]
            for key, unit in (("distance_m", "m"), ("direction_deg", "deg")) if well else ():
                name = f"{camera}, {kind} >= {least:g} m, {prior}: {key.split('_')[0]}"
                found.append(Figure(name, max(row[key] for row in well), unit, n=len(well)))
    return found


def _exact_figure(exact: Sequence[tuple[float, float]]) -> Figure:
    well = [distance for baseline, distance in exact if baseline >= _EXACT_FROM_M]
    return Figure("exact points >= 0.05 m, free: distance", max(well, default=float("nan")), "m", n=len(well))


def _segments(seen: Seen, found: Mapping[str, list[Array]]) -> list[lines_chart.Segment]:
    """What is drawn: of the lines with gravity those of a sufficient effective baseline, from the first to
    the last of their points that the image shows."""
    segments = []
    for (edge, observed), line in zip(seen, found["gravity"], strict=True):
        rays = observed.origins, observed.directions
        points = plucker.nearest_to_rays(line, *rays)
        along = points @ line[:3]
        if effective_baseline(*rays) >= _DRAWN_M:
            ends = points[[along.argmin(), along.argmax()]]
            segments.append(lines_chart.Segment(ends, edge.ends_w, observed.pixels))
    return segments


def _shots(quick: bool) -> list[Shot]:
    """The paper's panorama, tilted by 10 degrees, and a cone above a camera that looks up, whose reflections
    in it lie on a circle of R_c = 0.47 m."""
    width = 640 if quick else 2048
    panorama = cameras.create("noncentral-panorama", width=width, height=width // 2, radius=1.0)
    shots = [Shot("panorama-1", panorama, Pose.from_angles((0.0, 0.0, 1.5), 20, 10, 0))]
    if quick:
        return shots
    cone = cameras.create(
        "noncentral-conical-mirror", width=1024, height=1024, half_angle_deg=55, distance=0.5
    )
    shots.append(Shot("panorama-2", panorama, Pose.from_angles((-0.3, 0.2, 1.3), 75, 10, 0)))
    shots.append(Shot("panorama-3", panorama, Pose.from_angles((0.2, -0.2, 1.6), 130, 8, -6)))
    return [*shots, Shot("cone", cone, Pose.from_angles((0.0, 0.0, 1.0), 20, 80, 0))]
