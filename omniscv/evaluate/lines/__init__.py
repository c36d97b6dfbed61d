"""The evaluation ``lines``: lines in space from one non-central image.

The edges of a room, where the exact labels of an image change, are reconstructed from that image alone and
compared with the truth: free, with known gravity, and along the directions of a Manhattan world. The paper's
section on 3D line reconstruction.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from omniscv import cameras
from omniscv.cameras import Camera
from omniscv.compose.image import OmniImage
from omniscv.compose.renderer import Renderer
from omniscv.errors import ArgumentError
from omniscv.evaluate import BLUE, GREEN, INK, RED, Figure, Report, Row, Settings, chart
from omniscv.evaluate.lines import reconstruction
from omniscv.evaluate.lines.reconstruction import ObservedLine, through
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
    ("panorama", "vertical"): 0.05, ("panorama", "horizontal"): 0.4,
    ("cone", "vertical"): 0.05, ("cone", "horizontal"): 0.1,
}  # fmt: skip
"""Effective baselines from which on a room's edge counts in the figures."""
_LEAST_POINTS = 40  # of an edge in an image
_LEAST_BASELINE_M = 0.05  # effective baseline of edges from exact points and in the picture

_COLORS = {"free": RED, "gravity": BLUE, "Manhattan": GREEN}
_MARKERS = {"vertical": "^", "horizontal": "o"}
_LIMITS = {"distance_m": (1e-3, 10.0), "direction_deg": (1e-3, 90.0)}
_MOST_POINTS = 10000


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


class Edge(NamedTuple):
    """An edge of a room, where two of its surfaces meet.

    Attributes:
        kind: ``vertical`` or ``horizontal``.
        surfaces: names of the two.
        ends_w: (2, 3) metres, world frame.
    """

    kind: Literal["vertical", "horizontal"]
    surfaces: tuple[str, str]
    ends_w: Array

    def line_c(self, pose: Pose) -> Array:
        """Return the line (6,), camera frame."""
        start, end = pose.to_camera(self.ends_w)
        return through(start, end - start)


Seen = list[tuple[Edge, ObservedLine]]


class Segment(NamedTuple):
    """A reconstructed segment.

    Attributes:
        ends_c: (2, 3) metres, camera frame.
        true_w: (2, 3) metres, world frame, the ends of the true edge.
        pixels: (N, 2) px of the image that show it.
    """

    ends_c: Array
    true_w: Array
    pixels: Array


def evaluate(settings: Settings) -> Report:
    """Reconstruct, and compare with the truth; ArgumentError for a source without a known room."""
    setups = _setups(settings.quick)
    rows = list[Row]()
    distances = list[float]()  # of lines from exact points
    errors = settings.out / "lines.png"
    cloud = settings.out / "lines-cloud.png"
    with open_source(settings.source or _SCENE) as source:
        room = source.geometry().room
        names = source.objects().names()
        if room is None:
            raise ArgumentError("source: expected one with a known room, got none; try scene://four-wall")
        renderer = Renderer(source)
        options = RenderOptions(strategy="exact")
        for done, setup in enumerate(setups, start=1):
            for baseline, distance in exact_errors(room, setup):
                if baseline >= _LEAST_BASELINE_M:
                    distances.append(distance)
            image = renderer.render(setup.camera, setup.pose, ("lit", "object_mask", "depth"), options)
            seen = seen_edges(room, setup.camera, image["labels"], names)
            lines = reconstruct(seen, setup)
            rows += score(seen, lines, setup)
            if done == 1:
                draw_cloud(image, _segments(seen, lines["gravity"]), cloud)
            settings.progress(done, len(setups))
    draw_errors(rows, errors)
    worst = max(distances, default=float("nan"))
    of_exact = Figure("exact points >= 0.05 m, free: distance", worst, "m", n=len(distances))
    about = {}
    for setup in setups:
        about[setup.name] = {"camera": setup.camera.to_dict(), "pose": setup.pose.to_dict()}
    return Report([of_exact, *figures(rows)], rows, about, [errors, cloud])


def room_edges(room: Room) -> Iterator[Edge]:
    """Yield where walls meet each other, the floor and the ceiling."""
    count = len(room.corners_w)
    low = np.column_stack([room.corners_w, np.full(count, room.floor_z)])
    high = np.column_stack([room.corners_w, np.full(count, room.ceiling_z)])
    for start, wall in enumerate(room.walls):
        end = (start + 1) % count
        yield Edge("vertical", (room.walls[start - 1], wall), np.array([low[start], high[start]]))
        yield Edge("horizontal", (wall, room.floor), low[[start, end]])
        yield Edge("horizontal", (wall, room.ceiling), high[[start, end]])


