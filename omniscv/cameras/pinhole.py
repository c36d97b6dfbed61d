"""The perspective camera, with OpenCV's distortion."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from omniscv.arguments import number, numbers, shown, whole_number
from omniscv.cameras.base import LARGEST_PX, Array, refuse_focal_and_fov, sin_cos_of_half
from omniscv.cameras.distortion import Distortion
from omniscv.cameras.lens_parameters import Parameters
from omniscv.cameras.radial import FocalLens, Meridian
from omniscv.cameras.registry import register
from omniscv.errors import ArgumentError

_COUNTS = (4, 5, 8, 12)


@register
class Pinhole(FocalLens):
    """A perspective camera: ``x = X / Z``, ``u = cx + fx (x' + skew y')``, ``v = cy + fy y'``; (x', y') is
    (x, y) with OpenCV's rational and tangential distortion and its thin prism, see
    :class:`omniscv.cameras.distortion.Distortion`.

    Parameters: ``focal`` px and ``center``, or ``fov_deg``, the angle from the left to the right edge of an
    image whose centre is in the middle, ``focal = (W / 2) / tan(fov / 2)``, 90 if neither is given; or
    ``fx``, ``fy``, ``cx``, ``cy`` px, ``skew``, and ``fov_deg`` as a limit, the full angle of a cone.
    ``distortion`` = 4, 5, 8 or 12 of (k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4).
    Domain: every pixel; Z > 0; 0 < fov_deg < 180; the disc of (x, y) within which the distortion turns back
    nowhere. Source: any textbook; OpenCV, calib3d; pixel centres at +0.5.
    """

    name = "pinhole"
    lens = Parameters.of("fx fy | cx cy | skew distortion=k1,k2,p1,p2,k3,k4,k5,k6,s1,s2,s3,s4")
    _theta_end = np.pi / 2

    def __init__(
        self,
        width: int,
        height: int,
        focal: float | None = None,
        fov_deg: float | None = None,
        center: ArrayLike | None = None,
        fx: float | None = None,
        fy: float | None = None,
        cx: float | None = None,
        cy: float | None = None,
        skew: float = 0.0,
        distortion: ArrayLike = (0.0, 0.0, 0.0, 0.0),
    ) -> None:
        refuse_focal_and_fov(focal, fov_deg)
        if center is not None:
            if cx is not None or cy is not None:
                raise ArgumentError(f"center: expected it or cx and cy, got both ({shown(center)} and more)")
            cx, cy = numbers("center", center, (2,)).tolist()
        self.distortion = _twelve_terms(distortion)
        if self.distortion.any():
            self._distortion = Distortion(self.distortion)
        fx, fy, limit_deg = self._focal_lengths(width, focal, fov_deg, fx, fy)
        super().__init__(width, height, fx, fy, cx, cy, skew, limit_deg)
        self.focal = self.fx if self.fx == self.fy else None

    def _focal_lengths(
        self, width: int, focal: float | None, fov_deg: float | None, fx: float | None, fy: float | None
    ) -> tuple[float, float, float | None]:
        """Return fx, fy, and the limit of the field of view, from one of the two forms."""
        if fx is None and fy is None:
            if focal is None:
                fov_deg = number("fov_deg", 90.0 if fov_deg is None else fov_deg, above=0, below=180)
                across, along = sin_cos_of_half(fov_deg)
                focal = whole_number("width", width, "pixels", most=LARGEST_PX) / 2 * float(along / across)
            focal = number("focal", focal, above=0)
            return focal, focal, None
        if fx is None or fy is None or focal is not None:
            lengths = []
            for key, value in {"focal": focal, "fx": fx, "fy": fy}.items():
                if value is not None:
                    lengths.append(f"{key} = {shown(value)}")
            raise ArgumentError(f"focal: expected focal, or fx and fy, got {', '.join(lengths)}")
        return fx, fy, fov_deg

    def _arguments(self) -> dict[str, Any]:
        arguments = super()._arguments()
        is_simple = self.focal is not None and not self.skew and self._distortion is None and not self.fov_deg
        redundant = ("fx", "fy", "cx", "cy", "skew", "distortion") if is_simple else ("focal", "center")
        for key in redundant:
            arguments.pop(key, None)
        return arguments

    def _meridian(self, r: Array) -> Meridian:
        distance = np.hypot(r, 1.0)
        return Meridian(r / distance, 1 / distance)

    def _radius(self, across: Array, along: Array) -> Array:
        return np.where(along > 0, across / along, np.nan)


def _twelve_terms(distortion: ArrayLike) -> Array:
    """Return OpenCV's twelve coefficients of 4, 5, 8 or 12; those missing are 0."""
    terms = numbers("distortion", distortion, (None,))
    if len(terms) not in _COUNTS:
        wanted = "4, 5, 8 or 12 numbers (k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4)"
        raise ArgumentError(f"distortion: expected {wanted}, got {len(terms)}: {shown(distortion)}")
    return np.append(terms, np.zeros(12 - len(terms)))
