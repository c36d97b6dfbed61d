"""Maps from directions to pixels and back, as tables that a page can look up for any camera.

Sphere to image
    The directions of six faces of a cube along the camera's axes. Face ``2 m + s`` has the axis m (x, y, z)
    as its largest component, negative where s = 1; a point of it is ``(a, b)``, the next two components
    (cyclic) over the largest. A face has N x N cells and (N + 1) x (N + 1) nodes. In a smooth cell the pixel
    is interpolated between the four nodes, whose pixels ``camera.project`` gives; a cell is smooth if the
    error in its middle is within ``_SMOOTH_PX``. Other cells, at the border of the field of view, at seams
    and poles, have a table of F x F pixels, F up to 16, without interpolation.
Image to sphere
    Directions (and origins of a non-central camera) at every few pixels.

Directions of a non-central camera are those of its rays: ``camera.project`` of points that are far away. For
a rolling shutter it is the pixel whose ray is nearest.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import Camera
from omniscv.geometry import Array
from omniscv.planning import densities
from omniscv.viewing.look.layers import pack

Project = Callable[[Array], tuple[Array, NDArray[np.bool_]]]

_FAR_M = 1e6  # of the points that directions are projected at
_CELL_PX = 6.0  # aimed-at width of a cell in the image
_LEAST_CELLS = 48  # across a face
_MOST_CELLS = 384  # across a face
_FINE_PX = 0.375  # aimed-at width of the parts of a cell that is not smooth
_LEAST_FINE = 4  # parts across such a cell
_MOST_FINE = 16  # parts across such a cell
_SMOOTH_PX = 0.05  # largest error in the middle of a smooth cell
_NODES = 384  # across the image, from pixels to directions
_PER_PX = 1024  # fixed point: pixels in the tables are multiples of 1/1024
_INSIDE = 1 - 1e-9  # keeps nodes off a face's border, where cube maps have their seams
_SLOW = ("rolling-shutter",)  # projecting a point takes milliseconds: the pixel of the nearest ray is used
_INVERTIBLE = 0.9  # least share of the pixels that their own directions must lead back to


def describe(camera: Camera) -> dict[str, Any]:
    """Return what a page needs to show images of a camera, as plain JSON values.

    ``sphere`` is ``closed`` (equirectangular), the tables of the module, or None for a camera with parallel
    rays, such as a push-broom: its images are shown flat. ``valid`` is None if every pixel is valid.
    """
    closed = camera.name == "equirectangular"
    density = camera.width / (2 * np.pi) if closed else densities.pixels_per_radian(camera) or None
    valid = camera.valid()
    return {
        "model": camera.name,
        "width": camera.width,
        "height": camera.height,
        "central": camera.central,
        "wraps": camera.wraps,
        "density": density,
        "valid": None if valid.all() else pack(valid),
        "sphere": "closed" if closed else tables(camera, density),
        "rays": None if closed else _rays(camera),
    }


def tables(camera: Camera, density: float | None) -> dict[str, Any] | None:
    """Return the tables from directions to pixels; None if directions do not determine pixels.

    Args:
        camera: of the image.
        density: px per radian, by which the number of cells is chosen; None for parallel rays.

    Returns:
        ``cells`` N; ``fine`` F; ``nodes`` (6 (N + 1), N + 1, 2) and ``tables`` (F T, F, 2), pixels as whole
        multiples of 1 / ``perPixel``, plus 1; 0 for none; ``kinds`` (6 N, N): 0 nothing is seen, 1 smooth,
        2 + the index of the cell's table.
    """
    if density is None:
        return None
    project = _projector(camera, density)
    if not _is_invertible(camera, project, density):
        return None
    count = int(np.clip(np.ceil(2 * density / _CELL_PX), _LEAST_CELLS, _MOST_CELLS))
    ends = np.linspace(-_INSIDE, _INSIDE, count + 1)
    nodes, seen = project(on_cube(ends, ends))
    corners = [nodes[:, :-1, :-1], nodes[:, :-1, 1:], nodes[:, 1:, :-1], nodes[:, 1:, 1:]]
    middles = (ends[1:] + ends[:-1]) / 2
    directions = on_cube(middles, middles)
    between = np.mean(corners, axis=0)
    known = np.asarray(np.isfinite(between).all(axis=-1))
    off = _turned(camera, between, known, directions) * density
    # Pixels of nearest rays must not be interpolated, even where that fits by chance.
    kinds = np.where((off <= _SMOOTH_PX) & (camera.name not in _SLOW), 1, 0)
    fine_count = int(np.clip(np.ceil(2 * density / count / _FINE_PX), _LEAST_FINE, _MOST_FINE))
    face, row, column = np.nonzero(kinds == 0)
    cell_tables = _cell_tables(project, face, ends[column], ends[row], 2 / count, fine_count)
    used = cell_tables.any(axis=(1, 2, 3))
    kinds[face[used], row[used], column[used]] = 2 + np.arange(np.count_nonzero(used))
    return {
        "cells": count,
        "fine": fine_count,
        "perPixel": _PER_PX,
        "nodes": pack(_fixed(nodes, seen).reshape(-1, count + 1, 2)),
        "kinds": pack(kinds.astype(np.uint32).reshape(-1, count)),
        "tables": pack(cell_tables[used].reshape(-1, fine_count, 2)),
    }


def _cell_tables(
    project: Project, face: NDArray[np.int64], left: Array, top: Array, width: float, count: int
) -> NDArray[np.uint32]:
    """Return the pixels (T, F, F, 2) of the middles of the F x F parts of T cells, as :func:`_fixed`.

    Args:
        project: from directions to pixels.
        face: (T,) of each cell.
        left: (T,) the first coordinate of a cell's corner on its face, -1 to 1.
        top: (T,) the second one.
        width: of a cell, in the same unit.
        count: F.
    """
    middles = (np.arange(count) + 0.5) / count * width
    shape = (len(face), count, count)
    across = np.broadcast_to((left[:, None] + middles)[:, None, :], shape)
    down = np.broadcast_to((top[:, None] + middles)[:, :, None], shape)
    faces = np.broadcast_to(face[:, None, None], shape)
    return _fixed(*project(_on_face(faces, across, down)))


def _is_invertible(camera: Camera, project: Project, density: float) -> bool:
    """Whether directions determine pixels. Those of parallel rays do not."""
    pixels = np.random.default_rng(0).uniform((0, 0), (camera.width, camera.height), (2000, 2))
    rays = camera.unproject(pixels)
    directions = rays.directions[rays.valid]
    off = _turned(camera, *project(directions), directions) * density
    return bool(np.mean(off < 1.0) >= _INVERTIBLE)


def on_cube(a: Array, b: Array) -> Array:
    """Return (6, len(b), len(a), 3) unit directions of the faces' points (``a``, ``b``)."""
    flat = np.stack(np.meshgrid(a, b), axis=-1)
    return np.stack([_on_face(face, flat[..., 0], flat[..., 1]) for face in range(6)])


