"""Poses and points that agree best with observed bearings, for all central cameras.

The residual of a bearing b of a point at X, seen by a camera at c turned by R, has two numbers:
``B^T q/|q|``, ``q = R^T (X - c)``, where the columns of B are a basis of the plane across b: the sine of the
angle between b and q, in two directions. In the sums of squares, residuals beyond a limit count linearly
(Huber).

Source: B. Triggs et al., "Bundle adjustment, a modern synthesis", 1999.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.sparse import coo_array, hstack, kron
from scipy.spatial.transform import Rotation

from omniscv.geometry import Array, Pose

_MOST_STEPS = 20
_LEAST_GAIN = 1e-4  # of the cost; a smaller one ends the adjustment
_BEHIND = 2.0  # residual of a point behind the camera: more than any sine
_TINY = 1e-12


@dataclass(frozen=True, eq=False)
class Observations:
    """M bearings of points.

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
        index: (M,) the bundle of each ray.
        count: of bundles.
    """
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    A, b = np.zeros((count, 3, 3)), np.zeros((count, 3))
    np.add.at(A, index, across)
    np.add.at(b, index, (across @ origins[:, :, None])[..., 0])
    return np.asarray(np.linalg.solve(A + _TINY * np.eye(3), b[..., None])[..., 0])


def residuals(R_w_c: Array, t_w_c: Array, points_w: Array, seen: Observations) -> Array:
    """Return (M, 2) residuals; see the module. For points behind the camera both exceed any sine.

    Args:
        R_w_c, t_w_c: (K, 3, 3) and (K, 3), of all cameras.
        points_w: (P, 3).
        seen: the observations.
    """
    q = np.einsum("nji,nj->ni", R_w_c[seen.camera], points_w[seen.point] - t_w_c[seen.camera])
    unit = q / np.maximum(np.linalg.norm(q, axis=1, keepdims=True), _TINY)
    off = (_across(seen.bearings) * unit[:, :, None]).sum(axis=1)
    return np.where((unit * seen.bearings).sum(axis=1)[:, None] > 0, off, _BEHIND)


def adjust(
    poses: list[Pose], points_w: Array, seen: Observations, limit_rad: float, fixed: int = 2
) -> tuple[list[Pose], Array]:
    """Return poses and points with smaller residuals: bundle adjustment.

    Args:
        poses: (K) of the cameras.
        points_w: (P, 3), each seen at least once.
        seen: the observations.
        limit_rad: residuals beyond it count linearly.
        fixed: number of first cameras that keep their poses; two determine the frame and the scale.
    """
    R, t = np.array([pose.R_w_c for pose in poses]), np.array([pose.position for pose in poses])
    free, split = len(poses) - fixed, 6 * (len(poses) - fixed)

    def moved(x: Array) -> tuple[Array, Array, Array]:
        turns, moves = x[:split].reshape(-1, 2, 3).swapaxes(0, 1)
        R_free = R[fixed:] @ Rotation.from_rotvec(turns).as_matrix()
        points = points_w + x[split:].reshape(-1, 3)
        return np.concatenate([R[:fixed], R_free]), np.concatenate([t[:fixed], t[fixed:] + moves]), points

    row, moving = np.arange(len(seen.point)), seen.camera >= fixed
    of_camera = coo_array(
        (np.ones(moving.sum()), (row[moving], seen.camera[moving] - fixed)), (len(row), free)
    )
    of_point = coo_array((np.ones(len(row)), (row, seen.point)), (len(row), len(points_w)))

    def off(x: Array) -> Array:
        return _robust(residuals(*moved(x), seen), limit_rad)

    found = least_squares(
        off,
        np.zeros(split + points_w.size),
        jac_sparsity=hstack([kron(of_camera, np.ones((2, 6))), kron(of_point, np.ones((2, 3)))]),
        x_scale="jac",
        ftol=_LEAST_GAIN,
        max_nfev=_MOST_STEPS,
        tr_options={"regularize": False},
    )
    R, t, points = moved(found.x)
    return [Pose(position, rotation) for position, rotation in zip(t, R, strict=True)], points


def _robust(off: Array, limit: float) -> Array:
    """(2M,) residuals (M, 2), scaled so that their squares are Huber's loss of their norms.

    SciPy's own ``loss="huber"`` has no curvature beyond the limit, and converges badly.
    """
    size = np.maximum(np.linalg.norm(off, axis=1, keepdims=True), _TINY)
    loss = np.where(size < limit, size**2, 2 * limit * size - limit**2)
    return np.asarray(off * np.sqrt(loss) / size).ravel()


def _across(bearings: Array) -> Array:
    """(M, 3, 2) two unit vectors across each bearing and each other."""
    least = np.eye(3)[np.abs(bearings).argmin(axis=1)]
    first = np.cross(bearings, least)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(bearings, first)], axis=2)
