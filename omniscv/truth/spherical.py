"""Boxes on the sphere of directions (BFoV), upright and rotated.

A box has a centre and two angles. In its tangent frame (x right, y down, z to the centre) it is the region
``|atan(x/z)| <= fov_h/2`` and ``|atan(y/z)| <= fov_v/2``, z > 0, inside four great circles. Longitude is
positive to the right, latitude up; ``rot`` turns the frame clockwise in the image. An object that is too wide
for that has the kind ``lonlat``: ranges of longitude and latitude.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal, Self

import numpy as np

from omniscv.geometry import Array

Kind = Literal["perspective", "lonlat"]
_CORNERS = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])


@dataclass(frozen=True)
class SphericalBox:
    """A box on the sphere; all angles in degrees.

    Attributes:
        lon, lat: of the centre: -180 to 180, -90 to 90.
        fov_h, fov_v: across and down.
        rot: clockwise, -90 to 90.
        kind: the meaning of the angles.
    """

    lon: float
    lat: float
    fov_h: float
    fov_v: float
    rot: float = 0.0
    kind: Kind = "perspective"

    @classmethod
    def of(cls, box: SphericalBox | Mapping[str, Any]) -> Self:
        """Return the box of a record, or the box itself."""
        return cls(**(asdict(box) if isinstance(box, SphericalBox) else box))

    def to_dict(self) -> dict[str, Any]:
        """Return the record: plain values."""
        return asdict(self)

    @property
    def R_c_b(self) -> Array:
        """(3, 3) from the box's tangent frame to the camera's; columns right, down, forward."""
        angles = np.radians([self.lon, self.lat, self.rot])
        (sl, sp, sr), (cl, cp, cr) = np.sin(angles), np.cos(angles)
        right, down, forward = np.array([[cl, 0, -sl], [sp * sl, cp, sp * cl], [cp * sl, -sp, cp * cl]])
        return np.stack([cr * right + sr * down, cr * down - sr * right, forward], axis=-1)

    @property
    def area(self) -> float:
        """Steradians."""
        a, b = np.radians([self.fov_h, self.fov_v])
        if self.kind == "lonlat":
            low, high = np.radians([self.lat - self.fov_v / 2, self.lat + self.fov_v / 2])
            return float(a * (np.sin(high) - np.sin(low)))
        return float(4 * np.arcsin(np.sin(a / 2) * np.sin(b / 2)))

    def contains(self, directions: Array) -> Array:
        """Return (...) the least angle of directions (..., 3) to the four sides, degrees; below 0 outside."""
        if self.kind == "lonlat":
            lon, lat = lon_lat(directions)
            across = np.abs((np.degrees(lon) - self.lon + 180) % 360 - 180)
            down = np.abs(np.degrees(lat) - self.lat)
        else:
            x, y, z = np.moveaxis(directions @ self.R_c_b, -1, 0)
            across, down = np.degrees(np.abs(np.arctan2(x, z))), np.degrees(np.abs(np.arctan2(y, z)))
        return np.asarray(np.minimum(self.fov_h / 2 - across, self.fov_v / 2 - down))

    def corners(self) -> Array:
        """Return (4, 3) unit directions, clockwise from the upper left."""
        half = np.tan(np.radians([self.fov_h, self.fov_v]) / 2)
        rays = np.column_stack([_CORNERS * half, np.ones(4)]) @ self.R_c_b.T
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def lon_lat(directions: Array) -> tuple[Array, Array]:
    """Return longitude and latitude, radians, of directions (..., 3) in the camera frame."""
    x, y, z = np.moveaxis(directions, -1, 0)
    return np.arctan2(x, z), np.arctan2(-y, np.hypot(x, z))