def _on_face(face: int | NDArray[np.int64], a: Array, b: Array) -> Array:
    """Unit directions (..., 3) of points (a, b) of faces, of the same shape, or of one face."""
    axis, sign = np.broadcast_arrays(np.asarray(face) // 2, 1.0 - 2.0 * (np.asarray(face) % 2))
    directions = np.empty((*a.shape, 3))
    for shift, component in enumerate((np.broadcast_to(sign, a.shape), a, b)):
        where = np.broadcast_to((axis + shift) % 3, a.shape)[..., None]
        np.put_along_axis(directions, where, component[..., None], axis=-1)
    return np.asarray(directions / np.linalg.norm(directions, axis=-1, keepdims=True))


def _projector(camera: Camera, density: float) -> Project:
    """Return the function from directions (..., 3) to pixels (..., 2) and whether they are valid (...)."""
    if camera.name not in _SLOW:
        return lambda directions: camera.project(_FAR_M * directions)
    from scipy.spatial import cKDTree

    rays = camera.unproject()
    pixels = camera.pixels()[rays.valid]
    tree = cKDTree(rays.directions[rays.valid])

    def nearest(directions: Array) -> tuple[Array, NDArray[np.bool_]]:
        far, index = tree.query(directions, distance_upper_bound=1 / density)
        known = np.isfinite(far)
        return pixels[np.where(known, index, 0)], known

    return nearest


def _fixed(pixels: Array, seen: NDArray[np.bool_]) -> NDArray[np.uint32]:
    """Pixels as whole multiples of 1/1024, plus 1; 0 where nothing is seen."""
    return np.where(seen[..., None], np.rint(np.nan_to_num(pixels) * _PER_PX) + 1, 0).astype(np.uint32)


def _turned(camera: Camera, pixels: Array, known: NDArray[np.bool_], directions: Array) -> Array:
    """Return the angles, rad, between directions and the rays of pixels; +inf where a pixel has no ray."""
    rays = camera.unproject(np.where(known[..., None], pixels, camera.center))
    angle = np.linalg.norm(rays.directions - directions, axis=-1)
    return np.asarray(np.where(known & rays.valid, angle, np.inf))


def _rays(camera: Camera) -> dict[str, Any]:
    """The map from pixels to rays: ``step`` px between nodes, the first half a pixel from the corner;
    ``directions`` (H', W', 3) int16 of 32767, 0 where not valid; ``origins`` (H', W', 3) float32 metres, or
    None."""
    step = max(1, -(-max(camera.width, camera.height) // _NODES))
    u = np.arange(0.5, camera.width, step)
    v = np.arange(0.5, camera.height, step)
    rays = camera.unproject(np.stack(np.meshgrid(u, v), axis=-1))
    directions = np.rint(32767 * np.nan_to_num(rays.directions)).astype(np.int16)
    origins = None if camera.central else pack(np.nan_to_num(rays.origins).astype(np.float32))
    return {"step": step, "directions": pack(directions), "origins": origins}
