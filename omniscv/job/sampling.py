"""Poses that a job samples in place of listing them: at random in free space, on a grid, along a path
(docs/job.md). Free space is tested by a function that the caller passes in."""

from collections.abc import Callable
from functools import partial
from itertools import product
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from omniscv.arguments import flag, number, numbers, one_of, optional_number, shown, text, whole_number, wrong
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose
from omniscv.geometry.trajectory import Trajectory
from omniscv.records import checked, mapping, nested, optional, read, record

_MOST = 1_000_000
_LOOKS = 50  # at free positions for one pose, until a class is seen
_TRIES = 200  # for each position: in a box of which 1 in 40 is free, all but one in a hundred are found
_SAMPLES = 1000  # of a spline between two waypoints: its length is then good to a millionth

Angle = float | tuple[float, float]
IsFree = Callable[[Array], bool]
"""Whether a position (3,), metres, world frame, has the clearance of a description."""


def _angle(name: str, value: Any) -> Angle:
    """Read a number, or a pair of numbers in order."""
    if np.ndim(value) == 0:
        return number(name, value)
    low, high = numbers(name, value, (2,)).tolist()
    if low > high:
        raise ArgumentError(f"{name}: expected a number or [low, high], got {shown(value)}")
    return low, high


def _steps(name: str, value: Any) -> Array:
    """Read one number or three as (3,)."""
    return numbers(name, [value] * 3 if np.ndim(value) == 0 else value, (3,))


def _look(name: str, value: Any) -> Any:
    """Read a word or a point."""
    return one_of(name, value, ("ahead", "level")) if isinstance(value, str) else numbers(name, value, (3,))


@record
class Visible:
    """What an image at a pose must show."""

    name: str = checked(text, key="class", help="a class of the job's classes")
    share: float = checked(number, above=0, most=1, help="least share of the image's pixels, of any camera")


Sees = Callable[[Pose], bool]
"""Whether an image at a pose shows enough of what is to be visible."""

_point = partial(numbers, shape=(3,))
_START_HELP = "X,Y,Z of a free position; the middle of the box if not given"


@record
class RandomPoses:
    """Positions drawn evenly from the free space of a box, each with its own angles."""

    count: int = checked(whole_number, unit="poses", most=_MOST, help="number of poses")
    low: ArrayLike = checked(numbers, shape=(3,), help="X,Y,Z of a corner of the box, metres")
    high: ArrayLike = checked(numbers, shape=(3,), help="X,Y,Z of the opposite corner, metres")
    clearance: float = checked(number, above=0, help="least distance to surfaces, metres")
    start: ArrayLike | None = checked(optional(_point), default=None, help=_START_HELP)
    seed: int = checked(whole_number, least=0, default=0, help="seed of the random numbers")
    yaw_deg: Angle = checked(_angle, default=(-180.0, 180.0), help="degrees, or [low, high] to draw from")
    pitch_deg: Angle = checked(_angle, default=0.0, help="degrees, or [low, high] to draw from")
    roll_deg: Angle = checked(_angle, default=0.0, help="degrees, or [low, high] to draw from")
    visible: Visible | None = checked(
        optional(nested(Visible)),
        default=None,
        help="class and share of the image that poses must show; null: any pose",
    )

    def __post_init__(self) -> None:
        _check_box(self)

    def poses(self, is_free: IsFree | None = None, sees: Sees | None = None) -> Trajectory:
        """Return the poses, each at a position that ``is_free``, and from which the image ``sees`` enough.

        Without ``sees`` the first free pose is taken. If 50 free poses in turn show too little, the last of
        them is taken. ArgumentError: too few free positions are found.
        """
        assert is_free is not None
        low = np.asarray(self.low)
        high = np.asarray(self.high)
        draw = np.random.default_rng(self.seed)
        poses: list[Pose] = []
        looks = 0
        for tries in range(1, _TRIES * self.count + 1):
            position = draw.uniform(low, high)
            yaw_deg = _draw_angle(draw, self.yaw_deg)
            pitch_deg = _draw_angle(draw, self.pitch_deg)
            roll_deg = _draw_angle(draw, self.roll_deg)
            if is_free(position):
                pose = Pose.from_angles(position, yaw_deg, pitch_deg, roll_deg)
                looks += 1
                if sees is None or sees(pose) or looks == _LOOKS:
                    poses.append(pose)
                    looks = 0
            if len(poses) == self.count:
                return Trajectory(tuple(poses))
            if tries == 2 * _TRIES and not poses and not looks:
                break
        wanted = f"expected {self.count} positions with a clearance of {self.clearance:g} m in the box"
        raise ArgumentError(
            f"poses.random: {wanted}, got {len(poses)} in {tries} tries; give a smaller clearance"
        )


def _draw_angle(draw: np.random.Generator, angle: Angle) -> float:
    """Return a number that is drawn from a range of angles, of no width for one angle."""
    low, high = np.broadcast_to(angle, 2)
    return float(draw.uniform(low, high))


