"""Rolling shutters: cameras, and turning scanners, that move while their image is read line by line."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar, Literal, Self, get_args

import numpy as np
from numpy.typing import ArrayLike

from omniscv.arguments import number, numbers, one_of, shown, within
from omniscv.cameras.base import Array, Camera, Mask, Viewpoints, grid_axes, viewpoints_by_line
from omniscv.cameras.lidar import Lidar
from omniscv.cameras.parallel_rays import PushBroom
from omniscv.cameras.registry import from_dict, model, register
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.cubic_path import CubicPath, rows_along
from omniscv.geometry.trajectory import Trajectory, nanoseconds

Scan = Literal["top-to-bottom", "bottom-to-top", "left-to-right", "right-to-left"]
_MOST_TURN_DEG = 90.0  # while the image is read
AT_REST = Pose(np.zeros(3), np.eye(3))
_INTERVALS = 16  # of the read-out: each is searched for one crossing
_FINER = 16  # times as many intervals for points that a line comes near
_NEAR = 4.0  # intervals within which a line counts as near
_MOST_STEPS = 60  # of a search for the line of a point
_CONVERGED = 1e-14  # fraction of the image between a point's line and the line that is read: ends the search
_MEETS = 1e-9  # the same: the point is seen


@register
class RollingShutter(Camera):
    """A central camera, ``lidar`` or ``push-broom`` that moves while its lines are read one by one.

    The line at a fraction s of the image, 0 to 1 in the direction of ``scan``, is read at the time
    ``t = s readout``; its rays are those of ``base``, rotated by ``R = exp(t w)`` and shifted by ``t v``.
    The first column of a ``lidar`` fires at t = 0, its channels as its table says.
    Parameters: ``base``, the camera at rest, or its dict (without size and a centre in the middle);
    ``readout`` >= 0, seconds from the first edge to the last; ``velocity`` v, metres per second, and
    ``angular_velocity_deg`` w, axis times degrees per second, both in the frame of the camera at t = 0, whose
    pose is the image's; ``scan``, "top-to-bottom", "bottom-to-top", "left-to-right" or "right-to-left";
    ``path``, in place of the velocities, rows ``t x y z qx qy qz qw`` in that frame, on cubics through four
    of them and the next three: :meth:`on` makes them of a job's path.
    Domain: that of the base; turns of at most 90 degrees. Of several lines that see a point, ``project``
    returns the first. ``readout=0``, or no motion, equals the base to the bit.
    Source: Meingast et al. 2005, Geometric models of rolling-shutter cameras.
    """

    name = "rolling-shutter"
    typical: ClassVar = {"base": {"model": "pinhole"}, "readout": 0.03, "velocity": (20.0, 0.0, 0.0)}
    central = False

    def __init__(
        self,
        width: int,
        height: int,
        base: Camera | Mapping[str, Any],
        readout: float,
        velocity: ArrayLike = (0.0, 0.0, 0.0),
        angular_velocity_deg: ArrayLike = (0.0, 0.0, 0.0),
        scan: Scan = "top-to-bottom",
        path: ArrayLike | None = None,
    ) -> None:
        super().__init__(width, height)
        self.base = _central(base, self.width, self.height)
        self.readout = number("readout", readout, least=0)
        self.velocity = numbers("velocity", velocity, (3,))
        self.angular_velocity_deg = numbers("angular_velocity_deg", angular_velocity_deg, (3,))
        self.scan: Scan = one_of("scan", scan, get_args(Scan))
        self.path = None if path is None else numbers("path", path, (None, 8))
        self._set_lines()
        self._set_motion()

    def _set_lines(self) -> None:
        """Set the axis along which lines are read, their number, and what is special about their base."""
        self._axis = 1 if self.scan in ("top-to-bottom", "bottom-to-top") else 0
        self._backward = self.scan in ("bottom-to-top", "right-to-left")
        self._lines = self.height if self._axis == 1 else self.width
        self._wraps = self._axis == 0 and self.base.wraps
        self._fires = self.base if isinstance(self.base, Lidar) and self._axis == 0 else None
        self._is_line = isinstance(self.base, PushBroom)
        if self._is_line and self._axis:
            one_of("scan: of a push-broom", self.scan, ("left-to-right", "right-to-left"))

    def _set_motion(self) -> None:
        """Set the path in the frame of the camera at t = 0; ArgumentError for one that turns too far."""
        if self.path is None:
            velocities = *self.velocity, *np.radians(self.angular_velocity_deg)
            self._moved = CubicPath(np.array([[0.0] * 7, [1.0, *velocities]]))
            turn_deg = math.degrees(self._moved.turn) * self.readout
            name = "angular_velocity_deg"
        else:
            if self.has_velocity:
                raise ArgumentError(f"path: expected it or velocities, got both ({self.velocity.tolist()})")
            self._moved = CubicPath(self.path)
            turn_deg = math.degrees(self._moved.turn)
            name = "path"
        number(f"{name}: the turn in degrees while the image is read", turn_deg, most=_MOST_TURN_DEG)
        self._at_rest = not (self.readout and self._moved.moves)

    @property
    def has_velocity(self) -> bool:
        """Whether it has velocities."""
        return bool(self.velocity.any() or self.angular_velocity_deg.any())

    @property
    def moves_itself(self) -> bool:
        """Whether it has velocities or a path."""
        return self.has_velocity or self.path is not None

    def on(self, path: Trajectory, time_ns: int, mounted: Pose = AT_REST) -> Self:
        """Return the camera on a rig that moves along a path.

        Args:
            path: of the rig.
            time_ns: of the image, whole nanoseconds: its first line's.
            mounted: the camera on the rig, ``T_rig_cam``; the rig itself if not given.

        Raises:
            ArgumentError: the camera has velocities, or the path does not last from the first line to the
                last, or a step of it beyond.
        """
        first, last = self._span
        first_ns = time_ns + nanoseconds(first * self.readout)
        last_ns = time_ns + nanoseconds(last * self.readout)
        path_rows = rows_along(path, time_ns, (first_ns, last_ns), mounted)
        return type(self)(**{**self._arguments(), "path": path_rows})

    def at_rest(self) -> Self:
        """Return the camera without its path; itself if it has none."""
        return self if self.path is None else type(self)(**{**self._arguments(), "path": None})

    def _arguments(self) -> dict[str, Any]:
        """Return the arguments; of the base without its size, and without a centre in the middle."""
        base = self.base.to_dict()
        implied = ["width", "height"]
        if (self.base.center == (self.width / 2, self.height / 2)).all():
            implied += ["center", "cx", "cy"]
        for key in implied:
            base.pop(key, None)
        return {**super()._arguments(), "base": base}

    def lines(self, first: float, last: float) -> ReadOutLines:
        """Return the camera of the lines that are read between two fractions of the read-out, 0 to 1.

        Pixels of other lines are not valid.

        Args:
            first: the least fraction.
            last: the greatest one, which is excluded itself.
        """
        return ReadOutLines(first, last, **self._arguments())

    # -- rays -----------------------------------------------------------------------------------

    @property
    def _span(self) -> tuple[float, float]:
        """The fractions of the read-out at which the first line is read, and the last."""
        if self._fires is None:
            return 0.0, 1.0
        early = 0.5 / self._lines
        late = self._fires.delays.max() / (self.readout or 1.0)
        return -early, float(1 - early + late)

    def _fraction(self, pixels: Array) -> Array:
        """Return the fraction of the read-out at which pixels (..., 2) are read, of a grid by its lines."""
        axes = grid_axes(pixels)
        part: Array = axes[self._axis] / self._lines
        if self._fires is not None:
            part = part - 0.5 / self._lines + self._fires.delay(axes[1]) / (self.readout or 1.0)
        return 1 - part if self._backward else part

    def parts_read(self) -> Array:
        """Return (H, W) the fraction of the read-out at which each pixel is read."""
        return np.broadcast_to(self._fraction(self.pixels()), (self.height, self.width))

    def seconds(self) -> Array:
        """Return (H, W) seconds from the image's time to the reading of each pixel."""
        return np.asarray(self.readout * self.parts_read())

    def _unproject(self, pixels: Array) -> tuple[Array, Array, Mask | bool]:
        origins, directions, valid = self.base._unproject(pixels)
        if self._at_rest:
            return origins, directions, valid
        rotations, shifted = self._moved.at(self.readout * self._fraction(pixels))
        if not self.base.central:
            shifted = shifted + _turned(rotations, np.broadcast_to(origins, directions.shape))
        directions = _turned(rotations, directions)
        return np.broadcast_to(shifted, directions.shape), directions, valid

    def viewpoints(self, count: int | None = None) -> Viewpoints:
        """Return one centre per line, or at most ``count`` for equal intervals of the read-out."""
        middle = np.arange(0.5, self._lines) / self._lines
        rotations = np.broadcast_to(np.eye(3), (self._lines, 3, 3))
        origins = np.zeros((self._lines, 3))
        if not self._at_rest:
            rotations, origins = self._moved.at(self.readout * (1 - middle if self._backward else middle))
        if not self.base.central:  # the mean of each line's
            own, _, _ = self.base._unproject(self.base.pixels())
            own = np.broadcast_to(own, (self.height, self.width, 3)).mean(axis=self._axis)
            origins = origins + _turned(rotations, own)
        return viewpoints_by_line(origins, self.valid(), 1 - self._axis, count)

    # -- points ---------------------------------------------------------------------------------

    def _project(self, points: Array) -> tuple[Array, Mask]:
        if self._at_rest:
            nonzero = np.asarray(points.any(axis=-1))
            pixels, valid = self.base._project(np.where(nonzero[..., None], points, 1.0))
            return pixels, np.asarray(valid & nonzero)
        flat = points.reshape(-1, 3)
        part, near = self._search(flat, _INTERVALS)
        # A line that reaches a point and turns back sees it twice, perhaps within one interval.
        twice = np.flatnonzero(near & np.isnan(part))
        if len(twice):
            part[twice], _ = self._search(flat[twice], _FINER * _INTERVALS)
        seen = ~np.isnan(part)
        pixels, _ = self._project_at(flat, np.where(seen, part, 0.0))
        if self._is_line:
            pixels[:, 0] = self.width * (1 - part if self._backward else part)
        if self._wraps:  # the seam is in the first column and in the last
            late = self._fraction(pixels) - part
            pixels[:, 0] += self.width * np.round(late) * (1 if self._backward else -1)
        return pixels.reshape(*points.shape[:-1], 2), seen.reshape(points.shape[:-1])

    def _to_base(self, points: Array, part: Array) -> Array:
        """Return points (N, 3) in the frames of the base at fractions (N,) of the read-out."""
        rotations, positions = self._moved.at(self.readout * part)
        return _turned(np.swapaxes(rotations, -1, -2), points - positions)

    def _project_at(self, points: Array, part: Array) -> tuple[Array, Mask]:
        """Project points (N, 3) with the base at fractions (N,) of the read-out."""
        points = self._to_base(points, part)
        nonzero = np.asarray(points.any(axis=1))
        pixels, valid = self.base._project(np.where(nonzero[:, None], points, 1.0))
        return pixels, np.asarray(valid & nonzero & self._within_image(pixels)[1])

    def _late(self, points: Array, part: Array) -> Array:
        """Return how much later than ``part`` the lines of points are read, (N,), NaN if not seen; of a
        ``push-broom`` the half turns from its line to the points, 0 where one is seen, too."""
        if self._is_line:
            x, _, z = self._to_base(points, part).T
            return np.where(z > 0, np.arctan2(x, z) / np.pi, np.nan)
        late: Array = self._fraction(self._project_at(points, part)[0]) - part
        return late - np.round(late) if self._wraps else late

    def _search(self, points: Array, intervals: int) -> tuple[Array, Mask]:
        """Return the first fraction of the read-out whose line sees points, (N,), NaN if there is none; and
        whether a line was within ``_NEAR`` of the intervals of the point at the end of one."""
        first = np.full(len(points), np.nan)
        begin, end = self._span
        before = self._late(points, np.full(len(points), begin))
        near = np.abs(before) <= _NEAR / intervals
        for k in range(intervals):
            low = begin + (end - begin) * k / intervals
            high = begin + (end - begin) * (k + 1) / intervals
            after = self._late(points, np.full(len(points), high))
            near |= np.abs(after) <= _NEAR / intervals
            # If the base sees the point at one end only, the point may be seen up to the border in between.
            meets = (before >= -_CONVERGED) & (after <= _CONVERGED) | (before <= 0) & (after >= 0)
            meets |= np.isnan(before) & (after <= _CONVERGED) | np.isnan(after) & (before >= -_CONVERGED)
            rows = np.flatnonzero(meets & np.isnan(first))
            if len(rows):
                root = self._root(points[rows], (low, high), (before[rows], after[rows]))
                _, valid = self._project_at(points[rows], root)
                seen = valid & (np.abs(self._late(points[rows], root)) <= _MEETS)
                first[rows] = np.where(seen, root, np.nan)
            before = after
        return first, near

    def _root(self, points: Array, ends: tuple[float, float], late: tuple[Array, Array]) -> Array:
        """Return the fractions (N,) between two ends at which the lines of points are read: by regula falsi
        (Illinois) if the point is seen at both ends, else by bisection towards the border."""
        sides = np.where(np.abs(late[0]) <= _CONVERGED, 0, 1)
        root = np.array(ends)[sides]
        left = np.full(len(points), ends[0])
        right = np.full(len(points), ends[1])
        late_left = late[0].copy()
        late_right = late[1].copy()
        pending = np.flatnonzero(~(np.minimum(np.abs(late_left), np.abs(late_right)) <= _CONVERGED))
        fixed = np.zeros(len(points))  # the end that the last step did not move: -1 left, 1 right
        for _ in range(_MOST_STEPS):
            if not len(pending):
                break
            a = left[pending]
            b = right[pending]
            fa = late_left[pending]
            fb = late_right[pending]
            secant = (a * fb - b * fa) / (fb - fa)
            at = np.where((secant > a) & (secant < b), secant, (a + b) / 2)
            value = self._late(points[pending], at)
            # Keep the half whose ends have unlike signs, or of whose ends one is not seen.
            first = np.where(np.isnan(fa) | np.isnan(fb), np.isnan(value) == np.isnan(fb), value * fa < 0)
            fixed_end = np.where(first, -1.0, 1.0)
            half = np.where(fixed[pending] == fixed_end, 0.5, 1.0)
            left[pending] = np.where(first, a, at)
            right[pending] = np.where(first, at, b)
            late_left[pending] = np.where(first, fa * half, value)
            late_right[pending] = np.where(first, value, fb * half)
            root[pending] = at
            fixed[pending] = fixed_end
            done = (np.abs(value) <= _CONVERGED) | (right[pending] - left[pending] <= _CONVERGED / 8)
            pending = pending[~done]
        return root


