"""The motion between two views from the bearings of points that both see, for every central camera.

A point seen along the unit vectors b1 and b2 of two cameras, ``p_2 = R p_1 + t``, satisfies
``b2^T E b1 = 0``, E = [t]x R: b2 lies in the plane through both centres and b1. Bearings need no image plane,
so the eight-point algorithm takes them as they are, behind the camera too, and its residuals are angles.

Sources: H. C. Longuet-Higgins, Nature 293, 1981; R. Hartley, A. Zisserman, "Multiple View Geometry", 9.6, 11;
A. Pagani, D. Stricker, "Structure from motion using full spherical panoramic cameras", OMNIVIS 2011.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv.geometry import Array, Pose

SAMPLE = 8
"""Pairs of bearings that determine E linearly."""

_SAMPLES = 1000
_REFITTED = 32  # best samples, which are fitted to all pairs that agree
_REFITS = 5
_PARALLEL = 1e-9  # squared sine of the angle between rays that meet nowhere


class RelativePose(NamedTuple):
    """The second camera in the first one's frame, at distance 1, and the (N,) bool pairs that agree."""

    T_1_2: Pose
    agree: NDArray[np.bool_]


def essential(first: Array, second: Array, weights: ArrayLike = 1.0) -> Array:
    """Return the essential matrices (..., 3, 3) of bearings (..., N, 3), N >= 8.

    The linear least squares solution, with its singular values replaced by 1, 1, 0.

    Args:
        first, second: (..., N, 3) unit bearings.
        weights: (..., N) of the pairs.
    """
    rows = (second[..., :, None] * first[..., None, :]).reshape(*first.shape[:-1], 9)
    weighted = rows * np.asarray(weights)[..., None]
    solution = np.linalg.eigh(np.swapaxes(rows, -1, -2) @ weighted)[1][..., 0]
    solution = solution.reshape(*solution.shape[:-1], 3, 3)
    U, _, Vt = np.linalg.svd(solution)
    return np.asarray(U[..., :2] @ Vt[..., :2, :])


def epipolar_angles(E: Array, first: Array, second: Array) -> Array:
    """Return (..., N) radians between bearings and the epipolar planes of their partners, the larger of two.

    Args:
        E: (..., 3, 3).
        first, second: (N, 3) unit bearings.
    """
    planes_2, planes_1 = first @ np.swapaxes(E, -1, -2), second @ E
    off = np.abs((second * planes_2).sum(axis=-1))
    shorter = np.minimum(np.linalg.norm(planes_2, axis=-1), np.linalg.norm(planes_1, axis=-1))
    return np.asarray(np.arcsin(np.clip(off / np.maximum(shorter, 1e-300), 0, 1)))


def ray_depths(T_1_2: Pose, first: Array, second: Array) -> tuple[Array, Array]:
    """Return (N,) the distances along both cameras' rays where these come closest; NaN of parallel rays."""
    turned = second @ T_1_2.R_w_c.T
    between = T_1_2.position
    cosine = (first * turned).sum(axis=1)
    a, b = first @ between, turned @ between
    squared_sine = 1 - cosine**2
    squared_sine[squared_sine < _PARALLEL] = np.nan
    return (a - cosine * b) / squared_sine, (cosine * a - b) / squared_sine


def pose_of(E: Array, first: Array, second: Array) -> Pose:
    """Return the pose of the second camera in the first one's frame, at distance 1.

    Of the four poses that have this E, the one with the most points in front of both cameras, along their
    rays: there is no image plane to be in front of.
    """
    U, _, Vt = np.linalg.svd(E)
    W = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    candidates = []
    for turn in (W, W.T):
        R_2_1 = U @ turn @ Vt
        R_2_1 *= np.sign(np.linalg.det(R_2_1))
        candidates += [Pose(sign * R_2_1.T @ U[:, 2], R_2_1.T) for sign in (1.0, -1.0)]
    in_front = [np.count_nonzero(_both_positive(pose, first, second)) for pose in candidates]
    return candidates[int(np.argmax(in_front))]


def relative_pose(first: Array, second: Array, limit_rad: float, seed: int = 0) -> RelativePose | None:
    """Return the motion that most pairs of bearings agree with; None of too few pairs.

    RANSAC over a fixed number of samples of eight, scored by the sum of squared epipolar angles cut off at a
    limit. The best samples are then fitted to all pairs, weighted by how well they agree; the best fit is
    returned.

    Args:
        first, second: (N, 3) unit bearings, pairs of which some may be wrong.
        limit_rad: a pair with a larger epipolar angle does not agree.
        seed: of the samples.
    """
    if len(first) < SAMPLE:
        return None
    order = np.random.default_rng(seed).random((_SAMPLES, len(first)))
    drawn = np.argpartition(order, SAMPLE - 1, axis=1)[:, :SAMPLE]
    fits = essential(first[drawn], second[drawn])
    angles = epipolar_angles(fits, first, second)
    best = np.argsort(_costs(angles, limit_rad), kind="stable")[:_REFITTED]
    fits, angles = fits[best], angles[best]
    found, agreement = fits[0], angles[0]
    for _ in range(_REFITS):
        fits = essential(first, second, 1 / (1 + (angles / limit_rad) ** 2) ** 2)
        angles = epipolar_angles(fits, first, second)
        least = int(np.argmin(_costs(angles, limit_rad)))
        if _costs(angles[least], limit_rad) < _costs(agreement, limit_rad):
            found, agreement = fits[least], angles[least]
    agree = agreement < limit_rad
    T_1_2 = pose_of(found, first[agree], second[agree])
    return RelativePose(T_1_2, agree & _both_positive(T_1_2, first, second))


def _costs(angles: Array, limit_rad: float) -> Array:
    return np.asarray((np.minimum(angles, limit_rad) ** 2).sum(axis=-1))


def _both_positive(T_1_2: Pose, first: Array, second: Array) -> NDArray[np.bool_]:
    """(N,) whether rays meet in front of both cameras; parallel rays, of points far away, do."""
    depths = ray_depths(T_1_2, first, second)
    return np.asarray(~((depths[0] <= 0) | (depths[1] <= 0)))
