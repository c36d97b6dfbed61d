"""Trajectories: sequences of poses, timed or not. Files: :mod:`omniscv.geometry.trajectory_files`."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from fractions import Fraction
from functools import cached_property
from typing import Any, Literal, NamedTuple, Self, overload

import numpy as np
from numpy.typing import NDArray

from omniscv.errors import ArgumentError
from omniscv.geometry.pose import Array, Pose

NS = 10**9
"""Nanoseconds of a second."""

SINCE_1970_NS = 10**8 * NS
"""Times beyond are those since 1970: sources have clocks that start with them."""


_LEAST_EXPONENT = -30  # of seconds


def exact_seconds(seconds: float | Decimal) -> Decimal:
    """Return seconds as they are written: of a float its shortest text, unless it has its own from a file.

    What is far below a nanosecond is 0: a text may have any exponent.
    """
    if not isinstance(seconds, Decimal):
        seconds = Decimal(getattr(seconds, "written", "") or repr(float(seconds)))
    return seconds if seconds.adjusted() > _LEAST_EXPONENT else Decimal(0)


def nanoseconds(seconds: float | Decimal) -> int:
    """Return the nearest whole nanoseconds of seconds as they are written: 1700000000.05 has 50 million."""
    return round(Fraction(exact_seconds(seconds)) * NS)


def parsed(text: str, per_s: int = 1) -> int:
    """Return the nearest whole nanoseconds of ``text``, a decimal number, of whose unit ``per_s`` are a
    second."""
    return int((Decimal(text) * NS / per_s).to_integral_value())


def all_parsed(texts: Iterable[str], per_s: int = 1) -> list[int]:
    """Return what :func:`parsed` does with ``per_s`` of many texts, mostly digits with a point at most."""
    digits = len(str(NS // per_s)) - 1  # behind the point, of a nanosecond
    return [_plain_digits(text, digits, per_s) for text in texts]


def _plain_digits(text: str, digits: int, per_s: int) -> int:
    """Return what :func:`parsed` does, quickly for at most ``digits`` digits behind the point."""
    whole, _, part = text.partition(".")
    if len(part) <= digits and (whole + part).isdecimal() and whole.isascii() and part.isascii():
        return int(whole + part.ljust(digits, "0"))
    return parsed(text, per_s)


def decimal(time_ns: int) -> str:
    """Return seconds with all their digits: ``1403715274.302142976``, ``0.5``, ``3``."""
    whole, part = divmod(abs(time_ns), NS)
    return "-" * (time_ns < 0) + f"{whole}.{part:09d}".rstrip("0").removesuffix(".")


Curve = Literal["linear", "spline"]


@dataclass(frozen=True, eq=False)
class Poses(Sequence[Pose]):
    """Poses of which only the arrays are in memory, as of a file with a million rows.

    Args:
        positions: (N, 3) metres.
        rotations: (N, 3, 3).
    """

    positions: Array
    rotations: Array

    def __len__(self) -> int:
        return len(self.positions)

    @overload
    def __getitem__(self, index: int) -> Pose: ...
    @overload
    def __getitem__(self, index: slice) -> Poses: ...
    def __getitem__(self, index: int | slice) -> Pose | Poses:
        pose = Poses if isinstance(index, slice) else Pose
        return pose(self.positions[index], self.rotations[index])

    @classmethod
    def of(cls, poses: Sequence[Pose]) -> Poses:
        """Return the arrays of poses."""
        if isinstance(poses, cls):
            return poses
        positions = np.stack([pose.position for pose in poses])
        rotations = np.stack([pose.rotation for pose in poses])
        return cls(positions, rotations)


class Motions(NamedTuple):
    """A body's motion at N times, by the derivatives of splines.

    Attributes:
        positions_w: (N, 3) metres, world frame.
        velocities_w: (N, 3) m/s, world frame.
        accelerations_w: (N, 3) m/s^2, world frame.
        rotations: (N, 3, 3) from the body to the world.
        rates: (N, 3) angular velocity, rad/s, in the body's frame.
        rate_changes: (N, 3) its change, rad/s^2, in the body's frame.
    """

    positions_w: Array
    velocities_w: Array
    accelerations_w: Array
    rotations: Array
    rates: Array
    rate_changes: Array


@dataclass(frozen=True, eq=False)
class Trajectory(Sequence[Pose]):
    """Poses in order, and their times.

    Args:
        poses: at least one.
        times_ns: whole nanoseconds, increasing, one per pose; None if they are unknown. :meth:`timed` takes
            seconds.
        curve: between poses: ``linear`` interpolates as :meth:`Pose.interpolate`; ``spline`` uses cubic
            splines of positions and rotations, whose velocities and accelerations are continuous.
        says: what was assumed of the file that it is from, in lines for people.

    Raises:
        ArgumentError: no pose, not one time per pose, or times that are not whole or do not increase.
    """

    poses: Sequence[Pose]
    times_ns: tuple[int, ...] | None = None
    curve: Curve = "linear"
    says: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.poses:
            raise ArgumentError("trajectory: expected at least one pose, got none")
        if self.times_ns is None:
            return
        times = np.asarray(self.times_ns)
        if len(times) != len(self.poses):
            raise ArgumentError(f"times: expected one per pose, got {len(times)} for {len(self.poses)}")
        if times.dtype.kind != "i":
            first = f"{self.times_ns[0]!r}, or others; Trajectory.timed takes seconds"
            raise ArgumentError(f"times_ns: expected whole nanoseconds, got {first}")
        wrong = np.flatnonzero(~(np.diff(times) > 0))
        if wrong.size:
            before, after = map(decimal, self.times_ns[wrong[0] : wrong[0] + 2])
            raise ArgumentError(f"times: expected increasing seconds, got {after} after {before}")

    @classmethod
    def timed(
        cls, poses: Sequence[Pose], seconds: Iterable[float | Decimal], curve: Curve = "linear"
    ) -> Self:
        """Return poses at times.

        Args:
            poses: at least one.
            seconds: one time per pose, increasing.
            curve: as of :class:`Trajectory`.
        """
        return cls(poses, tuple(map(nanoseconds, seconds)), curve)

    @property
    def seconds(self) -> tuple[float, ...] | None:
        """The times for people; of a time since 1970 they have six decimals."""
        return None if self.times_ns is None else tuple(time / NS for time in self.times_ns)

    def __len__(self) -> int:
        return len(self.poses)

    @overload
    def __getitem__(self, index: int) -> Pose: ...
    @overload
    def __getitem__(self, index: slice) -> Trajectory: ...
    def __getitem__(self, index: int | slice) -> Pose | Trajectory:
        if not isinstance(index, slice):
            return self.poses[index]
        times_ns = None if self.times_ns is None else self.times_ns[index]
        return replace(self, poses=self.poses[index], times_ns=times_ns)

    def __iter__(self) -> Iterator[Pose]:
        return iter(self.poses)

    def later(self, by_ns: int) -> Trajectory:
        """Return the same at other times."""
        if not by_ns or self.times_ns is None:
            return self
        return replace(self, times_ns=tuple(time + by_ns for time in self.times_ns))

    def at(self, time_ns: int, steps_beyond: float = 0.0) -> Pose:
        """Return the pose at a time, as ``curve`` says.

        Args:
            time_ns: whole nanoseconds.
            steps_beyond: how far outside the trajectory the time may lie, as a multiple of the first or the
                last step, whose motion is then continued.

        Raises:
            ArgumentError: the trajectory has no times, or the time lies outside them.
        """
        if self.times_ns is None:
            raise ArgumentError("trajectory: expected poses with times, got poses without times")
        first = self.times_ns[0]
        last = self.times_ns[-1]
        if first == last == time_ns:
            return self.poses[0]
        i = min(max(bisect_right(self.times_ns, time_ns), 1), len(self.times_ns) - 1)
        start = self.times_ns[i - 1]
        end = self.times_ns[i]
        fraction = (time_ns - start) / (end - start) if end > start else math.nan
        if not -steps_beyond <= fraction <= 1 + steps_beyond:
            beyond = ", or a step beyond" if steps_beyond else ""
            wanted = f"expected {decimal(first)} to {decimal(last)} s{beyond}"
            raise ArgumentError(f"time: {wanted}, got {decimal(time_ns)}")
        if self.curve == "spline":
            positions, rotations = self._splines
            seconds = (time_ns - first) / NS
            return Pose(positions(seconds), rotations(seconds).as_matrix())
        return self.poses[i - 1].interpolate(self.poses[i], fraction)

    def poses_at(self, times_ns: NDArray[np.int64]) -> Poses:
        """Return the poses at times (N,), as :meth:`at`; of a linear curve at most a step beyond it."""
        if self.curve == "linear":
            return Poses.of([self.at(time, steps_beyond=1) for time in times_ns.tolist()])
        positions, rotations = self._splines
        seconds = (times_ns - (self.times_ns or (0,))[0]) / NS
        return Poses(positions(seconds), rotations(seconds).as_matrix())

    def motions(self, times_ns: Sequence[int] | NDArray[np.int64]) -> Motions:
        """Return what the splines and their derivatives are at times (N,), whole nanoseconds."""
        positions, rotations = self._splines
        times = (np.asarray(times_ns) - (self.times_ns or (0,))[0]) / NS
        return Motions(
            positions_w=positions(times),
            velocities_w=positions(times, 1),
            accelerations_w=positions(times, 2),
            rotations=rotations(times).as_matrix(),
            rates=rotations(times, 1),
            rate_changes=rotations(times, 2),
        )

    def misses(self) -> tuple[float, float]:
        """Return how far the splines pass from the poses at most: metres, and radians."""
        at = self.motions(self.times_ns or ())
        poses = Poses.of(self.poses)
        away = np.linalg.norm(at.positions_w - poses.positions, axis=1)
        turned = np.abs(at.rotations - poses.rotations)
        return float(away.max()), float(turned.max())

    @cached_property
    def _splines(self) -> tuple[Any, Any]:
        """Splines of positions, and of rotations with rates in the body's frame; from the first time on."""
        from scipy.interpolate import CubicSpline
        from scipy.spatial.transform import Rotation, RotationSpline

        if self.times_ns is None or len(self.times_ns) < 2:
            raise ArgumentError("trajectory: expected two or more poses with times, for splines")
        poses = Poses.of(self.poses)
        times = (np.array(self.times_ns) - self.times_ns[0]) / NS
        rotations = Rotation.from_matrix(poses.rotations)
        return CubicSpline(times, poses.positions), RotationSpline(times, rotations)
