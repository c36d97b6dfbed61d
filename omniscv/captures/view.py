"""Single perspective pictures: what is asked for, and what came."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose

MODES = ("lit", "object_mask", "depth", "normal")

_POSE_DECIMALS = 7
"""Views closer than this (metres, matrix entries) are the same view: a tenth of a micrometre, and
1e-7 rad, a ten-thousandth of a pixel at f = 1024; servers print three decimals of a centimetre."""


@dataclass(frozen=True, eq=False)
class View:
    """One perspective picture: a pose, a horizontal field of view, a size.

    The picture's frame is the pose's camera frame (x right, y down, z forward); a point is seen at
    ``u = W/2 + f x/z``, ``v = H/2 + f y/z`` with ``f = (W/2) / tan(fov/2)``, pixel centres at +0.5.

    Args:
        pose: optical centre and orientation.
        fov_deg: horizontal field of view, 0 < fov < 180.
        width, height: px; width >= height, because engines turn the field of view for tall images.

    Raises:
        ArgumentError: a field of view or size outside its domain.
    """

    pose: Pose
    fov_deg: float
    width: int
    height: int

    def __post_init__(self) -> None:
        if not 0 < self.fov_deg < 180:
            raise ArgumentError(f"fov_deg: expected 0 < fov_deg < 180, got {self.fov_deg!r}")
        if not 1 <= self.height <= self.width:
            raise ArgumentError(f"size: expected width >= height >= 1, got {self.width} x {self.height}")

    @property
    def focal_px(self) -> float:
        """Focal length in px, the same across and down."""
        return float(self.width / 2 / np.tan(np.radians(self.fov_deg) / 2))

    def project(self, points_w: ArrayLike) -> Array:
        """(..., 3) world points to (..., 3): u, v in px, z planar depth in m (z <= 0: behind)."""
        p_c = self.pose.to_camera(points_w)
        z = p_c[..., 2:]
        with np.errstate(divide="ignore", invalid="ignore"):
            uv = p_c[..., :2] / z * self.focal_px + (self.width / 2, self.height / 2)
        return np.concatenate([uv, z], axis=-1)

    def ray_lengths(self) -> Array:
        """(H, W): length of the ray to each pixel's centre per metre of planar depth, ``|(x/z, y/z, 1)|``."""
        x = (np.arange(self.width) + 0.5 - self.width / 2) / self.focal_px
        y = (np.arange(self.height) + 0.5 - self.height / 2) / self.focal_px
        result: Array = np.sqrt(1 + x[None, :] ** 2 + y[:, None] ** 2)
        return result

    def key(self) -> tuple[Any, ...]:
        """What makes two views the same: equal sizes, pose and field of view to a server's resolution."""
        numbers = np.concatenate([self.pose.position, self.pose.rotation.ravel(), [self.fov_deg]])
        rounded = np.round(numbers, _POSE_DECIMALS) + 0.0  # + 0.0: no negative zero
        return (self.width, self.height, *rounded.tolist())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, View) and self.key() == other.key()

    def __hash__(self) -> int:
        return hash(self.key())


@dataclass(frozen=True)
class Request:
    """A view in a mode: one of lit, object_mask, depth, normal."""

    view: View
    mode: str

    def __post_init__(self) -> None:
        if self.mode not in MODES:
            raise ArgumentError(f"mode: expected one of {', '.join(MODES)}; got {self.mode!r}")


@dataclass(frozen=True, eq=False)
class Capture:
    """A request, answered.

    Attributes:
        request: what was asked.
        view: what was captured. It differs from ``request.view`` where a server cannot do what was
            asked (dialect 0.3.10 stops at 89.9 degrees of pitch): maps are made for this view.
        pixels: (H, W, 3) uint8 RGB for lit and object_mask; (H, W) float32 planar metres, +inf for no
            surface, for depth; (H, W, 3) float32 unit vectors in the world frame, 0 where unknown, for
            normal. Read-only.
        payload: the bytes as they came over the wire.
        encoding: how ``payload`` becomes ``pixels``: see ``omniscv.captures.decode``.
        provenance: where it came from (server, dialect, command, time): plain JSON values.
    """

    request: Request
    view: View
    pixels: NDArray[Any]
    payload: bytes
    encoding: str
    provenance: dict[str, Any] = field(default_factory=dict)

    @property
    def mode(self) -> str:
        """The request's mode."""
        return self.request.mode
