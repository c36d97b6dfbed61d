"""Cameras with parallel rays: in the direction of travel (push-broom), or all of them (orthographic)."""

from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv.arguments import number, numbers, whole_number
from omniscv.cameras.base import (
    FARTHEST,
    Array,
    Camera,
    Mask,
    Viewpoints,
    refuse_focal_and_fov,
    sin_cos_of_half,
    viewpoints_by_line,
)
from omniscv.cameras.registry import register
from omniscv.errors import ArgumentError

_IN_PLANE = 1e-8  # radians from the plane of a line that rests: it sees a point


@register
class PushBroom(Camera):
    """A line camera that travels sideways: every column has its own optical centre and looks straight ahead.

    The ray of (u, v) starts at ``(u/W - 1/2) T`` and points to ``(0, (v - H/2) / f, 1)``, normalised.
    Parameters: ``travel`` T = (x, y, z), metres, from the left edge of the image to its right one, x > 0; or
    ``readout`` > 0, seconds from edge to edge, of a job that moves the camera along its path meanwhile, as it
    does a rolling shutter (T = 0 at rest; its time is the left edge's);
    ``focal`` f of the columns, px, or ``fov_deg``, the angle from the top to the bottom edge, 0 < fov_deg <
    180; 90 if neither is given.
    Domain: every pixel; points ahead of the optical centre with their x.
    Source: Gupta and Hartley 1997, Linear pushbroom cameras.
    """

    name = "push-broom"
    typical: ClassVar = {"travel": (2.0, 0.0, 0.0)}
    central = False

    def __init__(
        self,
        width: int,
        height: int,
        travel: ArrayLike = (0.0, 0.0, 0.0),
        focal: float | None = None,
        fov_deg: float | None = None,
        readout: float = 0.0,
    ) -> None:
        super().__init__(width, height)
        self.travel = numbers("travel", travel, (3,))
        self.readout = number("readout", readout, least=0)
        if self.readout and self.travel.any():
            wanted = "expected it or a readout, of a camera on a path"
            raise ArgumentError(f"travel: {wanted}, got both ({self.travel.tolist()})")
        if not (self.travel[0] > 0 or self.readout):
            raise ArgumentError(f"travel: expected x > 0, to the right, got {self.travel.tolist()}")
        number("travel", float(np.abs(self.travel).max()), most=FARTHEST)
        refuse_focal_and_fov(focal, fov_deg)
        if focal is not None:
            self.focal = number("focal", focal, above=0)
        else:
            fov = number("fov_deg", 90.0 if fov_deg is None else fov_deg, above=0, below=180)
            across, along = sin_cos_of_half(fov)
            self.focal = self.height / 2 * float(along / across)

    def _unproject(self, pixels: Array) -> tuple[Array, Array, Mask]:
        down = (pixels[..., 1] - self.height / 2) / self.focal
        level = 1 / np.hypot(1.0, down)
        directions = np.stack([np.zeros_like(down), down * level, level], axis=-1)
        return self._origins(pixels[..., 0]), directions, np.isfinite(down)

    def _origins(self, u: Array) -> Array:
        """Return the optical centres (..., 3) of columns at u (...), px."""
        return (u / self.width - 0.5)[..., None] * self.travel

    def _project(self, points: Array) -> tuple[Array, Mask]:
        x = points[..., 0]
        part = np.zeros_like(x) if self.readout else x / self.travel[0]  # at rest all columns see one plane
        ahead = points - part[..., None] * self.travel
        z = ahead[..., 2]
        u = (part + 0.5) * self.width
        v = self.height / 2 + self.focal * ahead[..., 1] / z
        seen = z > 0
        if self.readout:
            seen = seen & (np.abs(x) <= _IN_PLANE * z)
        return np.stack([u, v], axis=-1), seen

    def viewpoints(self, count: int | None = None) -> Viewpoints:
        """Return one centre per column, or at most ``count`` for equal parts of the travel."""
        return viewpoints_by_line(self._origins(np.arange(0.5, self.width)), self.valid(), 1, count)


@register
class Orthographic(Camera):
    """A camera of parallel rays: every pixel looks straight ahead from its own optical centre, as in a plan.

    The ray of (u, v) starts at ``(u - u_0, v - v_0, 0) / s``, ``s = W / w``, and points to ``(0, 0, 1)``.
    Parameter: ``width_m`` w > 0, metres that the image is wide; pixels are square.
    Domain: every pixel; points with z > 0.
    Source: any textbook. Strategy ``auto`` composes it from depth at a few viewpoints.
    """

    name = "orthographic"
    typical: ClassVar = {"width_m": 2.0}
    typical_pitch_deg = -90.0
    central = False

    def __init__(self, width: int, height: int, width_m: float, center: ArrayLike | None = None) -> None:
        super().__init__(width, height, center)
        self.width_m = number("width_m", width_m, above=0, most=FARTHEST)
        self._pixel_m = self.width_m / self.width

    def _unproject(self, pixels: Array) -> tuple[Array, Array, bool]:
        origins, directions = np.zeros((2, *pixels.shape[:-1], 3))
        origins[..., :2] = (pixels - self.center) * self._pixel_m
        directions[..., 2] = 1
        return origins, directions, True

    def _project(self, points: Array) -> tuple[Array, Mask]:
        return self.center + points[..., :2] / self._pixel_m, points[..., 2] > 0

    def viewpoints(self, count: int | None = None) -> Viewpoints:
        """Return one centre per pixel, or at most ``count`` in the middles of blocks of pixels.

        Centres are in Morton order, which keeps neighbours close.
        """
        most = self.width * self.height
        count = min(whole_number("count", most if count is None else count, "viewpoints"), most)
        across = np.sqrt(count * self.width / self.height)
        across = int(np.clip(across, max(1, count / self.height), self.width))
        down = min(count // across, self.height)
        column = np.arange(self.width) * across // self.width
        row = np.arange(self.height) * down // self.height
        x, y = np.meshgrid(np.arange(across), np.arange(down))
        morton = np.zeros_like(x)  # the bits of both numbers interleaved
        for bit in range(max(across, down).bit_length()):
            morton |= (x >> bit & 1) << 2 * bit | (y >> bit & 1) << 2 * bit + 1
        order = np.argsort(morton, axis=None)
        rank = np.empty(len(order), np.int32)
        rank[order] = np.arange(len(order))
        middles = np.meshgrid(_middles(column), _middles(row))
        centers, _, _ = self._unproject(np.stack(middles, axis=-1))
        return Viewpoints(centers.reshape(-1, 3)[order], rank.reshape(down, across)[np.ix_(row, column)])


def _middles(block: NDArray[np.int64]) -> Array:
    """Return the mean place of each block's pixels along an axis, px, by the block (N,) of each pixel."""
    return np.asarray(np.bincount(block, np.arange(0.5, len(block))) / np.bincount(block))
