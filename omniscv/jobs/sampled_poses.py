"""Poses that a job samples in place of listing them: at random in free space, on a grid, along a path.

::

    poses:
      random: {count: 50, low: [-2.5, -2, 1.2], high: [2.5, 2, 1.8], clearance: 0.3, start: [0, 0, 1.5],
               seed: 0, yaw_deg: [-180, 180], pitch_deg: [-10, 10]}

      grid: {low: [-2, -2, 1.5], high: [2, 2, 1.5], step: 0.5, yaws_deg: [0, 90], clearance: 0.3,
             start: [0, 0, 1.5]}

      path: {waypoints: [[-2, 0, 1.5], [0, 1, 1.5], [2, 0, 1.5]], speed: 1.0, rate: 30, look: ahead}

One of the three. Positions are metres, world frame; angles are numbers, or ``[low, high]`` to draw from.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from inspect import signature
from typing import Any, Literal, Protocol, cast

import numpy as np
from numpy.typing import ArrayLike

from omniscv.arguments import (
    Reader,
    fields,
    flag,
    number,
    numbers,
    one_of,
    optional_number,
    shown,
    whole_number,
    within,
)
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose
from omniscv.geometry.trajectory import Trajectory
from omniscv.jobs.free_space import FreeSpace
from omniscv.sources.base import Source

_MOST = 1_000_000
_TRIES = 200  # for each position: in a box of which 1 in 40 is free, all but one in a hundred are found
_SAMPLES = 1000  # of a spline between two waypoints: its length is then good to a millionth

Angle = float | tuple[float, float]


class SampledPoses(Protocol):
    """How poses are chosen.

    Attributes:
        captures: whether the scene decides: a source is needed then.
    """

    @property
    def captures(self) -> bool: ...

    def poses(self, source: Source | None = None) -> Trajectory:
        """Return the poses; the same ones for the same scene, every time."""


@dataclass(frozen=True)
class RandomPoses:
    """Positions drawn from the free space of a box, evenly, each with angles of its own.

    Args:
        count: how many.
        low, high: (3,) metres, world frame, opposite corners of the box.
        clearance: metres to every surface, at least.
        start: (3,) a place that is known to be free; the middle of the box if not given.
        seed: of the random numbers; the same seed gives the same poses.
        yaw_deg, pitch_deg, roll_deg: a number, or (low, high) to draw from.

    Raises:
        ArgumentError: a value outside its domain.
    """

    count: int
    low: ArrayLike
    high: ArrayLike
    clearance: float
    start: ArrayLike | None = None
    seed: int = 0
    yaw_deg: Angle = (-180.0, 180.0)
    pitch_deg: Angle = 0.0
    roll_deg: Angle = 0.0

    def __post_init__(self) -> None:
        low, high = _box(self.low, self.high)
        start = (low + high) / 2 if self.start is None else numbers("start", self.start, (3,))
        angles = {name: _angle(name, getattr(self, name)) for name in _ANGLES}
        vars(self).update(
            count=whole_number("count", self.count, "poses", most=_MOST),
            seed=whole_number("seed", self.seed, least=0),
            clearance=number("clearance", self.clearance, above=0),
            low=low,
            high=high,
            start=start,
            **angles,
        )

    @property
    def captures(self) -> bool:
        """True: free space is found by looking."""
        return True

    def poses(self, source: Source | None = None) -> Trajectory:
        """Return the poses.

        Raises:
            ArgumentError: no source, or the box has too little free space.
            OmniscvError: depth cannot be captured.
        """
        space, draw = _space(source, self.start, self.clearance), np.random.default_rng(self.seed)
        found: list[Pose] = []
        for _ in range(_TRIES * self.count):
            position = draw.uniform(np.asarray(self.low), np.asarray(self.high))
            angles = [draw.uniform(*np.broadcast_to(getattr(self, name), 2)) for name in _ANGLES]
            if space.holds(position):
                found.append(Pose.from_angles(position, *angles))
            if len(found) == self.count:
                return Trajectory(tuple(found))
        wanted = f"expected {self.count} places with a clearance of {self.clearance:g} m in the box"
        tried = f"{_TRIES * self.count} tries"
        raise ArgumentError(f"poses.random: {wanted}, got {len(found)} in {tried}; give a smaller clearance")


@dataclass(frozen=True)
class GridPoses:
    """Positions on a grid, layer by layer from below; only free ones where a clearance is given.

    Args:
        low, high: (3,) metres, world frame: the first point, and the corner that none passes.
        step: metres between neighbours, one number or three.
        yaws_deg: each position is taken once with each.
        clearance, start: as :class:`RandomPoses`; every point of the grid is taken without a clearance.

    Raises:
        ArgumentError: a value outside its domain.
    """

    low: ArrayLike
    high: ArrayLike
    step: float | ArrayLike
    yaws_deg: ArrayLike = (0.0,)
    clearance: float | None = None
    start: ArrayLike | None = None

    def __post_init__(self) -> None:
        low, high = _box(self.low, self.high)
        steps = np.broadcast_to(numbers("step", np.ravel(np.asarray(self.step)), (None,)), 3)
        yaws = numbers("yaws_deg", self.yaws_deg, (None,))
        if not ((steps > 0).all() and (_counts(low, high, steps).prod() * len(yaws)) <= _MOST):
            wanted = f"expected distances > 0 that give at most {_MOST} poses"
            raise ArgumentError(f"step: {wanted}, got {shown(self.step)}")
        start = (low + high) / 2 if self.start is None else numbers("start", self.start, (3,))
        clearance = optional_number("clearance", self.clearance, above=0)
        vars(self).update(low=low, high=high, step=steps, yaws_deg=yaws, clearance=clearance, start=start)

    @property
    def captures(self) -> bool:
        """Whether only free places are wanted."""
        return self.clearance is not None

    def poses(self, source: Source | None = None) -> Trajectory:
        """Return the poses.

        Raises:
            ArgumentError: a clearance but no source, or no point of the grid is free.
            OmniscvError: depth cannot be captured.
        """
        space = None if self.clearance is None else _space(source, self.start, self.clearance)
        free = [each for each in self._points() if space is None or space.holds(each)]
        if not free:
            wanted = f"expected points with a clearance of {self.clearance} m"
            raise ArgumentError(f"poses.grid: {wanted}, got none; give a smaller clearance or another start")
        yaws = np.asarray(self.yaws_deg).tolist()
        return Trajectory(tuple(Pose.from_angles(each, yaw_deg=yaw) for each in free for yaw in yaws))

    def _points(self) -> Iterator[Array]:
        low, high, step = (np.asarray(each, dtype=np.float64) for each in (self.low, self.high, self.step))
        x, y, z = (
            low + step * np.arange(count)
            for low, step, count in zip(low, step, _counts(low, high, step), strict=True)
        )
        yield from (np.array([a, b, c]) for c in z for b in y for a in x)


@dataclass(frozen=True)
class PathPoses:
    """A camera that moves along a smooth curve through waypoints, at one speed.

    Args:
        waypoints: (N, 3) metres, world frame, at least two.
        speed: metres a second along the curve.
        rate: poses a second.
        closed: whether the curve ends where it begins.
        look: ``ahead`` along the curve, ``level``: ahead with a level camera, or (3,) a point to look at.

    Raises:
        ArgumentError: a value outside its domain, or waypoints on top of each other.
    """

    waypoints: ArrayLike
    speed: float
    rate: float
    closed: bool = False
    look: Literal["ahead", "level"] | ArrayLike = "ahead"

    def __post_init__(self) -> None:
        points = numbers("waypoints", self.waypoints, (None, 3))
        steps = np.linalg.norm(np.diff(np.concatenate([points, points[:1]]), axis=0), axis=1)
        if len(points) < 2 or (steps[: None if self.closed else -1] == 0).any():
            raise ArgumentError(
                f"waypoints: expected at least two, each elsewhere than the one before, got {shown(points)}"
            )
        look = self.look
        if isinstance(look, str):
            one_of("look", look, ("ahead", "level"))
        else:
            look = numbers("look", look, (3,))
        vars(self).update(
            waypoints=points,
            speed=number("speed", self.speed, above=0),
            rate=number("rate", self.rate, above=0),
            closed=flag("closed", self.closed),
            look=look,
        )

    @property
    def captures(self) -> bool:
        """False: a path is what its waypoints say, free or not."""
        return False

    def poses(self, source: Source | None = None) -> Trajectory:
        """Return the poses and their times, from 0 s; nothing is captured.

        Raises:
            ArgumentError: too many poses, or the camera would look straight up or down.
        """
        positions, tangents, times = self._moves()
        if isinstance(self.look, str):
            ahead = tangents * (1, 1, self.look == "ahead")
            targets = positions + ahead
        else:
            targets = np.broadcast_to(np.asarray(self.look), positions.shape)
        poses = tuple(Pose.look_at(*each) for each in zip(positions, targets, strict=True))
        return Trajectory(poses, tuple(times.tolist()))

    def _moves(self) -> tuple[Array, Array, Array]:
        """(K, 3) positions, (K, 3) tangents and (K,) times, s, at equal distances along the curve."""
        from scipy.interpolate import CubicSpline

        points = np.asarray(self.waypoints)
        if self.closed:
            points = np.concatenate([points, points[:1]])
        # Parameters by chord length: the curve then bends little between waypoints at uneven distances.
        chord = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        ends: Any = "periodic" if self.closed else "natural"
        curve = CubicSpline(chord, points, bc_type=ends) if len(points) > 2 else None
        fine = np.interp(
            np.linspace(0, len(chord) - 1, _SAMPLES * (len(chord) - 1) + 1), np.arange(len(chord)), chord
        )
        along = np.linspace(points[0], points[1], len(fine)) if curve is None else curve(fine)
        length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(along, axis=0), axis=1))])
        steps = length[-1] / self.speed * self.rate
        count = (
            np.ceil(steps - 1e-9) if self.closed else np.floor(steps + 1e-9) + 1
        )  # the first one is not repeated
        if count > _MOST:
            raise ArgumentError(
                f"poses.path: expected at most {_MOST} poses, got {count:g}; give a lower rate"
            )
        times = np.arange(max(count, 1)) / self.rate
        at = np.interp(times * self.speed, length, fine)
        if curve is None:
            tangents = np.broadcast_to(points[1] - points[0], (len(at), 3))
            return points[0] + at[:, None] / chord[1] * tangents, tangents, times
        return np.asarray(curve(at)), np.asarray(curve(at, 1)), times


_ANGLES = ("yaw_deg", "pitch_deg", "roll_deg")


def _angle(name: str, value: Any) -> Angle:
    """A number, or a pair of numbers in order."""
    if np.ndim(value) == 0:
        return number(name, value)
    low, high = numbers(name, value, (2,)).tolist()
    if low > high:
        raise ArgumentError(f"{name}: expected a number or [low, high], got {shown(value)}")
    return low, high


def _space(source: Source | None, start: ArrayLike | None, clearance: float) -> FreeSpace:
    if source is None or start is None:
        raise ArgumentError("poses: expected a source in which free space is found, got none")
    return FreeSpace(source, start, clearance)


def _counts(low: Array, high: Array, steps: Array) -> Array:
    """(3,) how many points a grid has along each axis."""
    return np.asarray(np.floor((high - low) / steps + 1e-9) + 1)


def _box(low: ArrayLike, high: ArrayLike) -> tuple[Array, Array]:
    """Two opposite corners, the lower one first."""
    corners = numbers("low", low, (3,)), numbers("high", high, (3,))
    if (corners[0] > corners[1]).any():
        raise ArgumentError(f"high: expected numbers >= low {shown(corners[0])}, got {shown(corners[1])}")
    return corners


def _as_given(name: str, value: Any) -> Any:
    """A value that its constructor checks."""
    return value


_KINDS: dict[str, Callable[..., SampledPoses]] = {"random": RandomPoses, "grid": GridPoses, "path": PathPoses}


def read(name: str, value: object) -> SampledPoses:
    """Return what a mapping under a job's ``poses:`` describes.

    Raises:
        ArgumentError: no mapping of one of the kinds, or as the kind raises.
    """
    found = fields(name, value, {word: partial(_read, kind) for word, kind in _KINDS.items()})
    if len(found) != 1:
        raise ArgumentError(f"{name}: expected one of {', '.join(_KINDS)}; got {shown(list(found))}")
    (only,) = found.values()
    return cast(SampledPoses, only)


def _read(kind: Callable[..., SampledPoses], name: str, value: object) -> SampledPoses:
    parameters = signature(kind).parameters.values()
    readers: dict[str, Reader] = {each.name: _as_given for each in parameters}
    needed = [each.name for each in parameters if each.default is each.empty]
    with within(name):
        return kind(**fields("", value, readers, needed))