def seen_edges(room: Room, camera: Camera, labels: NDArray[np.uint16], names: Sequence[str]) -> Seen:
    """Return the edges that an image shows, and the pixels where it does.

    Args:
        room: that the image shows.
        camera: of the image.
        labels: (H, W) of the image.
        names: of the labels from 1 on.
    """
    label = {name: number for number, name in enumerate(names, start=1)}
    seen = list[tuple[Edge, ObservedLine]]()
    for edge in room_edges(room):
        first, second = edge.surfaces
        if first in label and second in label:
            pixels = boundary(labels, label[first], label[second])
            if len(pixels) >= _LEAST_POINTS:
                seen.append((edge, ObservedLine(camera, pixels)))
    return seen


def boundary(labels: NDArray[np.uint16], a: int, b: int) -> Array:
    """Return the midpoints of neighbouring pixels, (N, 2) px, of which one has the label ``a``, one ``b``.

    ``labels`` are those of the image, (H, W).
    """
    is_a = labels == a
    is_b = labels == b
    beside = is_a[:, :-1] & is_b[:, 1:] | is_b[:, :-1] & is_a[:, 1:]
    below = is_a[:-1] & is_b[1:] | is_b[:-1] & is_a[1:]
    points = np.argwhere(beside) + np.array([0.5, 1.0]), np.argwhere(below) + np.array([1.0, 0.5])
    return np.concatenate(points)[:, ::-1]


def reconstruct(seen: Seen, setup: Setup) -> Mapping[str, list[Array]]:
    """Return the lines (6,), camera frame, by prior knowledge: free, gravity, Manhattan.

    Args:
        seen: the edges in an image, and their pixels.
        setup: camera and pose of the image.
    """
    observed = []
    level = []
    free = []
    for _, line in seen:
        observed.append(line)
        level.append(reconstruction.with_gravity(line, setup.gravity))
        free.append(reconstruction.free(line, setup.axis))
    aligned = reconstruction.manhattan(observed, level, setup.gravity)
    return {"free": free, "gravity": level, "Manhattan": aligned}


def score(seen: Seen, lines: Mapping[str, list[Array]], setup: Setup) -> Iterator[Row]:
    """Yield the errors of all lines.

    A distance is that between the points of the reconstructed and of the true line that one pixel sees, the
    largest of all pixels.

    Args:
        seen: the edges in an image, and their pixels.
        lines: as of :func:`reconstruct`.
        setup: camera and pose of the image.
    """
    for prior, reconstructed in lines.items():
        for (edge, observed), line in zip(seen, reconstructed, strict=True):
            true = edge.line_c(setup.pose)
            rays = observed.origins, observed.directions
            off = reconstruction.nearest_to_rays(line, *rays) - reconstruction.nearest_to_rays(true, *rays)
            yield {
                "image": setup.name,
                "camera": setup.name.split("-")[0],
                "prior": prior,
                "kind": edge.kind,
                "edge": " | ".join(edge.surfaces),
                "points": len(observed.pixels),
                "baseline_m": reconstruction.effective_baseline(*rays),
                "direction_deg": reconstruction.angle_deg(line[:3], true[:3]),
                "distance_m": float(np.linalg.norm(off, axis=1).max()),
                "rms_px": observed.rms_px(line),
            }


def exact_errors(room: Room, setup: Setup) -> list[tuple[float, float]]:
    """Return (effective baseline, largest distance), metres, of lines from exact points of a room's edges.

    ``setup`` is the camera, and its pose in the ``room``.
    """
    errors = []
    for edge in room_edges(room):
        start, end = setup.pose.to_camera(edge.ends_w)
        points = np.linspace(start, end, _EXACT_POINTS)
        pixels, valid = setup.camera.project(points)
        rays = setup.camera.unproject(pixels[valid])
        if valid.sum() >= _EXACT_POINTS // 2 and rays.valid.all():
            rows = reconstruction.incidence(rays.origins, rays.directions)
            line = reconstruction.free_line(rows, setup.axis)
            baseline = reconstruction.effective_baseline(rays.origins, rays.directions)
            errors.append((baseline, float(reconstruction.distance_to(line, points[valid]).max())))
    return errors


def figures(rows: Sequence[Row]) -> list[Figure]:
    """Return the worst errors of a room's edges with a sufficient effective baseline."""
    worst = []
    for (camera, kind), least in _BASELINES_M.items():
        for prior in dict.fromkeys(row["prior"] for row in rows):
            selected = []
            for row in rows:
                is_of_group = row["camera"] == camera and row["kind"] == kind and row["prior"] == prior
                if is_of_group and row["baseline_m"] >= least:
                    selected.append(row)
            if not selected:
                continue
            for key, unit in (("distance_m", "m"), ("direction_deg", "deg")):
                name = f"{camera}, {kind} >= {least:g} m, {prior}: {key.split('_')[0]}"
                worst.append(Figure(name, max(row[key] for row in selected), unit, n=len(selected)))
    return worst


def _segments(seen: Seen, lines: Sequence[Array]) -> list[Segment]:
    """Return the lines of sufficient effective baseline, between their outermost points in the image."""
    segments = []
    for (edge, observed), line in zip(seen, lines, strict=True):
        rays = observed.origins, observed.directions
        points = reconstruction.nearest_to_rays(line, *rays)
        along = points @ line[:3]
        if reconstruction.effective_baseline(*rays) >= _LEAST_BASELINE_M:
            ends = points[[along.argmin(), along.argmax()]]
            segments.append(Segment(ends, edge.ends_w, observed.pixels))
    return segments


