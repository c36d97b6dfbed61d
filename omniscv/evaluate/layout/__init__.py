"""The evaluation ``layout``: scores of predicted room layouts, beside the paper's scores of CFL.

Panoramas of a room of four walls and of an L of six, from 5 viewpoints in 2 orientations each, are written
with their truth into ``OUT/layout``. The option ``predictions`` is a folder of layouts that a network
predicted for them (``predictions.py``). ``perfect`` is the true layout, drawn as a prediction is. It scores
less than 1, because CFL applies different thresholds to truth and prediction.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

import omniscv
from omniscv.arguments import within
from omniscv.cameras import Camera
from omniscv.dataset.pictures import write_pixels
from omniscv.errors import ArgumentError
from omniscv.evaluate import INK, RED, Figure, Report, Row, Settings, chart
from omniscv.evaluate.layout import predictions
from omniscv.evaluate.layout.predictions import Prediction, visible_curves
from omniscv.geometry import Pose
from omniscv.geometry.pose import Array
from omniscv.geometry.scene_geometry import Room, SceneGeometry
from omniscv.score.layouts import LayoutScores, layout_scores, map_scores
from omniscv.sources import Source
from omniscv.storage.local import write_text
from omniscv.truth import layout, project_layout
from omniscv.truth.layout_labels import Map, cor_id, lines_of, original_maps
from omniscv.truth.room_in_image import inside

SCENES = "mock://four-wall", "mock://six-wall"

_WIDTH = 1024  # of panoramas, px
_QUICK_WIDTH = 512
_VIEWPOINTS = 5  # in each room
_QUICK_VIEWPOINTS = 2
_YAWS_DEG = 17.0, 62.0  # neither along the walls
_TURN_DEG = 31.0  # from one viewpoint to the next
_HEIGHT_M = 1.5  # of viewpoints above the floor
_GRID_M = 0.25  # between candidates for viewpoints
_FROM_WALLS_M = 0.6  # least distance of viewpoints
_FROM_OBJECTS_M = 0.3  # least distance of viewpoints
_FITTED = ("object_mask", "depth", "normals")  # the modes that a room is fitted to
_CUBE_FACES = 6  # views of a recorded viewpoint that show all around it
_FACE_FOV_DEG = 89.0  # least field of view of such a view


@dataclass(frozen=True, eq=False)
class Panorama:
    """A panorama and the truth of its layout.

    Attributes:
        name: start of its file names.
        group: such as ``4-wall``.
        lit: (H, W, 3) RGB.
        corners: (2N, 2) px; see :mod:`omniscv.truth.layout_labels`.
        maps: (H, W) uint8 of edges and of corners, by the paper's recipe.
    """

    name: str
    group: str
    lit: NDArray[np.uint8]
    corners: Array
    maps: tuple[Map, Map]


def count(settings: Settings) -> int:
    """Return how many panoramas :func:`render` yields, at most."""
    return (1 if settings.source else len(SCENES)) * _extent(settings)[1] * len(_YAWS_DEG)


def render(settings: Settings) -> Iterator[Panorama]:
    """Yield upright panoramas of the mock's rooms, or of the room that a source shows.

    Raises:
        ArgumentError: a source without a known room, or without a free viewpoint in it.
        OmniscvError: of the source.
    """
    width, viewpoints = _extent(settings)
    camera = omniscv.cameras.create("equirectangular", width, width // 2)
    for address in (settings.source,) if settings.source else SCENES:
        with omniscv.open_source(address) as source, within(f"layout: {address}"):
            name = "room" if settings.source else address.partition("://")[2]
            renderer = omniscv.Renderer(source)
            geometry = source.geometry()
            positions = _positions(source, geometry, viewpoints)
            room = geometry.room
            if room is None:  # fitted to images
                small = omniscv.cameras.create("equirectangular", _QUICK_WIDTH, _QUICK_WIDTH // 2)
                images = []
                for position in positions:
                    images.append(renderer.render(small, Pose.from_angles(tuple(position)), _FITTED))
                room = layout(images).room
            for viewpoint, position in enumerate(positions):
                for number, yaw_deg in enumerate(_YAWS_DEG):
                    pose = Pose.from_angles(tuple(position), yaw_deg=yaw_deg + viewpoint * _TURN_DEG)
                    lit = np.asarray(renderer.render(camera, pose).lit)
                    yield with_truth(f"{name}-{viewpoint}-{number}", lit, room, camera, pose)


def with_truth(name: str, lit: NDArray[np.uint8], room: Room, camera: Camera, pose: Pose) -> Panorama:
    """Return a panorama with the truth of its layout.

    Args:
        name: start of its file names.
        lit: (H, W, 3) RGB.
        room: that it shows.
        camera: equirectangular.
        pose: of the camera, upright, world frame.
    """
    maps = original_maps(project_layout(room, camera, pose), camera, pose)
    return Panorama(name, f"{len(room.walls)}-wall", lit, cor_id(room, camera, pose), maps)


def write(panorama: Panorama, folder: Path) -> None:
    """Write a ``panorama`` and its truth into a ``folder``, as HorizonNet and CFL read them.

    ``img/NAME.png`` and ``label_cor/NAME.txt``; ``EM_gt/NAME_EM.png`` and ``CM_gt/NAME_CM.png``.
    """
    name = panorama.name
    write_pixels(folder / "img" / f"{name}.png", panorama.lit)
    for suffix, pixels in zip(("EM", "CM"), panorama.maps, strict=True):
        write_pixels(folder / f"{suffix}_gt" / f"{name}_{suffix}.png", pixels)
    write_text(folder / "label_cor" / f"{name}.txt", lines_of(panorama.corners))


def _extent(settings: Settings) -> tuple[int, int]:
    """Return the width of the panoramas, px, and the number of viewpoints in a room."""
    return (_QUICK_WIDTH, _QUICK_VIEWPOINTS) if settings.quick else (_WIDTH, _VIEWPOINTS)


def _positions(source: Source, geometry: SceneGeometry, most: int) -> Array:
    """Return viewpoints (V, 3), world frame: those of a recording, or in free space, far from each other."""
    views = source.recorded_views()
    if views is not None:
        wide = []
        for view in views:
            if view.fov_deg >= _FACE_FOV_DEG:
                wide.append(view.pose.position)
        rounded = np.round(np.array(wide, np.float64).reshape(-1, 3), 6)
        recorded, times = np.unique(rounded, axis=0, return_counts=True)
        positions = recorded[times >= _CUBE_FACES]
    elif geometry.room is not None:
        positions = _free_positions(geometry.room, geometry)
    else:
        raise ArgumentError("expected a recording, or a scene with a known room, got neither; record it")
    if not len(positions):
        raise ArgumentError("expected a viewpoint in the room that shows all around, got none")
    indices = [int(np.linalg.norm(positions - positions.mean(axis=0), axis=1).argmin())]
    away = np.linalg.norm(positions - positions[indices[0]], axis=1)
    while len(indices) < min(most, len(positions)):  # the farthest from those before
        indices.append(int(away.argmax()))
        away = np.minimum(away, np.linalg.norm(positions - positions[indices[-1]], axis=1))
    return positions[indices]


def _free_positions(room: Room, geometry: SceneGeometry) -> Array:
    """Return points (F, 3) of a grid at the camera's height, away from walls and objects."""
    x_low, y_low = room.corners_w.min(axis=0) + _FROM_WALLS_M
    x_high, y_high = room.corners_w.max(axis=0)
    xs = np.arange(x_low, x_high, _GRID_M)
    ys = np.arange(y_low, y_high, _GRID_M)
    points = np.stack(np.meshgrid(xs, ys, indexing="ij"), axis=-1).reshape(-1, 2)
    reach = _FROM_WALLS_M * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    points = points[inside(room, points[:, None] + reach).all(axis=1)]
    positions = np.column_stack([points, np.full(len(points), room.floor_z + _HEIGHT_M)])
    for name, box in geometry.boxes.items():
        if name not in room.surfaces:
            away = np.abs((positions - box.center_w) @ box.R_w_b) - box.size / 2
            positions = positions[(away > _FROM_OBJECTS_M).any(axis=1)]
    return positions


