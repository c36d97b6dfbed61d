"""Motions of objects: translation, and rotation about the vertical, as closed formulas of time."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Triple = tuple[float, ...]


class Motion(Protocol):
    """A function of time, in seconds."""

    def at(self, time_s: float) -> tuple[Array, float]:
        """Return the offset (3,) in metres, and the turn to the left in degrees."""
        ...


@dataclass(frozen=True)
class Steady:
    """A constant velocity, metres a second, and a constant turn, degrees a second."""

    velocity: Triple
    turn_deg: float

    def at(self, time_s: float) -> tuple[Array, float]:
        """As :meth:`Motion.at`: in proportion to the time."""
        return np.multiply(time_s, self.velocity), time_s * self.turn_deg


@dataclass(frozen=True)
class Swing:
    """A sinusoid of time: its amplitudes, metres and degrees, and its period."""

    by: Triple
    turn_deg: float
    period_s: float

    def at(self, time_s: float) -> tuple[Array, float]:
        """As :meth:`Motion.at`: times the sine of ``2 pi time_s / period_s``."""
        share = math.sin(2 * math.pi * math.remainder(time_s / self.period_s, 1.0))
        return np.multiply(share, self.by), share * self.turn_deg


@dataclass(frozen=True)
class Waypoints:
    """Straight lines between points (time, x, y, z, turn in degrees), in the order of their times.

    The object rests at the first point before, and at the last one after; with ``repeat``, it starts again.
    """

    points: tuple[Triple, ...]
    repeat: bool

    def at(self, time_s: float) -> tuple[Array, float]:
        """As :meth:`Motion.at`: linear in the time between two points."""
        times, *columns = np.array(self.points).T
        if self.repeat:
            time_s = times[0] + (time_s - times[0]) % (times[-1] - times[0])
        *offset, turn_deg = (float(np.interp(time_s, times, column)) for column in columns)
        return np.array(offset), turn_deg


def turned(turn_deg: float) -> Array:
    """Return (3, 3) the rotation about the vertical by degrees to the left."""
    angle = math.radians(math.remainder(turn_deg, 360.0))
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
