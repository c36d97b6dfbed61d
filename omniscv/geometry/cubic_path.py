"""The path of a camera while one image is made: pieces of cubics, by seconds from the image's time."""

from bisect import bisect_left, bisect_right
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from omniscv.errors import ArgumentError
from omniscv.geometry.pose import Array, Pose
from omniscv.geometry.trajectory import NS, Trajectory

_CLOSE = 1e-8  # metres and radians within which the cubics pass through a path between their rows
_MOST_HALVINGS = 7  # of the pieces of a path


class CubicPath:
    """Poses between rows of times and poses; a piece is the cubic through four rows, of which the last is the
    first of the next.

    Args:
        rows: (3 n + 1, 8) ``t x y z qx qy qz qw``, seconds and metres, in the frame of the pose at t = 0; or
            (2, 7) ``t x y z rx ry rz``, of an even motion by turns (axis times angle, rad).

    Attributes:
        turn: radians from the first row to each, summed up.

    Raises:
        ArgumentError: another number of rows, or times that do not increase.
    """

    def __init__(self, rows: Array) -> None:
        times = rows[:, 0]
        if (len(rows) % 3 != 1 or len(rows) < 4) and rows.shape != (2, 7):
            raise ArgumentError(f"path: expected 4, 7, 10, ... rows, got {len(rows)}")
        if (np.diff(times) <= 0).any():
            raise ArgumentError(f"path: expected rows later and later, got times {times.tolist()}")
        moves = rows[:, 1:]
        if rows.shape[1] == 8:
            from scipy.spatial.transform import Rotation  # slow to load

            moves = np.column_stack([rows[:, 1:4], Rotation.from_quat(rows[:, 4:]).as_rotvec()])
        self.turn = float(np.linalg.norm(np.diff(moves[:, 3:], axis=0), axis=1).sum())
        self.moves = bool(moves.any())
        step = 3 if len(rows) > 2 else 1
        self._ends = times[::step]
        pieces = np.arange(len(rows) - 1)[::step, None] + np.arange(step + 1)
        part = (times[pieces] - times[pieces[:, :1]]) / np.diff(self._ends)[:, None]
        powers = part[..., None] ** np.arange(step + 1)
        self._factors = np.linalg.solve(powers, moves[pieces])  # (pieces, power, 6)

    def at(self, seconds: Array) -> tuple[Array, Array]:
        """Return rotations (..., 3, 3) and positions (..., 3) at times (...)."""
        i = np.searchsorted(self._ends[1:-1], seconds, side="right")
        part = ((seconds - self._ends[i]) / (self._ends[i + 1] - self._ends[i]))[..., None]
        moved = self._factors[i, -1]
        for power in range(self._factors.shape[1] - 2, -1, -1):
            moved = moved * part + self._factors[i, power]
        return _matrices(moved[..., 3:]), moved[..., :3]


def _matrices(vectors: Array) -> Array:
    """Return the rotations (..., 3, 3) of vectors, axis times angle: Rodrigues' formula."""
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    cross = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    half = np.sinc(angle / (2 * np.pi))
    return np.asarray(np.eye(3) + np.sinc(angle / np.pi) * cross + half**2 / 2 * (cross @ cross))


def rows_along(path: Trajectory, time_ns: int, ends_ns: tuple[int, int], mounted: Pose) -> Array:
    """Return rows of :class:`CubicPath` for what is mounted on a body that moves along a path.

    Args:
        path: of the body.
        time_ns: of the image, whole nanoseconds: the rows' t = 0 and frame.
        ends_ns: times of the first row and of the last, at most a step of the path beyond it.
        mounted: the pose on the body.
    """
    from scipy.spatial.transform import Rotation  # slow to load

    first = path.at(time_ns, steps_beyond=1) @ mounted
    for end_ns in ends_ns:
        path.at(end_ns, steps_beyond=1)  # refuses others

    def rows_at(times: NDArray[np.int64]) -> Array:
        body = path.poses_at(times)
        positions = first.to_camera(body.positions + body.rotations @ mounted.position)
        turns = Rotation.from_matrix(first.rotation.T @ body.rotations @ mounted.rotation)
        return np.column_stack([(times - time_ns) / NS, positions, turns.as_quat(canonical=True)])

    ends = [ends_ns[0], ends_ns[1]]
    if path.curve == "linear":  # which bends at its poses
        times_ns = path.times_ns or ()
        ends[1:1] = times_ns[bisect_right(times_ns, ends_ns[0]) : bisect_left(times_ns, ends_ns[1])]
    for _ in range(_MOST_HALVINGS):
        rows = rows_at(_sixths(ends))
        rotations, positions = CubicPath(rows[::2]).at(rows[1::2, 0])
        away = np.abs(positions - rows[1::2, 1:4]).max()
        turned = np.abs(rotations - Rotation.from_quat(rows[1::2, 4:]).as_matrix()).max()
        if max(away, turned) <= _CLOSE:
            break
        middles = [(start + end) // 2 for start, end in pairwise(ends)]
        ends = sorted({*ends, *middles})
    return np.asarray(rows[::2])


def _sixths(ends: list[int]) -> NDArray[np.int64]:
    """Return six times for each interval between ends, from its start on, and the last end."""
    times = []
    for start, end in pairwise(ends):
        times += [start + sixth * (end - start) // 6 for sixth in range(6)]
    return np.array([*times, ends[-1]])
