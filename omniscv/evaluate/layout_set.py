"""Panoramas of rooms whose layouts are known: places and orientations like the paper's, and the truth."""

from __future__ import annotations

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
from omniscv.evaluate.registry import Settings
from omniscv.geometry import Pose
from omniscv.geometry.pose import Array
from omniscv.geometry.scene_geometry import Room, SceneGeometry
from omniscv.sources import Source
from omniscv.truth import layout, project_layout
from omniscv.truth.cor_id import cor_id
from omniscv.truth.layout_maps import Map, exact_maps, original_maps
from omniscv.truth.room_surfaces import inside

SCENES = "mock://four-wall", "mock://six-wall"

_WIDTH, _QUICK_WIDTH = 1024, 512
_PLACES, _QUICK_PLACES = 5, 2
_YAWS_DEG = 17.0, 62.0  # neither along the walls
_TURN_DEG = 31.0  # from one place to the next
_UP_M, _GRID_M = 1.5, 0.25
_FROM_WALLS_M, _FROM_OBJECTS_M = 0.6, 0.3
_FACE_SIDES, _FACE_FOV_DEG = 6, 89.0  # views of a recorded place that see all around


@dataclass(frozen=True, eq=False)
class Shot:
    """A panorama and the truth of its layout.

    Attributes:
        name: start of its file names.
        group: such as ``4-wall``.
        lit: (H, W, 3) RGB.
        corners: (2N, 2) px; see :mod:`omniscv.truth.cor_id`.
        maps: (H, W) uint8 of edges and of corners, by the recipe of the paper's.
        exact: the same, exact: drawn along the projected edges.
    """

    name: str
    group: str
    lit: NDArray[np.uint8]
    corners: Array
    maps: tuple[Map, Map]
    exact: tuple[Map, Map]


def count(settings: Settings) -> int:
    """Return how many panoramas :func:`shots` makes, at most."""
    return (1 if settings.source else len(SCENES)) * _size(settings)[1] * len(_YAWS_DEG)


def shots(settings: Settings) -> Iterator[Shot]:
    """Yield upright panoramas of the mock's rooms, or of the room that a source shows.

    Raises:
        ArgumentError: a source whose room is not known, or without a place in it to look from.
        OmniscvError: of the source.
    """
    width, wanted = _size(settings)
    camera = omniscv.cameras.create("equirectangular", width, width // 2)
    for address in (settings.source,) if settings.source else SCENES:
        with omniscv.open_source(address) as source, within(f"layout: {address}"):
            name = "room" if settings.source else address.partition("://")[2]
            renderer = omniscv.Renderer(source)
            places = _places(source, wanted)
            room = _room(renderer, places)
            for i, place in enumerate(places):
                for j, yaw_deg in enumerate(_YAWS_DEG):
                    pose = Pose.from_angles(tuple(place), yaw_deg=yaw_deg + i * _TURN_DEG)
                    image = renderer.render(camera, pose)
                    yield known_shot(f"{name}-{i}-{j}", np.asarray(image.lit), room, camera, pose)


def known_shot(name: str, lit: NDArray[np.uint8], room: Room, camera: Camera, pose: Pose) -> Shot:
    """Return a panorama with the truth of its layout."""
    record = project_layout(room, camera, pose)
    maps = original_maps(record, camera, pose), exact_maps(record, camera)
    return Shot(name, f"{len(room.walls)}-wall", lit, cor_id(room, camera, pose), *maps)


def write(shot: Shot, folder: Path) -> None:
    """Write a panorama and its truth as HorizonNet and CFL read them.

    ``img/NAME.png`` and ``label_cor/NAME.txt``; ``EM_gt/NAME_EM.png`` and ``CM_gt/NAME_CM.png``.
    """
    write_pixels(folder / "img" / f"{shot.name}.png", shot.lit)
    for kind, drawn in zip(("EM", "CM"), shot.maps, strict=True):
        write_pixels(folder / f"{kind}_gt" / f"{shot.name}_{kind}.png", drawn)
    label = folder / "label_cor" / f"{shot.name}.txt"
    label.parent.mkdir(exist_ok=True)
    label.write_text("".join(f"{x:.3f} {y:.3f}\n" for x, y in shot.corners.tolist()), "ascii")


def _size(settings: Settings) -> tuple[int, int]:
    return (_QUICK_WIDTH, _QUICK_PLACES) if settings.quick else (_WIDTH, _PLACES)


def _room(renderer: omniscv.Renderer, places: Array) -> Room:
    """The room of a source; fitted to what it shows where it is not known."""
    geometry = renderer.source.geometry()
    if geometry.room is not None:
        return layout(geometry).room
    camera = omniscv.cameras.create("equirectangular", _QUICK_WIDTH, _QUICK_WIDTH // 2)
    poses = [Pose.from_angles(tuple(place)) for place in places]
    return layout([renderer.render(camera, pose, ("object_mask", "depth", "normals")) for pose in poses]).room


def _places(source: Source, wanted: int) -> Array:
    """(P, 3) metres, world frame: those of a recording, or in free space and far from each other."""
    recorded, geometry = source.recorded_views(), source.geometry()
    if recorded is not None:
        wide = [view.pose.position for view in recorded if view.fov_deg >= _FACE_FOV_DEG]
        if not wide:
            raise ArgumentError("expected a recording with faces all around, got one without")
        found, times = np.unique(np.round(wide, 6), axis=0, return_counts=True)
        places = found[times >= _FACE_SIDES]
    elif geometry.room is not None:
        places = _free(geometry.room, geometry)
    else:
        raise ArgumentError(
            "expected a scene whose room is known, or a recording, got neither; record it first"
        )
    if not len(places):
        raise ArgumentError("expected a place in the room to look from, got none")
    return places[_spread(places, wanted)]


def _free(room: Room, geometry: SceneGeometry) -> Array:
    """(F, 3) points of a grid at the camera's height that keep away from walls and objects."""
    axes = [np.arange(low, high, _GRID_M) for low, high in zip(*_bounds(room.corners_w), strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    reach = _FROM_WALLS_M * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    points = points[inside(room, points[:, None] + reach).all(axis=1)]
    places = np.column_stack([points, np.full(len(points), room.floor_z + _UP_M)])
    for name, box in geometry.boxes.items():
        if name not in room.surfaces:
            away = np.abs((places - box.center_w) @ box.R_w_b) - box.size / 2
            places = places[(away > _FROM_OBJECTS_M).any(axis=1)]
    return places


def _bounds(corners: Array) -> tuple[Array, Array]:
    return corners.min(axis=0) + _FROM_WALLS_M, corners.max(axis=0)


def _spread(places: Array, wanted: int) -> list[int]:
    """The place in the middle, then again and again the one farthest from those chosen."""
    chosen = [int(np.linalg.norm(places - places.mean(axis=0), axis=1).argmin())]
    away = np.linalg.norm(places - places[chosen[0]], axis=1)
    while len(chosen) < min(wanted, len(places)):
        chosen.append(int(away.argmax()))
        away = np.minimum(away, np.linalg.norm(places - places[chosen[-1]], axis=1))
    return chosen