class ReadOutLines(RollingShutter):
    """Some lines of a rolling-shutter camera, for a world that moves during the read-out.

    Args:
        first: the least fraction of the read-out.
        last: the greatest one, which is excluded itself.
        shutter: arguments of the whole camera.
    """

    name = "rolling-shutter-lines"

    def __init__(self, first: float, last: float, **shutter: Any) -> None:
        super().__init__(**shutter)
        self._first = first
        self._last = last
        self._shutter = shutter

    def _arguments(self) -> dict[str, Any]:
        return {"first": self._first, "last": self._last, **self._shutter}

    def _is_read(self, pixels: Array) -> Mask:
        """Return whether pixels (..., 2) are on these lines."""
        part = self._fraction(pixels)
        return np.asarray((part >= self._first) & (part < self._last))

    def _unproject(self, pixels: Array) -> tuple[Array, Array, Mask | bool]:
        origins, directions, valid = super()._unproject(pixels)
        return origins, directions, valid & self._is_read(pixels)

    def _project(self, points: Array) -> tuple[Array, Mask]:
        pixels, valid = super()._project(points)
        return pixels, valid & self._is_read(pixels)


def _turned(rotations: Array, vectors: Array) -> Array:
    """Return vectors (..., 3) turned by rotations (..., 3, 3) of each, or of each line of a grid."""
    if rotations.shape[-3:-2] == (1,):  # rows: one product for each
        return np.asarray(vectors @ np.swapaxes(rotations[..., 0, :, :], -1, -2))
    return np.asarray((rotations @ vectors[..., None])[..., 0])