def _setups(quick: bool) -> list[Setup]:
    """Return the paper's panorama, tilted by 10 degrees; unless ``quick`` at three poses, and a cone above a
    camera that looks up, whose reflections lie on a circle of R_c = 0.47 m."""
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


def draw_errors(rows: Sequence[Row], path: Path) -> None:
    """Draw the errors of ``rows`` over the effective baseline, into the picture at ``path``."""
    groups: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["prior"], row["kind"], row["camera"]), []).append(row)
    labels = {"distance_m": "largest distance, m", "direction_deg": "direction, deg"}
    with chart(path, 1000, 480) as drawing:
        panels = drawing.subplots(1, 2)
        for axes, (key, label) in zip(panels, labels.items(), strict=True):
            for (prior, kind, camera), members in groups.items():
                values = np.clip([row[key] for row in members], *_LIMITS[key])
                face = _COLORS[prior] if camera == "panorama" else "none"
                style = {"fc": face, "ec": _COLORS[prior], "marker": _MARKERS[kind]}
                axes.scatter([row["baseline_m"] for row in members], values, s=28, lw=0.9, **style)
            axes.set(xscale="log", yscale="log", xlabel="effective baseline, m", ylabel=label)
            axes.xaxis.set_major_formatter("{x:g}")
            axes.xaxis.set_minor_formatter("")
            axes.yaxis.set_major_formatter("{x:g}")
            axes.grid(True, which="both", lw=0.4, alpha=0.4)
        for prior, color in _COLORS.items():
            panels[0].scatter([], [], s=28, c=color, label=prior, lw=0)
        for kind in dict.fromkeys(kind for _, kind, _ in groups):
            panels[0].scatter([], [], s=28, c=INK, marker=_MARKERS[kind], label=f"{kind} edge", lw=0)
        panels[0].scatter([], [], s=28, fc="none", ec=INK, label="outlined: conical mirror", lw=0.9)
        panels[0].legend(fontsize=8)
        panels[1].set_title("what is beyond an axis is drawn at its end", size=9)
        drawing.suptitle("Lines from one non-central image need baseline; gravity makes up for much", size=11)


def draw_cloud(image: OmniImage, segments: Sequence[Segment], path: Path) -> None:
    """Draw an ``image`` with its edges, and three views of ``segments`` among the true points.

    As in the paper: segments red, truth black, optical centres blue. The picture is written to ``path``.
    """
    points = image.points()
    points = points[:: -(-len(points) // _MOST_POINTS)]
    views = {"from above and beside": (35.0, 30.0), "from above": (0.0, 90.0), "from beside": (0.0, 0.0)}
    with chart(path, 1000, 800) as drawing:
        grid = drawing.add_gridspec(2, 3, height_ratios=(1.15, 1))
        axes = drawing.add_subplot(grid[0, :])
        axes.imshow(image["lit"], extent=(0, image.camera.width, image.camera.height, 0))
        for segment in segments:
            axes.plot(*segment.pixels.T, ".", color=RED, ms=1.5)
        axes.set_axis_off()
        axes.set_title("edges between walls, floor and ceiling, from labels", size=9)
        for column, (title, angles_deg) in enumerate(views.items()):
            axes = drawing.add_subplot(grid[1, column])
            _draw_view(axes, image, points, segments, angles_deg)
            axes.set_title(title, size=9)
        finding = f"{len(segments)} edges of a room, reconstructed from one image, among its true points"
        drawing.suptitle(finding, size=11)


def _draw_view(
    axes: Axes, image: OmniImage, points_w: Array, segments: Sequence[Segment], angles_deg: Sequence[float]
) -> None:
    """Draw a parallel projection: seen from -Y, turned about Z, and lifted, by two angles."""
    turn, lift = np.radians(angles_deg)
    right = np.array([np.cos(turn), np.sin(turn), 0.0])
    back = np.array([-np.sin(turn), np.cos(turn), 0.0])
    projection = np.array([right, np.sin(lift) * back + np.cos(lift) * np.array([0.0, 0.0, 1.0])])
    axes.plot(*projection @ points_w.T, ".", color=INK, ms=0.5, alpha=0.25)
    centers = np.unique(np.round(image.centers_w.reshape(-1, 3), 6), axis=0)
    axes.plot(*projection @ centers.T, ".", color=BLUE, ms=1.5)
    up = image.pose.position + np.array([[0, 0, 0], [0, 0, 0.8]])
    axes.plot(*projection @ up.T, "-", color=GREEN, lw=1.5)
    for segment in segments:
        axes.plot(*projection @ segment.true_w.T, "-", color=INK, lw=2.5, alpha=0.6)
        axes.plot(*projection @ image.pose.to_world(segment.ends_c).T, "-", color=RED, lw=1.5)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=7)
    axes.set_xlabel("m", size=7)
