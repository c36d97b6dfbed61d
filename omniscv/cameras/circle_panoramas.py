"""Panoramas with optical centres off the axis: a camera on a turning arm, and the eyes of stereo pairs."""

from typing import ClassVar, Literal, get_args

import numpy as np

from omniscv.arguments import number, one_of
from omniscv.cameras.base import FARTHEST, Array, Mask, Viewpoints, viewpoints_by_line
from omniscv.cameras.panoramas import AngularGrid
from omniscv.cameras.registry import register

_ROUNDING = 8 * np.finfo(np.float64).eps  # relative error of a distance from the axis
_TANGENT = 4e-16  # rounding error of a sine near 1: its arcsine would be off by the root of this
Eye = Literal["left", "right"]


class CirclePanorama(AngularGrid):
    """An equirectangular image whose columns look from a circle of optical centres around the axis y.

    The column at azimuth theta looks outward, along ``n = (sin theta, 0, cos theta)``, from
    ``radial n + tangential (cos theta, 0, -sin theta)``; both in metres, set by the model.
    """

    central = False
    _radial = 0.0
    _tangential = 0.0

    def _unproject(self, pixels: Array) -> tuple[Array, Array, bool]:
        theta, phi = self._angles(pixels)
        outward = _outward(theta)
        directions = np.cos(phi)[..., None] * outward
        directions[..., 1] = -np.sin(phi)
        return self._origins(outward), directions, True

    def _origins(self, outward: Array) -> Array:
        """Return the optical centres (..., 3) of level outward directions (..., 3)."""
        origins = self._radial * outward
        if self._tangential:
            origins[..., 0] += self._tangential * outward[..., 2]
            origins[..., 2] -= self._tangential * outward[..., 0]
        return origins

    def _project(self, points: Array) -> tuple[Array, Mask]:
        x = points[..., 0]
        y = points[..., 1]
        z = points[..., 2]
        from_axis = np.hypot(x, z)
        theta = np.arctan2(x, z)
        reach = from_axis
        inner = abs(self._tangential)
        if inner:  # distance of the ray's line from the axis
            sine = np.clip(self._tangential / from_axis, -1, 1)
            sine = np.where(np.abs(sine) < 1 - _TANGENT, sine, np.sign(sine))
            reach = from_axis * np.sqrt((1 - sine) * (1 + sine))
            theta = theta - np.arcsin(sine)
            theta -= 2 * np.pi * np.round(theta / (2 * np.pi))  # from -pi to pi
        ahead = reach - self._radial
        # The first and last row look straight up and down, along the cylinder: tolerate rounding errors.
        seen = (ahead >= -_ROUNDING * self._radial) & (from_axis >= inner * (1 - _ROUNDING))
        ahead = np.maximum(ahead, 0.0)
        pixels = self._pixels_at(theta, np.arctan2(-y, ahead) / self._half[1])
        return pixels, seen & ((ahead > 0) | (y != 0))

    def viewpoints(self, count: int | None = None) -> Viewpoints:
        """Return one centre per column, or at most ``count`` for equal steps of azimuth.

        A shared centre is the mean of the columns' centres (least squares; exact for a single column;
        the axis for ``count=1``). Centres move by at most about ``radius * pi / count``.
        """
        theta = (2 * np.arange(0.5, self.width) / self.width - 1) * np.pi
        valid = np.ones((self.height, self.width), np.bool_)
        return viewpoints_by_line(self._origins(_outward(theta)), valid, 1, count)


@register
class NoncentralPanorama(CirclePanorama):
    """An equirectangular image whose columns look outward from a circle of optical centres.

    ``theta = (2u/W - 1) pi`` and ``phi = (1/2 - v/H) pi`` as in ``equirectangular``; the ray starts at
    ``R_c (sin theta, 0, cos theta)`` and points to ``(cos phi sin theta, -sin phi, cos phi cos theta)``.
    Parameter: ``radius`` R_c >= 0, metres; 0 equals ``equirectangular`` to the bit.
    Domain: every pixel. A point is seen in the column of its own azimuth, unless it lies inside the
    upright cylinder of the circle: rays look away from the axis and never enter it. On the cylinder it is
    seen in the first or last row; on the circle it has no direction.
    Source: OmniSCV, eq. of the semi-toroid (Menem and Pajdla 2004). The paper's pitch is the pose.
    """

    name = "noncentral-panorama"
    typical: ClassVar = {"radius": 1.0}

    def __init__(self, width: int, height: int, radius: float) -> None:
        super().__init__(width, height)
        self.radius = self._radial = number("radius", radius, least=0, most=FARTHEST)


