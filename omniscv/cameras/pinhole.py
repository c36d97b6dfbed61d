"""The perspective camera, with OpenCV's distortion."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from omniscv.arguments import number, numbers, shown
from omniscv.cameras.arrays import refuse_focal_and_fov, sin_cos_of_half
from omniscv.cameras.base import Array
from omniscv.cameras.distortion import Distortion
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
        super().__init__(width, height, center)
        refuse_focal_and_fov(focal, fov_deg)
        if center is not None and (cx is not None or cy is not None):
            raise ArgumentError(f"center: expected center or cx and cy, got both ({shown(center)} and more)")
        if fx is None and fy is None:
            fx = fy = self._one_focal(focal, fov_deg)
            fov_deg = None
        elif fx is None or fy is None or focal is not None:
            got = ", ".join(
                f"{k} = {shown(v)}" for k, v in (("focal", focal), ("fx", fx), ("fy", fy)) if v is not None
            )
            raise ArgumentError(f"focal: expected focal, or fx and fy, got {got}")
        if center is not None:
            cx, cy = self.center.tolist()
        self.distortion = _all_twelve(distortion)
        if self.distortion.any():
            self._distortion = Distortion(self.distortion)
        self._see_through_focal(fx, fy, cx, cy, skew, fov_deg)
        self.focal = self.fx if self.fx == self.fy else None

    def _one_focal(self, focal: float | None, fov_deg: float | None) -> float:
        if focal is not None:
            return number("focal", focal, above=0)
        across, along = sin_cos_of_half(
            number("fov_deg", 90.0 if fov_deg is None else fov_deg, above=0, below=180)
        )
        return self.width / 2 * float(along / across)

    def _arguments(self) -> dict[str, Any]:
        simple = self.focal is not None and not self.skew and self._distortion is None and not self.fov_deg
        left_out = {"fx", "fy", "cx", "cy", "skew", "distortion"} if simple else {"focal", "center"}
        return {key: value for key, value in super()._arguments().items() if key not in left_out}

    def _meridian(self, r: Array) -> Meridian:
        distance = np.hypot(r, 1.0)
        return Meridian(r / distance, 1 / distance)

    def _radius(self, across: Array, along: Array) -> Array:
        return np.where(along > 0, across / along, np.nan)


def _all_twelve(distortion: ArrayLike) -> Array:
    given = numbers("distortion", distortion, (None,))
    if len(given) not in _COUNTS:
        raise ArgumentError(
            "distortion: expected 4, 5, 8 or 12 numbers (k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4), "
            f"got {len(given)}: {shown(distortion)}"
        )
    return np.append(given, np.zeros(12 - len(given)))
