"""Rows of solids (``kernel.COLUMNS``): extent, points, and transformations."""

import itertools

import numpy as np
from numpy.typing import NDArray

from mock_server.kernel import BOX, CYLINDER, RECTANGLE, SPHERE

Array = NDArray[np.float64]

_THINNEST = 1e-9  # the least factor: a solid of size 0 cannot be traced
_CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
_CIRCLE = [(np.cos(t), np.sin(t)) for t in np.linspace(0, 2 * np.pi, 64, endpoint=False)]
_RIMS = np.array([(x, y, z) for z in (-1.0, 1.0) for x, y in _CIRCLE])
_GLOBE = np.array(
    [
        (np.cos(t) * x, np.cos(t) * y, np.sin(t))
        for t in np.linspace(-np.pi / 2, np.pi / 2, 9)
        for x, y in _CIRCLE
    ]
)
_MESHES = {RECTANGLE: _CORNERS, BOX: _CORNERS, CYLINDER: _RIMS, SPHERE: _GLOBE}


def extent(rows: Array, frame: Array) -> tuple[Array, Array]:
    """Return the least and the greatest coordinates of solids along the rows of ``frame``."""
    kind, axes, half = rows[:, 0], rows[:, 5:14].reshape(-1, 3, 3) @ frame.T, rows[:, 14:17]
    reach = np.abs(axes * half[:, :, None]).sum(axis=1)
    disc = half[:, :1] * np.hypot(axes[:, 0], axes[:, 1]) + np.abs(axes[:, 2]) * half[:, 2:]
    reach[kind == CYLINDER] = disc[kind == CYLINDER]
    reach[kind == SPHERE] = half[kind == SPHERE, :1]
    centers = rows[:, 2:5] @ frame.T
    return (centers - reach).min(axis=0), (centers + reach).max(axis=0)


def center(rows: Array) -> Array:
    """Return the centre (3,) of the box around solids."""
    low, high = extent(rows, np.eye(3))
    return np.asarray((low + high) / 2)


def points(rows: Array) -> Array:
    """Return (N, 3) mesh points: corners of boxes and rectangles, 64 on each rim of a cylinder or circle of a
    sphere."""
    meshes = []
    for row in rows:
        unit, (a, b, c) = _MESHES[int(row[0])], row[14:17]
        half = {SPHERE: (a, a, a), CYLINDER: (a, a, c)}.get(int(row[0]), (a, b, c))
        meshes.append(row[2:5] + (unit * half) @ row[5:14].reshape(3, 3))
    return np.concatenate(meshes)


def moved(rows: Array, R: Array, pivot: Array, target: Array) -> Array:
    """Return solids rotated about a point that moves to ``target``."""
    result = rows.copy()
    result[:, 2:5] = (rows[:, 2:5] - pivot) @ R.T + target
    result[:, 5:14] = (rows[:, 5:14].reshape(-1, 3, 3) @ R.T).reshape(-1, 9)
    return result


def scaled(rows: Array, factors: Array, pivot: Array) -> Array:
    """Return solids scaled along the world's axes about a fixed point.

    Boxes and rectangles take the factors of the nearest axes. Round solids stay round, by the least factor
    across their axis, as an engine scales collision shapes.
    """
    result, sizes = rows.copy(), np.maximum(np.abs(factors), _THINNEST)
    result[:, 2:5] = (rows[:, 2:5] - pivot) * factors + pivot
    for row in result:
        along = sizes[np.abs(row[5:14].reshape(3, 3)).argmax(axis=1)]
        if row[0] == SPHERE:
            along[:] = sizes.min()
        elif row[0] == CYLINDER:
            along[:2] = along[:2].min()
        row[14:17] *= along
        row[17] *= along.max()
    return result
