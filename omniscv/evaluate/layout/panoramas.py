"""Panoramas of rooms with known layouts, from viewpoints and in orientations like the paper's."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import omniscv
from omniscv.arguments import within
from omniscv.cameras import Camera
from omniscv.dataset.pictures import write_pixels
from omniscv.errors import ArgumentError
from omniscv.evaluate import Settings
from omniscv.geometry import Pose
from omniscv.geometry.pose import Array
from omniscv.geometry.scene_geometry import Room, SceneGeometry
from omniscv.sources import Source
from omniscv.storage.local import write_text
from omniscv.truth import layout, project_layout
from omniscv.truth.layout_labels import Map, cor_id, original_maps
from omniscv.truth.room_in_image import inside

SCENES = "mock://four-wall", "mock://six-wall"

_WIDTH, _QUICK_WIDTH = 1024, 512
_VIEWPOINTS, _QUICK_VIEWPOINTS = 5, 2
_YAWS_DEG = 17.0, 62.0  # neither along the walls
_TURN_DEG = 31.0  # from one viewpoint to the next
_HEIGHT_M, _GRID_M = 1.5, 0.25
_FROM_WALLS_M, _FROM_OBJECTS_M = 0.6, 0.3
_FITTED = ("object_mask", "depth", "normals")  # the modes that a room is fitted to
_CUBE_FACES, _FACE_FOV_DEG = 6, 89.0  # views that show all around a recorded viewpoint


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
            renderer, geometry = omniscv.Renderer(source), source.geometry()
            positions = _positions(source, geometry, viewpoints)
            if geometry.room is not None:
                room = layout(geometry).room
            else:  # fitted to images
                small = omniscv.cameras.create("equirectangular", _QUICK_WIDTH, _QUICK_WIDTH // 2)
                poses = [Pose.from_angles(tuple(position)) for position in positions]
                room = layout([renderer.render(small, pose, _FITTED) for pose in poses]).room
            for i, position in enumerate(positions):
                for j, yaw_deg in enumerate(_YAWS_DEG):
                    pose = Pose.from_angles(tuple(position), yaw_deg=yaw_deg + i * _TURN_DEG)
                    image = renderer.render(camera, pose)
                    yield with_truth(f"{name}-{i}-{j}", np.asarray(image.lit), room, camera, pose)


def with_truth(name: str, lit: NDArray[np.uint8], room: Room, camera: Camera, pose: Pose) -> Panorama:
    """Return a panorama with the truth of its layout."""
    maps = original_maps(project_layout(room, camera, pose), camera, pose)
    return Panorama(name, f"{len(room.walls)}-wall", lit, cor_id(room, camera, pose), maps)


def write(panorama: Panorama, folder: Path) -> None:
    """Write a panorama and its truth as HorizonNet and CFL read them.

    ``img/NAME.png`` and ``label_cor/NAME.txt``; ``EM_gt/NAME_EM.png`` and ``CM_gt/NAME_CM.png``.
    """
    name = panorama.name
    write_pixels(folder / "img" / f"{name}.png", panorama.lit)
    for suffix, pixels in zip(("EM", "CM"), panorama.maps, strict=True):
        write_pixels(folder / f"{suffix}_gt" / f"{name}_{suffix}.png", pixels)
    lines = (f"{x:.3f} {y:.3f}\n" for x, y in panorama.corners.tolist())
    write_text(folder / "label_cor" / f"{name}.txt", "".join(lines))


def _extent(settings: Settings) -> tuple[int, int]:
    """Return the width of the panoramas, px, and the number of viewpoints in a room."""
    return (_QUICK_WIDTH, _QUICK_VIEWPOINTS) if settings.quick else (_WIDTH, _VIEWPOINTS)


def _positions(source: Source, geometry: SceneGeometry, most: int) -> Array:
    """Return viewpoints (V, 3), world frame: those of a recording, or in free space, far from each other."""
    views = source.recorded_views()
    if views is not None:
        wide = [view.pose.position for view in views if view.fov_deg >= _FACE_FOV_DEG]
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
    low, high = room.corners_w.min(axis=0) + _FROM_WALLS_M, room.corners_w.max(axis=0)
    axes = [np.arange(start, stop, _GRID_M) for start, stop in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    reach = _FROM_WALLS_M * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    points = points[inside(room, points[:, None] + reach).all(axis=1)]
    positions = np.column_stack([points, np.full(len(points), room.floor_z + _HEIGHT_M)])
    for name, box in geometry.boxes.items():
        if name not in room.surfaces:
            away = np.abs((positions - box.center_w) @ box.R_w_b) - box.size / 2
            positions = positions[(away > _FROM_OBJECTS_M).any(axis=1)]
    return positions
