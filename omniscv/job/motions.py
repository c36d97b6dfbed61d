"""What moves in a job: the keys ``motions`` and ``exposure`` of its file.

::

    motions:                              # metres and degrees, world frame; yaw to the left +
      Chair_1:                            # waypoints: linear between them
        - {time: 0, position: [1.2, 0.4, 0.5]}
        - {time: 2, position: [1.2, -0.8, 0.5], yaw_deg: 90}
      Ball: {spline: [...]}               # waypoints, or those of a file, on a smooth curve
      Door: door.tum                      # a trajectory file; relative to the job's
    exposure: {seconds: 0.02, instants: 9}
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from omniscv.arguments import number, numbers, one_of, shown, text, whole_number, within
from omniscv.cameras import Camera, RollingShutter
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.motion import Curve, Motion, object_pose
from omniscv.geometry.trajectory import Trajectory, read_trajectory
from omniscv.records import checked, mapping, optional, read, record


def _instants(name: str, value: object) -> int | Literal["auto"]:
    if value == "auto":
        return "auto"
    if (count := whole_number(name, value, least=3, most=999)) % 2 == 0:
        raise ArgumentError(f"{name}: expected an odd number, got {count}")
    return count


@record
class Exposure:
    """How long the shutter is open while the world moves, and how finely that is captured.

    The colours of an image are the mean of ``instants``: of light where the source's transfer is known, else
    of codes. All other layers are those of the middle, which is one of the instants. The lines of a
    rolling-shutter camera show as many instants of its read-out, those of the first and the last line among
    them.

    Raises:
        ArgumentError: a negative time, an even number, or another word.
    """

    seconds: float = checked(number, least=0, default=0.0, help="exposure time, seconds")
    instants: int | Literal["auto"] = checked(
        _instants, default=9, help="averaged instants, an odd number, or auto: as many as the motion needs"
    )
    camera: Literal["moves", "rests"] = checked(
        one_of,
        words=("moves", "rests"),
        default="moves",
        help="moves along timed poses during the exposure, or rests",
    )

    def check(self, cameras: Mapping[str, Camera]) -> None:
        """Refuse an exposure time for rolling-shutter cameras."""
        rolling = [name for name, camera in cameras.items() if isinstance(camera, RollingShutter)]
        if rolling and self.seconds:
            wanted = "expected 0 for a rolling-shutter camera in a world that moves"
            raise ArgumentError(f"exposure.seconds: {wanted}, got {self.seconds:g} for {rolling[0]!r}")

    def offsets(self) -> tuple[float, ...]:
        """Return seconds from the middle, that of the middle first."""
        count = self._count() if self.seconds else 1
        offsets = [self.seconds * ((i + 0.5) / count - 0.5) for i in range(count)]
        middle = count // 2
        return (0.0, *offsets[:middle], *offsets[middle + 1 :])

    def lines(self, camera: RollingShutter) -> Iterator[tuple[float, Camera]]:
        """Yield seconds after the first line is read, and a camera of the lines that are read about then."""
        if camera.readout == 0:
            yield 0.0, camera
            return
        step = 1 / (self._count() - 1)
        for i in range(self._count()):
            yield camera.readout * i * step, camera.lines((i - 0.5) * step, (i + 0.5) * step)

    def _count(self) -> int:
        """The number of instants, once it is chosen."""
        assert self.instants != "auto"
        return self.instants


@record
class Waypoint:
    """The keys of a pose: metres and degrees, world frame; seconds."""

    position: Any = checked(numbers, shape=(3,))
    yaw_deg: float = checked(number, default=0.0)
    pitch_deg: float = checked(number, default=0.0)
    roll_deg: float = checked(number, default=0.0)
    time: float | None = checked(optional(number), default=None)


def read_motions(name: str, value: object) -> dict[str, Motion]:
    """Return the motions that a mapping from objects describes; ArgumentError for all else."""
    if not isinstance(value, Mapping) or not value:
        raise ArgumentError(f"{name}: expected a mapping from objects to motions, got {shown(value)}")
    return {text(name, key): _read_motion(f"{name}.{key}", motion) for key, motion in value.items()}


def _read_motion(name: str, value: object) -> Motion:
    curve: Curve = "spline" if isinstance(value, Mapping) else "linear"
    if isinstance(value, Mapping):
        if "spline" not in mapping(name, value, ("spline",)):
            raise ArgumentError(f"{name}: missing key 'spline'")
        value = value["spline"]
    path = _read_waypoints(name, value)
    with within(name):
        return Motion(path, curve)


def _read_waypoints(name: str, value: object) -> Trajectory:
    """Return a trajectory of waypoints, or that of a file.

    Raises:
        ArgumentError: the file cannot be read, or several waypoints without times.
    """
    if isinstance(value, str):
        return read_trajectory(Path(text(name, value)), frame="object")
    if not isinstance(value, list) or not value:
        wanted = "expected waypoints, {spline: waypoints}, or the name of a trajectory file"
        raise ArgumentError(f"{name}: {wanted}, got {shown(value)}")
    waypoints = [read(Waypoint, keys, f"{name}[{i}]") for i, keys in enumerate(value)]
    untimed = [i for i, waypoint in enumerate(waypoints) if waypoint.time is None]
    if untimed and len(waypoints) > 1:
        raise ArgumentError(f"{name}[{untimed[0]}]: missing key 'time'; give every waypoint a time")
    with within(name):
        return Trajectory(
            tuple(
                object_pose(point.position, point.yaw_deg, point.pitch_deg, point.roll_deg)
                for point in waypoints
            ),
            tuple(point.time or 0.0 for point in waypoints),
        )


def check_times(
    times: tuple[float, ...] | None,
    motions: Mapping[str, Motion],
    needed: bool,
    poses: Sequence[Pose],
) -> None:
    """Refuse times that do not fit poses or motions; without poses nothing is compared yet.

    Args:
        times: of the poses, seconds; None without.
        motions: by object.
        needed: whether times are needed in any case.
        poses: of the cameras.

    Raises:
        ArgumentError: no times though something moves, another number of times than of poses, or a motion
            that does not overlap with the times.
    """
    if not poses:
        return
    spans = {name: span for name, motion in motions.items() if (span := motion.span)}
    if times is None:
        if needed or spans:
            raise ArgumentError("times: expected them where something moves, got poses without; give 'times'")
        return
    if len(times) != len(poses):
        raise ArgumentError(f"times: expected one for each of {len(poses)} poses, got {len(times)}")
    for name, (start, end) in spans.items():
        if max(times) < start or min(times) > end:
            wanted = f"expected waypoints around the job's times, {min(times):.15g} to {max(times):.15g} s"
            raise ArgumentError(f"motions.{name}: {wanted}, got {start:.15g} to {end:.15g} s")
