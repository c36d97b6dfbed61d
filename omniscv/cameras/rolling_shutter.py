"""Rolling shutters: cameras, and turning scanners, that move while their image is read line by line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal, Self, get_args

import numpy as np
from numpy.typing import ArrayLike

from omniscv.arguments import number, numbers, one_of, shown, within
from omniscv.cameras.base import Array, Camera, Mask, Viewpoints, viewpoints_by_line
from omniscv.cameras.lidar import Lidar
from omniscv.cameras.registry import from_dict, model, register
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.trajectory import Trajectory

Scan = Literal["top-to-bottom", "bottom-to-top", "left-to-right", "right-to-left"]
_MOST_TURN_DEG = 90.0
_INTERVALS = 16  # of the read-out: each is searched for one crossing
_FINER = 16  # times as many intervals for points that a line comes near
_NEAR = 4.0  # intervals within which a line counts as near
_MOST_STEPS = 60
_CONVERGED = 1e-14  # fraction of the image between a point's line and the line that is read: ends the search
_MEETS = 1e-9  # the same: the point is seen


@register
class RollingShutter(Camera):
    """A central camera, or a ``lidar``, that moves while its lines are read, one after the other.

    The line at a fraction s of the image, 0 to 1 in the direction of ``scan``, is read at the time
    ``t = s readout``; its rays are those of ``base``, rotated by ``R = exp(t w)`` and shifted by ``t v``.
    Parameters: ``base``, the camera at rest, or its dict (without size and a centre in the middle);
    ``readout`` >= 0, seconds from the first edge to the last; ``velocity`` v, metres per second, and
    ``angular_velocity_deg`` w, axis times degrees per second, both in the frame of the camera at t = 0, whose
    pose is the image's; ``scan``, "top-to-bottom", "bottom-to-top", "left-to-right" or "right-to-left".
    Domain: that of the base; turns of at most 90 degrees. Of several lines that see a point, ``project``
    returns the first. ``readout=0``, or no motion, equals the base to the bit.
    Source: Meingast et al. 2005, Geometric models of rolling-shutter cameras.
    """

    name = "rolling-shutter"
    typical: ClassVar = {
        "base": {"model": "pinhole"},
        "readout": 0.03,
        "velocity": (20.0, 0.0, 0.0),
    }
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
    ) -> None:
        super().__init__(width, height)
        self.base = _central(base, self.width, self.height)
        self.readout = number("readout", readout, least=0)
        self.velocity = numbers("velocity", velocity, (3,))
        self.angular_velocity_deg = numbers("angular_velocity_deg", angular_velocity_deg, (3,))
        self.scan: Scan = one_of("scan", scan, get_args(Scan))
        self._travel = self.readout * self.velocity
        turn_deg = self.readout * float(np.linalg.norm(self.angular_velocity_deg))
        number(
            "angular_velocity_deg: the turn in degrees while the image is read", turn_deg, most=_MOST_TURN_DEG
        )
        self._turn = np.radians(turn_deg)
        x, y, z = self.angular_velocity_deg * (self.readout / turn_deg if turn_deg else 0.0)
        self._cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])  # cross product with the axis
        self._axis = 1 if self.scan in ("top-to-bottom", "bottom-to-top") else 0
        self._backward = self.scan in ("bottom-to-top", "right-to-left")
        self._lines = self.height if self._axis == 1 else self.width
        self._wraps = self._axis == 0 and self.base.wraps
        self._at_rest = not (self._travel.any() or self._turn)

    @classmethod
    def between(
        cls, base: Camera, readout: float, start: Pose, end: Pose, scan: Scan = "top-to-bottom"
    ) -> tuple[Self, Pose]:
        """Return the camera with given poses at its first and its last line, and the pose of its image.

        It moves between them as :meth:`Pose.interpolate`.

        Args:
            base: the camera at rest.
            readout: seconds between the poses, > 0.
            start, end: of the base, world frame.
            scan: the direction.
        """
        readout = number("readout", readout, above=0)
        velocity = start.rotation.T @ (end.position - start.position) / readout
        angular_velocity_deg = np.degrees(start.rotation_vector_to(end)) / readout
        camera = cls(base.width, base.height, base, readout, velocity, angular_velocity_deg, scan)
        return camera, start

    @classmethod
    def along(
        cls,
        base: Camera,
        readout: float,
        times: ArrayLike,
        poses: Sequence[Pose],
        at: float,
        scan: Scan = "top-to-bottom",
    ) -> tuple[Self, Pose]:
        """Return the camera whose image is read along a trajectory from the time ``at``, and its pose.

        The motion within the image is uniform between the poses at the first and the last line.

        Args:
            base, readout, scan: as :meth:`between`.
            times, poses: of the trajectory: seconds, increasing, and as many poses of the base, world frame.
            at: seconds; the first line's time.

        Raises:
            ArgumentError: the trajectory does not last from the first line to the last.
        """
        seconds = numbers("times", times, (len(poses),))
        trajectory = Trajectory(tuple(poses), tuple(seconds.tolist()))
        start, end = (trajectory.at(time) for time in (at, at + readout))
        return cls.between(base, readout, start, end, scan)

    def _arguments(self) -> dict[str, Any]:
        """Return the arguments; of the base without its size, and without a centre in the middle."""
        middle = (self.base.center == (self.width / 2, self.height / 2)).all()
        implied = {"width", "height", *(("center", "cx", "cy") if middle else ())}
        base = {key: value for key, value in self.base.to_dict().items() if key not in implied}
        return {**super()._arguments(), "base": base}

    def lines(self, first: float, last: float) -> ReadOutLines:
        """Return the camera of the lines that are read between two fractions of the read-out, 0 to 1.

        ``last`` itself is excluded. Other pixels are not valid.
        """
        return ReadOutLines(first, last, **self._arguments())

    # -- rays -----------------------------------------------------------------------------------

    def _fraction(self, pixels: Array) -> Array:
        """Return the fraction of the read-out at which pixels (..., 2) are read."""
        part: Array = pixels[..., self._axis] / self._lines
        return 1 - part if self._backward else part

    def _unproject(self, pixels: Array) -> tuple[Array, Array, Mask | bool]:
        origins, directions, valid = self.base._unproject(pixels)
        if self._at_rest:
            return origins, directions, valid
        part = self._fraction(pixels)
        shifted = part[..., None] * self._travel
        if not self.base.central:
            shifted = shifted + self._rotate(np.broadcast_to(origins, directions.shape), part)
        return shifted, self._rotate(directions, part), valid

    def _rotate(self, vectors: Array, part: Array) -> Array:
        """Turn vectors (..., 3) of the moving camera into the first line's frame (Rodrigues' formula)."""
        if not self._turn:
            return vectors
        angle = (part * self._turn)[..., None]
        across = vectors @ self._cross.T
        rotated: Array = across @ self._cross.T
        rotated *= 2 * np.sin(angle / 2) ** 2
        rotated += vectors
        rotated += np.sin(angle) * across
        return rotated

    def viewpoints(self, count: int | None = None) -> Viewpoints:
        """Return one centre per line, or at most ``count`` for equal intervals of the read-out."""
        middle = np.arange(0.5, self._lines) / self._lines
        part = 1 - middle if self._backward else middle
        origins = part[:, None] * self._travel
        if not self.base.central:  # the mean of each line's
            own, _, _ = self.base._unproject(self.base.pixels())
            own = np.broadcast_to(own, (self.height, self.width, 3)).mean(axis=self._axis)
            origins = origins + self._rotate(own, part)
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
        if self._wraps:  # the seam is in the first column and in the last
            late = self._fraction(pixels) - part
            pixels[:, 0] += self.width * np.round(late) * (1 if self._backward else -1)
        return pixels.reshape(*points.shape[:-1], 2), seen.reshape(points.shape[:-1])

    def _project_at(self, points: Array, part: Array) -> tuple[Array, Mask]:
        """Project points (N, 3) with the base at fractions (N,) of the read-out."""
        offset = points - part[:, None] * self._travel
        nonzero = np.asarray(offset.any(axis=1))
        pixels, valid = self.base._project(self._rotate(np.where(nonzero[:, None], offset, 1.0), -part))
        return pixels, np.asarray(valid & nonzero & self._within_image(pixels)[1])

    def _late(self, points: Array, part: Array) -> Array:
        """Return how much later than ``part`` the lines of points are read, (N,); NaN if not seen."""
        late: Array = self._fraction(self._project_at(points, part)[0]) - part
        return late - np.round(late) if self._wraps else late

    def _search(self, points: Array, intervals: int) -> tuple[Array, Mask]:
        """Search intervals of the read-out in turn.

        Returns:
            the first fraction whose line sees points, (N,), NaN if there is none; and whether a line was
            within ``_NEAR`` intervals of the point at the end of an interval.
        """
        first = np.full(len(points), np.nan)
        before = self._late(points, np.zeros(len(points)))
        near = np.abs(before) <= _NEAR / intervals
        for k in range(intervals):
            low, high = k / intervals, (k + 1) / intervals
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
        """Return the fractions (N,) between two ends at which the lines of points are read.

        Regula falsi (Illinois) if the point is seen at both ends, else bisection towards the border: unlike
        those of ``monotone.increasing_root``, an end may be unknown.
        """
        sides = np.where(np.abs(late[0]) <= _CONVERGED, 0, 1)
        root = np.array(ends)[sides]
        left, right = (np.full(len(points), end) for end in ends)
        late_left, late_right = late[0].copy(), late[1].copy()
        pending = np.flatnonzero(~(np.minimum(np.abs(late_left), np.abs(late_right)) <= _CONVERGED))
        fixed = np.zeros(len(points))  # the end that the last step did not move: -1 left, 1 right
        for _ in range(_MOST_STEPS):
            if not len(pending):
                break
            a, b, fa, fb = left[pending], right[pending], late_left[pending], late_right[pending]
            secant = (a * fb - b * fa) / (fb - fa)
            at = np.where((secant > a) & (secant < b), secant, (a + b) / 2)
            value = self._late(points[pending], at)
            # Keep the half whose ends have unlike signs, or of whose ends one is not seen.
            first = np.where(np.isnan(fa) | np.isnan(fb), np.isnan(value) == np.isnan(fb), value * fa < 0)
            fixed_end = np.where(first, -1.0, 1.0)
            half = np.where(fixed[pending] == fixed_end, 0.5, 1.0)
            left[pending], right[pending] = np.where(first, a, at), np.where(first, at, b)
            late_left[pending] = np.where(first, fa * half, value)
            late_right[pending] = np.where(first, value, fb * half)
            root[pending], fixed[pending] = at, fixed_end
            done = (np.abs(value) <= _CONVERGED) | (right[pending] - left[pending] <= _CONVERGED / 8)
            pending = pending[~done]
        return root


class ReadOutLines(RollingShutter):
    """Some lines of a rolling-shutter camera, for a world that moves during the read-out.

    Args:
        first, last: fractions of the read-out; ``last`` itself is excluded.
        shutter: arguments of the whole camera.
    """

    name = "rolling-shutter-lines"

    def __init__(self, first: float, last: float, **shutter: Any) -> None:
        super().__init__(**shutter)
        self._first, self._last, self._shutter = first, last, shutter

    def _arguments(self) -> dict[str, Any]:
        return {"first": self._first, "last": self._last, **self._shutter}

    def _is_read(self, pixels: Array) -> Mask:
        part = self._fraction(pixels)
        return np.asarray((part >= self._first) & (part < self._last))

    def _unproject(self, pixels: Array) -> tuple[Array, Array, Mask | bool]:
        origins, directions, valid = super()._unproject(pixels)
        return origins, directions, valid & self._is_read(pixels)

    def _project(self, points: Array) -> tuple[Array, Mask]:
        pixels, valid = super()._project(points)
        return pixels, valid & self._is_read(pixels)


def _central(base: Camera | Mapping[str, Any], width: int, height: int) -> Camera:
    """Return the base camera with a size, from itself or its description; ArgumentError if not central."""
    with within("base"):
        description = base.to_dict() if isinstance(base, Camera) else base
        if not isinstance(description, Mapping) or "model" not in description:
            raise ArgumentError(f"expected a camera or a mapping with 'model' in it, got {shown(base)}")
        if not model(description["model"]).central and description["model"] != Lidar.name:
            raise ArgumentError(f"expected a central camera or a lidar, got {description['model']}")
        camera = from_dict({"width": width, "height": height, **description})
        if (camera.width, camera.height) != (width, height):
            got = f"{camera.width} x {camera.height}"
            raise ArgumentError(f"expected an image of {width} x {height} px, got {got}")
        return camera
