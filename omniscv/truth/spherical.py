"""Boxes on the sphere of directions (BFoV), upright and rotated, their areas and overlaps.

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

from omniscv.errors import ArgumentError
from omniscv.geometry import Array

Kind = Literal["perspective", "lonlat"]
_CORNERS = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
_FLAT = 1e-12  # rounding error of products of unit vectors


@dataclass(frozen=True)
class SphericalBox:
    """A box on the sphere; all angles in degrees.

    Attributes:
        lon: of the centre, -180 to 180.
        lat: of the centre, -90 to 90.
        fov_h: across.
        fov_v: down.
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
        (sl, sp, sr) = np.sin(angles)
        (cl, cp, cr) = np.cos(angles)
        right, down, forward = np.array([[cl, 0, -sl], [sp * sl, cp, sp * cl], [cp * sl, -sp, cp * cl]])
        return np.stack([cr * right + sr * down, cr * down - sr * right, forward], axis=-1)

    @property
    def area(self) -> float:
        """The solid angle of the box, steradians.

        Between great circles it is ``4 asin(sin(fov_h / 2) sin(fov_v / 2))``; of ranges of longitude and
        latitude, ``fov_h (sin(highest latitude) - sin(lowest latitude))``.
        """
        width, height = np.radians([self.fov_h, self.fov_v])
        if self.kind == "lonlat":
            lowest, highest = np.radians([self.lat - self.fov_v / 2, self.lat + self.fov_v / 2])
            return float(width * (np.sin(highest) - np.sin(lowest)))
        return float(4 * np.arcsin(np.sin(width / 2) * np.sin(height / 2)))

    def contains(self, directions: Array) -> Array:
        """Return (...) the least angle of directions (..., 3) to the four sides, degrees; below 0 outside."""
        if self.kind == "lonlat":
            lon, lat = lon_lat(directions)
            across = np.abs((np.degrees(lon) - self.lon + 180) % 360 - 180)
            down = np.abs(np.degrees(lat) - self.lat)
        else:
            x, y, z = np.moveaxis(directions @ self.R_c_b, -1, 0)
            across = np.degrees(np.abs(np.arctan2(x, z)))
            down = np.degrees(np.abs(np.arctan2(y, z)))
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


def spherical_iou(b1: SphericalBox | Mapping[str, Any], b2: SphericalBox | Mapping[str, Any]) -> float:
    """Return the exact intersection over union of two boxes, ``b1`` and ``b2``.

    The intersection is the spherical polygon inside eight great circles.

    Raises:
        ArgumentError: a box of kind ``lonlat``, or a fov of 180 degrees or more.
    """
    first = _perspective("b1", b1)
    second = _perspective("b2", b2)
    both = _polygon_area(_clipped(first.corners(), _sides(second)))
    return both / (first.area + second.area - both)


def fov_iou(b1: SphericalBox | Mapping[str, Any], b2: SphericalBox | Mapping[str, Any]) -> float:
    """Return FoV-IoU of two boxes, ``b1`` and ``b2``.

    That is the intersection over union of their angles as if they lay in one plane. It is exact side by side
    at the horizon, approximate elsewhere, and ignores ``rot``.

    Source: Cao et al. 2022, Field-of-View IoU for object detection in 360 degree images.

    Raises:
        ArgumentError: as :func:`spherical_iou`.
    """
    first = _perspective("b1", b1)
    second = _perspective("b2", b2)
    apart = (second.lon - first.lon + 180) % 360 - 180
    shift = apart * np.cos(np.radians(first.lat + second.lat) / 2)
    right = min(first.fov_h / 2, shift + second.fov_h / 2)
    left = max(-first.fov_h / 2, shift - second.fov_h / 2)
    upper = min(first.lat + first.fov_v / 2, second.lat + second.fov_v / 2)
    lower = max(first.lat - first.fov_v / 2, second.lat - second.fov_v / 2)
    both = max(0.0, right - left) * max(0.0, upper - lower)
    return float(both / (first.fov_h * first.fov_v + second.fov_h * second.fov_v - both))


def _perspective(name: str, box: SphericalBox | Mapping[str, Any]) -> SphericalBox:
    checked = SphericalBox.of(box)
    if checked.kind != "perspective" or not (0 < checked.fov_h < 180 and 0 < checked.fov_v < 180):
        expected = "expected a box of kind perspective with angles between 0 and 180 degrees"
        raise ArgumentError(f"{name}: {expected}, got {checked}")
    return checked


def _sides(box: SphericalBox) -> Array:
    """(4, 3) inward normals of the great circles of a box's sides."""
    corners = box.corners()
    normals = np.cross(corners, np.roll(corners, -1, axis=0))
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))


def _clipped(polygon: Array, normals: Array) -> Array:
    """Return the part (N, 3) of a convex spherical polygon inside great circles (Sutherland and Hodgman)."""
    for normal in normals:
        inside = polygon @ normal
        clipped = []
        for index, corner in enumerate(polygon):
            before = inside[index - 1]
            here = inside[index]
            if (before > _FLAT and here < -_FLAT) or (before < -_FLAT and here > _FLAT):
                crossing = polygon[index - 1] * abs(here) + corner * abs(before)
                clipped.append(crossing / np.linalg.norm(crossing))
            if here >= -_FLAT:
                clipped.append(corner)
        polygon = np.array(clipped).reshape(-1, 3)
    return polygon


def _polygon_area(polygon: Array) -> float:
    """Steradians of a convex spherical polygon (N, 3); 0 for fewer than three corners."""
    if len(polygon) < 3:
        return 0.0
    apart = np.linalg.norm(polygon - np.roll(polygon, 1, axis=0), axis=1)
    polygon = polygon[apart > _FLAT]
    if len(polygon) < 3:
        return 0.0
    first = polygon[0]
    second = polygon[1:-1]
    third = polygon[2:]
    # Van Oosterom and Strackee 1983: tan(area / 2) of triangles, exact for small ones.
    volume = np.einsum("j,ij->i", first, np.cross(second, third))
    edges = 1 + second @ first + third @ first + (second * third).sum(axis=1)
    return float(2 * np.arctan2(np.abs(volume), edges).sum())
