"""OpenCV's distortion of the plane: rational and tangential terms, and a thin prism."""

from typing import Any

import numpy as np

from omniscv.cameras.base import Array
from omniscv.cameras.monotone import first_positive_root

_TABLE = 512  # cells of the table of undistorted radii


class Distortion:
    """``x'' = x c + 2 p1 x y + p2 (r2 + 2 x^2) + s1 r2 + s2 r2^2``,
    ``y'' = y c + p1 (r2 + 2 y^2) + 2 p2 x y + s3 r2 + s4 r2^2``, with ``r2 = x^2 + y^2`` and
    ``c = (1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3)``.

    It is inverted in the largest disc about (0, 0) in which the symmetric part of its derivative is positive
    definite: there it is one to one. Without p and s the disc ends where r c turns back.

    Args:
        coefficients: (12,) k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4: OpenCV's order.
    """

    def __init__(self, coefficients: Array) -> None:
        k1, k2, p1, p2, k3, k4, k5, k6, *prism = coefficients.tolist()
        self._numerator, self._denominator = np.array([1, k1, k2, k3]), np.array([1, k4, k5, k6])
        self._radial_only = not any((p1, p2, *prism))
        self.coefficients = (k1, k2, p1, p2, k3, k4, k5, k6, *prism)
        self.solver: tuple[Any, ...] = ()

    def apply(self, plane: Array) -> Array:
        """Return the distorted coordinates (..., 2) of undistorted ones (..., 2)."""
        from omniscv.cameras import camera_kernels  # slow to load

        flat = np.ascontiguousarray(plane.reshape(-1, 2))
        return np.asarray(camera_kernels.distort_all(flat, self.coefficients).reshape(plane.shape))

    def set_domain(self, end: float, beyond: float, rounding: float) -> float:
        """Return the radius of the disc in which the distortion can be inverted, and prepare the solver.

        Args:
            end: the last radius of the model.
            beyond: a distorted radius beyond the image's corners.
            rounding: the rounding error of distorted coordinates.
        """
        from omniscv.cameras import camera_kernels  # slow to load

        turn = self._first_turn()
        if np.isnan(turn):
            return np.nan
        end = self._radius_reaching(min(end, turn), beyond)
        if not self._radial_only:
            end = float(camera_kernels.first_turn(self.coefficients, end))
        radii = np.linspace(0.0, end, _TABLE + 1)
        reached = self._radial(radii)
        last = float(reached[-1])
        table = np.interp(np.linspace(0.0, last, _TABLE + 1), reached, radii)
        table.flags.writeable = False
        farthest = float(camera_kernels.farthest_of_rim(self.coefficients, end))
        self.solver = (self.coefficients, end, last, farthest, 4 * rounding, table)
        return end if np.isfinite(table).all() and last > 0 else np.nan

    def _radial(self, r: Array) -> Array:
        """Return r c of radii (...)."""
        powers = (r * r)[..., None] ** np.arange(4)
        return np.asarray(r * (powers @ self._numerator) / (powers @ self._denominator))

    def _first_turn(self) -> float:
        """Return the radius where r c turns back or has its first pole; infinity if there is none."""
        N, D, twice = self._numerator, self._denominator, 2 * np.arange(4)
        # The slope by r of r N / D times D^2, with s = r^2: N D + 2 s (N' D - N D').
        slope = np.convolve(N, D) + np.convolve(twice * N, D) - np.convolve(N, twice * D)
        turn, pole = first_positive_root(slope), first_positive_root(D)
        return float(np.sqrt(np.minimum(turn, pole)))

    def _radius_reaching(self, end: float, beyond: float) -> float:
        """Return a radius up to ``end`` where r c is 0.9 to 1 times ``beyond``; ``end`` if r c is less."""

        def within(r: float) -> bool:  # negative beyond a pole
            return bool(0 <= self._radial(np.array(r)) <= beyond)

        if np.isfinite(end) and within(end):
            return end
        low, high = 0.0, min(end, beyond)
        while within(high) and high < min(end, 1e100):
            low, high = high, min(2 * high, end)
        for _ in range(100):
            if self._radial(np.array(low)) >= 0.9 * beyond:
                break
            middle = (low + high) / 2
            low, high = (middle, high) if within(middle) else (low, middle)
        return low