@record
class GridPoses:
    """Positions on a grid, layer by layer from below; only free ones where a clearance is given."""

    visible: ClassVar[None] = None
    low: ArrayLike = checked(numbers, shape=(3,), help="X,Y,Z of the first position, metres")
    high: ArrayLike = checked(numbers, shape=(3,), help="X,Y,Z of the last position at most, metres")
    step: float | ArrayLike = checked(_steps, help="metres between neighbours, one number or three")
    yaws_deg: ArrayLike = checked(
        numbers, shape=(None,), default=(0.0,), help="yaws at each position, degrees"
    )
    clearance: float | None = checked(
        optional_number, above=0, default=None, help="least distance to surfaces, metres; null: any position"
    )
    start: ArrayLike | None = checked(optional(_point), default=None, help=_START_HELP)

    def __post_init__(self) -> None:
        _check_box(self)
        ascends = bool((np.asarray(self.step) > 0).all())
        if not ascends or self._counts().prod() * len(np.asarray(self.yaws_deg)) > _MOST:
            raise wrong("step", f"distances > 0 that give at most {_MOST} poses", self.step)

    def poses(self, is_free: IsFree | None = None, sees: Sees | None = None) -> Trajectory:
        """Return the poses at all positions of the grid that ``is_free`` accepts; ``sees`` is not used.

        ArgumentError: no position is free.
        """
        low = np.asarray(self.low)
        step = np.asarray(self.step)
        columns, rows, layers = self._counts().astype(int).tolist()
        poses = []
        for layer, row, column in product(range(layers), range(rows), range(columns)):
            position = low + step * (column, row, layer)
            if is_free is None or is_free(position):
                for yaw in np.asarray(self.yaws_deg).tolist():
                    poses.append(Pose.from_angles(position, yaw_deg=yaw))
        if not poses:
            wanted = f"expected positions with a clearance of {self.clearance} m"
            raise ArgumentError(f"poses.grid: {wanted}, got none; give a smaller clearance or another start")
        return Trajectory(tuple(poses))

    def _counts(self) -> Array:
        """(3,) the number of positions along each axis."""
        extent = np.asarray(self.high) - np.asarray(self.low)
        return np.asarray(np.floor(extent / np.asarray(self.step) + 1e-9) + 1)


@record
class PathPoses:
    """A camera that moves along a smooth curve through waypoints at constant speed, whatever the scene."""

    clearance: ClassVar[None] = None
    visible: ClassVar[None] = None
    start: ClassVar[None] = None
    waypoints: ArrayLike = checked(numbers, shape=(None, 3), help="X,Y,Z of at least two positions, metres")
    speed: float = checked(number, above=0, help="metres a second along the curve")
    rate: float = checked(number, above=0, help="poses a second")
    closed: bool = checked(flag, default=False, help="whether the curve ends where it begins")
    look: Literal["ahead", "level"] | ArrayLike = checked(
        _look, default="ahead", help="ahead, level (ahead with a level camera), or X,Y,Z to look at"
    )

    def __post_init__(self) -> None:
        points = np.asarray(self.waypoints)
        steps = np.linalg.norm(np.diff(np.concatenate([points, points[:1]]), axis=0), axis=1)
        if len(points) < 2 or (steps[: None if self.closed else -1] == 0).any():
            raise wrong("waypoints", "at least two, each different from the one before", points)

    def poses(self, is_free: IsFree | None = None, sees: Sees | None = None) -> Trajectory:
        """Return the poses and their times, from 0 s; ``is_free`` and ``sees`` are not used."""
        positions, tangents, times = self._curve()
        if isinstance(self.look, str):
            targets = positions + tangents * (1, 1, self.look == "ahead")
        else:
            targets = np.broadcast_to(np.asarray(self.look), positions.shape)
        return Trajectory.timed(tuple(map(Pose.look_at, positions, targets)), times.tolist())

    def _curve(self) -> tuple[Array, Array, Array]:
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
        # A closed curve does not repeat its first pose.
        count = np.ceil(steps - 1e-9) if self.closed else np.floor(steps + 1e-9) + 1
        if count > _MOST:
            raise ArgumentError(
                f"poses.path: expected at most {_MOST} poses, got {count:g}; give a lower rate"
            )
        times = np.arange(max(count, 1)) / self.rate
        parameters = np.interp(times * self.speed, length, fine)
        if curve is None:
            tangents = np.broadcast_to(points[1] - points[0], (len(parameters), 3))
            return points[0] + parameters[:, None] / chord[1] * tangents, tangents, times
        return np.asarray(curve(parameters)), np.asarray(curve(parameters, 1)), times


def _check_box(box: RandomPoses | GridPoses) -> None:
    """Refuse corners that are not in order; set the default of ``start``."""
    low = np.asarray(box.low)
    high = np.asarray(box.high)
    if (low > high).any():
        raise ArgumentError(f"high: expected numbers >= low {shown(low)}, got {shown(high)}")
    if box.start is None:
        object.__setattr__(box, "start", (low + high) / 2)


SampledPoses = RandomPoses | GridPoses | PathPoses
"""``poses(is_free)`` returns the same poses for the same scene every time. With a ``clearance`` it needs
``is_free``, which tests positions; ``start`` (3,) is a free position."""

KINDS: dict[str, type[Any]] = {"random": RandomPoses, "grid": GridPoses, "path": PathPoses}


def read_sampling(name: str, value: object) -> SampledPoses:
    """Return what ``value``, the ``poses`` of a job, describes: one of ``random``, ``grid``, ``path``.

    Errors begin with ``name``.
    """
    descriptions = mapping(name, value, KINDS)
    if len(descriptions) != 1:
        raise ArgumentError(f"{name}: expected one of {', '.join(KINDS)}; got {shown(list(descriptions))}")
    ((kind, keys),) = descriptions.items()
    sampling: SampledPoses = read(KINDS[kind], keys, f"{name}.{kind}")
    return sampling