@register
class OmnidirectionalStereo(CirclePanorama):
    """One eye of an omnidirectional stereo panorama (ODS): two eyes turn about the point between them.

    ``theta = (2u/W - 1) pi`` and ``phi = (1/2 - v/H) pi`` as in ``equirectangular``; the ray starts at
    ``s (b / 2) (cos theta, 0, -sin theta)``, s = -1 for the left eye and +1 for the right one.
    Parameters: ``interpupillary`` b >= 0, metres (people: about 0.064); ``eye``, "left" or "right".
    Domain: every pixel. A point at the distance rho from the axis is seen where rho >= b / 2, in the column
    of its own azimuth less ``s asin(b / (2 rho))``; no ray enters the circle.
    Source: Google, Rendering Omni-directional Stereo Content (2015); Peleg et al. 2001.
    """

    name = "ods"
    typical: ClassVar = {"interpupillary": 0.064}

    def __init__(self, width: int, height: int, interpupillary: float, eye: Eye = "left") -> None:
        super().__init__(width, height)
        self.interpupillary = number("interpupillary", interpupillary, least=0, most=FARTHEST)
        self.eye: Eye = one_of("eye", eye, get_args(Eye))
        self._tangential = side(self.eye) * self.interpupillary / 2


@register
class Vr180(AngularGrid):
    """One eye of a VR180 pair: the half sphere ahead, from an optical centre beside the middle of the head.

    ``theta = (u/W - 1/2) pi`` and ``phi = (1/2 - v/H) pi``, direction as in ``equirectangular``; all rays
    start at ``s (b / 2, 0, 0)``, s = -1 for the left eye and +1 for the right one.
    Parameters: ``interpupillary`` b >= 0, metres (people: about 0.064); ``eye``, "left" or "right".
    Domain: every pixel, and points with z > 0. The pose is that of the head: both eyes have the same one.
    Source: Google, VR180 video format (2018).
    """

    name = "vr180"
    typical_aspect = 1.0
    typical: ClassVar = {"interpupillary": 0.064}
    central = False
    _half = np.array([np.pi / 2, np.pi / 2])

    def __init__(self, width: int, height: int, interpupillary: float, eye: Eye = "left") -> None:
        super().__init__(width, height)
        self.interpupillary = number("interpupillary", interpupillary, least=0, most=FARTHEST)
        self.eye: Eye = one_of("eye", eye, ("left", "right"))
        self._center_c = np.array([side(self.eye) * self.interpupillary / 2, 0.0, 0.0])

    def _unproject(self, pixels: Array) -> tuple[Array, Array, bool]:
        directions, _ = self._directions(pixels)
        return np.zeros_like(directions) + self._center_c, directions, True

    def _project(self, points: Array) -> tuple[Array, Mask]:
        offset = points - self._center_c
        pixels, _ = super()._project(offset)
        return pixels, offset.any(axis=-1)

    def viewpoints(self, count: int | None = None) -> Viewpoints:
        """Return the one centre, the eye's."""
        return Viewpoints(self._center_c[None], super().viewpoints(count).index)


def side(eye: Eye) -> float:
    """Return the side on the camera's x axis: -1 for the left eye, +1 for the right one."""
    return 1.0 if eye == "right" else -1.0


def _outward(theta: Array) -> Array:
    """Return the level unit vectors (..., 3) at azimuths."""
    outward = np.zeros((*theta.shape, 3))
    outward[..., 0] = np.sin(theta)
    outward[..., 2] = np.cos(theta)
    return outward