def _central(base: Camera | Mapping[str, Any], width: int, height: int) -> Camera:
    """Return the base camera with a size, from itself or its description; ArgumentError if not central."""
    with within("base"):
        description = base.to_dict() if isinstance(base, Camera) else base
        if not isinstance(description, Mapping) or "model" not in description:
            raise ArgumentError(f"expected a camera or a mapping with 'model' in it, got {shown(base)}")
        base_model = model(description["model"])
        if not issubclass(base_model, Lidar | PushBroom) and not base_model.central:
            raise ArgumentError(f"expected a central camera or a lidar, got {description['model']}")
        camera = from_dict({"width": width, "height": height, **description})
        if isinstance(camera, PushBroom) and not camera.readout:
            raise ArgumentError(f"expected a push-broom with a readout, got travel {camera.travel.tolist()}")
        if (camera.width, camera.height) != (width, height):
            raise ArgumentError(f"expected {width} x {height} px, got {camera.width} x {camera.height}")
        return camera


def readout_of(camera: Camera) -> float:
    """Return the seconds from the first line of a camera to its last; 0 of one that has no lines."""
    return camera.readout if isinstance(camera, RollingShutter | Lidar | PushBroom) else 0.0


def as_shutter(camera: Camera) -> RollingShutter:
    """Return a camera that can move while its lines are read: itself, or around a lidar or push-broom."""
    if isinstance(camera, RollingShutter):
        return camera
    if not isinstance(camera, Lidar | PushBroom):
        raise ArgumentError(f"path: expected none of a camera without lines, got one of {camera.name}")
    return RollingShutter(camera.width, camera.height, camera, camera.readout, scan="left-to-right")


def on_path(camera: Camera, path: Trajectory, time_ns: int, mounted: Pose) -> Camera:
    """Return a camera as it moves along a path while its lines are read, see :meth:`RollingShutter.on`.

    Args:
        camera: returned as it is if all of its image is of one instant.
        path: of the rig.
        time_ns: of the image, whole nanoseconds: its first line's.
        mounted: the camera on the rig, ``T_rig_cam``.
    """
    if not nanoseconds(readout_of(camera)):
        return camera
    return as_shutter(camera).on(path, time_ns, mounted)


def with_path(camera: Camera, path: object) -> Camera:
    """Return a camera that moves along the rows of a path, see :class:`RollingShutter`; itself if ``path`` is
    None."""
    return camera if path is None else from_dict({**as_shutter(camera).to_dict(), "path": path})


def path_of(camera: Camera) -> list[list[float]] | None:
    """Return the rows of the path on which a camera moves; None for a camera that rests."""
    path = camera.path if isinstance(camera, RollingShutter) else None
    return None if path is None else path.tolist()


def without_path(camera: Camera) -> Camera:
    """Return a camera that moves on a path, at rest; others as they are."""
    return camera.at_rest() if isinstance(camera, RollingShutter) else camera
