"""Poses and points that agree best with the bearings they were seen along: resection, triangulation, bundle
adjustment, with one residual for all central cameras.

The residual of a bearing b of a point at X, seen by a camera at c turned by R, has two numbers:
``B^T q/|q|``, ``q = R^T (X - c)``, where the columns of B are a basis of the plane across b: the sine of the
angle between b and q, in two directions. Gauss-Newton steps with Levenberg's damping; weights of Huber.

Source: B. Triggs et al., "Bundle adjustment, a modern synthesis", 1999.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import spsolve
from scipy.spatial.transform import Rotation

from omniscv.geometry import Array, Pose

_STEPS = 12
_ENOUGH = 1e-4  # relative gain below which no further step is taken
_BEHIND = 2.0  # residual of a point in the wrong half of the view: more than any sine
_TINY = 1e-12


@dataclass(frozen=True, eq=False)
class Observations:
    """M bearings, of which camera and point.

    Attributes:
        camera, point: (M,) indices.
        bearings: (M, 3) unit, camera frames.
    """

    camera: NDArray[np.int64]
    point: NDArray[np.int64]
    bearings: Array


def meeting_points(origins: Array, directions: Array, index: NDArray[np.int64], count: int) -> Array:
    """Return (count, 3) the points nearest to bundles of rays: of least sum of squared distances.

    Args:
        origins, directions: (M, 3), unit directions.
        index: (M,) which bundle a ray belongs to.
        count: of bundles.
    """
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    A, b = np.zeros((count, 3, 3)), np.zeros((count, 3))
    np.add.at(A, index, across)
    np.add.at(b, index, (across @ origins[:, :, None])[..., 0])
    return np.asarray(np.linalg.solve(A + _TINY * np.eye(3), b[..., None])[..., 0])


def residuals(R_w_c: Array, t_w_c: Array, points_w: Array, seen: Observations) -> Array:
    """Return (M, 2) residuals; see the module. Of points behind, both are larger than any sine.

    Args:
        R_w_c, t_w_c: (K, 3, 3) and (K, 3), of all cameras.
        points_w: (P, 3).
    """
    q = _rotated(R_w_c, t_w_c, points_w, seen)
    unit = q / np.maximum(np.linalg.norm(q, axis=1, keepdims=True), _TINY)
    off = (_across(seen.bearings) * unit[:, :, None]).sum(axis=1)
    return np.where((unit * seen.bearings).sum(axis=1)[:, None] > 0, off, _BEHIND)


def adjust(
    poses: list[Pose], points_w: Array, seen: Observations, limit_rad: float, held: int = 2
) -> tuple[list[Pose], Array]:
    """Return poses and points with smaller residuals.

    Args:
        poses: (K) of the cameras.
        points_w: (P, 3); each seen at least once. With ``held`` = K - 1 and points that shall not move, see
            :func:`resect`.
        seen: who saw what.
        limit_rad: residuals beyond it count linearly.
        held: so many of the first cameras keep their poses; two hold the frame and the scale.
    """
    return _minimise(poses, points_w, seen, limit_rad, held, move_points=True)


def resect(pose: Pose, points_w: Array, bearings: Array, limit_rad: float) -> Pose:
    """Return the pose, near a given one, from which points (N, 3) are seen along bearings (N, 3)."""
    each = np.arange(len(points_w))
    seen = Observations(np.zeros_like(each), each, bearings)
    return _minimise([pose], points_w, seen, limit_rad, held=0, move_points=False)[0][0]


def _minimise(
    poses: list[Pose], points_w: Array, seen: Observations, limit_rad: float, held: int, move_points: bool
) -> tuple[list[Pose], Array]:
    R, t, X = np.array([p.R_w_c for p in poses]), np.array([p.position for p in poses]), points_w
    damping = 1e-6
    off = residuals(R, t, X, seen)
    cost = _huber(off, limit_rad)
    for _ in range(_STEPS):
        J = _jacobian(R, t, X, seen, held, move_points)
        weights = np.repeat(np.sqrt(limit_rad / np.maximum(np.linalg.norm(off, axis=1), limit_rad)), 2)
        weighted = csc_array(J.multiply(weights[:, None]))
        normal = csc_array(weighted.T @ weighted)
        normal.setdiag(normal.diagonal() * (1 + damping) + _TINY)
        step = -spsolve(normal, weighted.T @ (weights * off.ravel()))
        cameras = 6 * (len(R) - held)
        turns, moves = step[:cameras].reshape(-1, 2, 3).transpose(1, 0, 2)
        R_new, t_new = R.copy(), t.copy()
        R_new[held:] = R[held:] @ Rotation.from_rotvec(turns).as_matrix()
        t_new[held:] += moves
        X_new = X + step[cameras:].reshape(-1, 3) if move_points else X
        off_new = residuals(R_new, t_new, X_new, seen)
        cost_new = _huber(off_new, limit_rad)
        if not cost_new < cost:
            damping *= 100
            continue
        gain, damping = (cost - cost_new) / cost, max(damping / 10, 1e-9)
        R, t, X, off, cost = R_new, t_new, X_new, off_new, cost_new
        if gain < _ENOUGH:
            break
    return [Pose(position, rotation) for position, rotation in zip(t, R, strict=True)], X


def _jacobian(R: Array, t: Array, X: Array, seen: Observations, held: int, move_points: bool) -> coo_array:
    """(2M, N) of turns in the camera's frame and moves in the world's of each camera, then of the points."""
    q = _rotated(R, t, X, seen)
    length = np.maximum(np.linalg.norm(q, axis=1), _TINY)[:, None, None]
    unit = q[:, :, None] / length
    by_q = np.swapaxes(_across(seen.bearings), 1, 2) @ (np.eye(3) - unit @ np.swapaxes(unit, 1, 2)) / length
    by_point = by_q @ np.swapaxes(R[seen.camera], 1, 2)
    by_camera = np.concatenate([by_q @ _cross_matrices(q), -by_point], axis=2)
    free = seen.camera >= held
    parts = [_entries(by_camera[free], np.flatnonzero(free), 6 * (seen.camera[free] - held))]
    cameras = 6 * (len(R) - held)
    if move_points:
        parts.append(_entries(by_point, np.arange(len(q)), cameras + 3 * seen.point))
    values, rows, columns = (np.concatenate(each) for each in zip(*parts, strict=True))
    return coo_array((values, (rows, columns)), shape=(2 * len(q), cameras + 3 * len(X) * move_points))


def _entries(
    blocks: Array, observation: NDArray[np.int64], column: NDArray[np.int64]
) -> tuple[NDArray[Any], ...]:
    """Values, rows, columns of blocks (M, 2, N) that begin at columns."""
    _, height, width = blocks.shape
    rows = (2 * observation[:, None, None] + np.arange(height)[:, None]) + np.zeros(width, np.int64)
    columns = (column[:, None, None] + np.arange(width)) + np.zeros((height, 1), np.int64)
    return blocks.ravel(), rows.ravel(), columns.ravel()


def _rotated(R: Array, t: Array, X: Array, seen: Observations) -> Array:
    """(M, 3) the points in the frames of the cameras that see them."""
    return np.asarray(np.einsum("nji,nj->ni", R[seen.camera], X[seen.point] - t[seen.camera]))


def _across(bearings: Array) -> Array:
    """(M, 3, 2) two unit vectors across each bearing and each other."""
    least = np.eye(3)[np.abs(bearings).argmin(axis=1)]
    first = np.cross(bearings, least)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(bearings, first)], axis=2)


def _cross_matrices(v: Array) -> Array:
    """(M, 3, 3) such that the product with w is v x w."""
    return np.asarray(np.cross(v[:, None, :], np.eye(3)).swapaxes(1, 2))


def _huber(off: Array, limit: float) -> float:
    size = np.linalg.norm(off, axis=1)
    return float(np.where(size < limit, size**2, 2 * limit * size - limit**2).sum())