OPTIONS = frozenset({"predictions"})

MAP_SCORES = {"iou": "IoU", "accuracy": "Acc", "precision": "P", "recall": "R", "f1": "F1"}
"""Measures of a map, in the paper's order."""

_LAYOUT_SCORES = {
    "iou_2d": ("2D IoU", ""),
    "iou_3d": ("3D IoU", ""),
    "corner_error": ("corner error", "%"),
    "pixel_error": ("pixel error", "%"),
    "rmse_m": ("depth RMSE", "m"),
    "delta_1": ("depth delta1", ""),
    "walls_right": ("number of walls right", ""),
}

PAPER: Mapping[tuple[str, str], Sequence[float]] = {
    ("edges", "6-wall"): (0.424, 0.881, 0.694, 0.519, 0.592),
    ("edges", "4-wall"): (0.474, 0.901, 0.766, 0.554, 0.642),
    ("corners", "6-wall"): (0.370, 0.974, 0.547, 0.526, 0.534),
    ("corners", "4-wall"): (0.506, 0.985, 0.643, 0.698, 0.669),
}
"""CFL's scores on the paper's synthetic rooms, in the order of ``MAP_SCORES``."""

_METHODS = ("predictions", "perfect")


def evaluate(settings: Settings) -> Report:
    """Render the panoramas, and score the predictions and the truth itself.

    Raises:
        ArgumentError: a source without a known room, or missing or malformed predictions.
        OmniscvError: of the source; shapely is not installed.
    """
    out = settings.out / "layout"
    folder = settings.options.get("predictions")
    if folder is not None and not Path(folder).is_dir():
        raise ArgumentError(f"predictions: expected a folder, got {folder}")
    rendered = list[Panorama]()
    for panorama in render(settings):
        write(panorama, out)
        rendered.append(panorama)
        settings.progress(len(rendered), count(settings))
    width = rendered[0].lit.shape[1]
    names = [panorama.name for panorama in rendered]
    predicted = {} if folder is None else predictions.read(Path(folder), names, width)
    rows = []
    for panorama in rendered:
        rows += _rows(panorama, predicted.get(panorama.name))
    about = {
        "size": [width, width // 2],
        "source": settings.source or list(SCENES),
        "truth": "edge and corner maps by the paper's recipe, corners exact; in the folder layout",
        "to predict": [f"layout/img/{name}.png" for name in names],
    }
    chart = draw(rendered, predicted, settings.out / "layout.png")
    return Report(figures(rows), rows, about, [out, chart])


def _rows(panorama: Panorama, prediction: Prediction | None) -> list[Row]:
    methods = {"perfect": Prediction(panorama.corners)}
    if prediction is not None:
        methods["predictions"] = prediction
    rows = list[Row]()
    for method, given in methods.items():
        with within(f"{method} of {panorama.name}"):
            measured = scores(given, panorama)
        rows.append({"image": panorama.name, "group": panorama.group, "method": method, **measured})
    return rows


def scores(prediction: Prediction, panorama: Panorama) -> dict[str, float | None]:
    """Return the measures of a ``prediction`` for a ``panorama`` by name; None for those without a value.

    A prediction has no measures of corners if it has maps only. Corners without maps are drawn as maps.
    """
    width = panorama.lit.shape[1]
    corners = prediction.corners
    maps = prediction.maps
    if maps is None and corners is not None:
        edge_map, corner_map = predictions.draw_maps(corners, width)
        maps = edge_map / 255.0, corner_map / 255.0
    measured = dict[str, float | None]()
    for index, name in enumerate(("edges", "corners")):
        of_map = None if maps is None else map_scores(maps[index], panorama.maps[index])
        for key in MAP_SCORES:
            measured[f"{name}_{key}"] = None if of_map is None else getattr(of_map, key)
    if corners is None:
        return {**measured, **dict.fromkeys(LayoutScores._fields), "walls_right": None}
    of_room = layout_scores(corners, panorama.corners, width, width // 2)
    return {**measured, **of_room._asdict(), "walls_right": float(len(corners) == len(panorama.corners))}


def figures(rows: Sequence[Row]) -> list[Figure]:
    """Return the means of each method for each kind of room.

    ``rows`` are those of panoramas and methods; in them, None is a measure without a value.
    """
    means = []
    for group in dict.fromkeys(row["group"] for row in rows):
        for method in _METHODS:
            selected = [row for row in rows if row["group"] == group and row["method"] == method]
            name = f"{group} rooms, {method}: "
            for map_name in ("edges", "corners"):
                paper = PAPER.get((map_name, group), (None,) * len(MAP_SCORES))
                for (key, label), theirs in zip(MAP_SCORES.items(), paper, strict=True):
                    title = f"{name}{map_name} {label}"
                    means.append(_mean(selected, f"{map_name}_{key}", title, "", theirs))
            if method != "perfect":  # its corners are exact
                for key, (label, unit) in _LAYOUT_SCORES.items():
                    means.append(_mean(selected, key, name + label, unit))
    return [mean for mean in means if mean.n]


def _mean(rows: Sequence[Row], key: str, name: str, unit: str, paper: float | None = None) -> Figure:
    values = [row[key] for row in rows if row[key] is not None]
    return Figure(name, float(np.mean(values)) if values else float("nan"), unit, paper, len(values))


def draw(panoramas: Sequence[Panorama], predicted: Mapping[str, Prediction], path: Path) -> Path:
    """Draw the true and the predicted layout in the first panorama of each kind of room.

    Args:
        panoramas: with their truth.
        predicted: layouts by the names of panoramas; a panorama may lack one.
        path: of the picture, which is returned.
    """
    first = {panorama.group: panorama for panorama in reversed(panoramas)}
    with chart(path, 900, 270) as drawing:
        panels = drawing.subplots(1, len(first), squeeze=False)[0]
        for axes, panorama in zip(panels, reversed(first.values()), strict=True):
            _draw_panorama(axes, panorama, predicted.get(panorama.name))
    return path


def _draw_panorama(axes: Axes, panorama: Panorama, prediction: Prediction | None) -> None:
    height, width = panorama.lit.shape[:2]
    axes.imshow(panorama.lit, extent=(0, width, height, 0))
    layouts = [(panorama.corners, "white", 2.6)]
    title = f"{panorama.name}: the true layout (white)"
    if prediction is not None and prediction.corners is not None:
        layouts.append((prediction.corners, RED, 1.1))
        title += ", the predicted one (orange)"
    for corners, color, line_width in layouts:
        for curve in visible_curves(corners, width):
            axes.plot(*curve.T, color=color, lw=line_width, solid_capstyle="round")
    axes.set(xlim=(0, width), ylim=(height, 0))
    axes.set_axis_off()
    axes.set_title(title, size=8, color=INK)
