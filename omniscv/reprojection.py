"""Pictures of one central camera as another one would have taken them, from the same place.

No depth is needed: rays that start at one point meet the same things, whatever camera they belong to. A pixel
of the new camera looks along its ray, and takes what the old picture shows there; where the old one does not
look, it is 0.
"""

import json
import math
from functools import lru_cache
from typing import Any, Literal, cast

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv import light
from omniscv.arguments import one_of, shown
from omniscv.cameras import Camera
from omniscv.cameras.registry import from_dict
from omniscv.depth.interpolation import LARGEST_PX
from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.geometry.arrays import Floats, Ints, Mask
from omniscv.geometry.pose import rotation_reader
from omniscv.parallel import row_blocks
from omniscv.planning.densities import pixels_per_radian

Filter = Literal["area", "bilinear", "nearest"]
FILTERS = ("area", "bilinear", "nearest")

_MOST_RAYS = 8
"""Rays of a pixel along each axis, at most, whose colours ``area`` averages."""
_APART_PX = 6.0
"""Neighbours in a picture whose rays are farther apart are none on the sphere, as where two faces of a cube
meet in the picture: nothing is blended there."""
_BLENDED = ("uint8", "uint16", "int16", "float32", "float64")
"""Types of pixels that cv2.remap interpolates."""
_KEPT = 4  # maps that :func:`reproject` keeps


def reproject(
    image: ArrayLike,
    *,
    from_: Camera,
    to: Camera,
    rotation: ArrayLike | None = None,
    filter: Filter = "area",
    transfer: str = "unknown",
) -> NDArray[Any]:
    """Return a picture as another camera at the same place would have taken it.

    The map between both is kept, so that further pictures of the same cameras are quick.

    Args:
        image: (H, W) or (H, W, C) of any dtype, taken by ``from_``. Labels and depth take ``nearest``.
        from_: the camera that took it, central.
        to: the other camera, central.
        rotation: (3, 3) from the frame of ``to`` to that of ``from_``, ``d_from = rotation @ d_to``; None:
            both look in one direction.
        filter: ``area`` averages what a pixel shows where it spans several of the picture, ``bilinear``
            interpolates along its middle ray, ``nearest`` takes the nearest pixel.
        transfer: what 8-bit codes say of light, which ``area`` averages: ``srgb``, ``film``; ``unknown``:
            codes are averaged.

    Returns:
        (H', W') or (H', W', C) of the picture's dtype; 0 where the picture shows nothing.

    Raises:
        ArgumentError: a camera with several optical centres, or a picture of another size than its camera's.
    """
    one_of("filter", filter, FILTERS)
    rotation = np.eye(3) if rotation is None else rotation_reader("rotation", rotation)
    rays = rays_of_a_pixel(from_, to) if filter == "area" else 1
    described = (json.dumps(from_.to_dict()), json.dumps(to.to_dict()), rotation.tobytes(), rays)
    return _kept(*described)(image, nearest=filter == "nearest", transfer=transfer)


def rays_of_a_pixel(from_: Camera, to: Camera) -> int:
    """Return how many pixels of a picture by ``from_`` a pixel of ``to`` spans along an axis, rounded up."""
    density = pixels_per_radian(to)
    if density == 0:
        return 1
    spanned = pixels_per_radian(from_) / density
    return min(_MOST_RAYS, max(1, math.ceil(spanned - 0.25)))


@lru_cache(_KEPT)
def _kept(from_: str, to: str, rotation: bytes, rays: int) -> "Reprojection":
    """Return the map of cameras that are described as JSON."""
    R = np.frombuffer(rotation).reshape(3, 3)
    return Reprojection(from_dict(json.loads(from_)), from_dict(json.loads(to)), R, rays)


class Reprojection:
    """Where the pixels of one camera lie in the pictures of another one.

    Args:
        from_: the camera that took the pictures, central.
        to: the other camera, central.
        rotation: (3, 3) from the frame of ``to`` to that of ``from_``.
        rays: of a pixel along each axis, whose values are averaged.

    Attributes:
        valid: (H', W') bool, pixels that see something of the pictures.

    Raises:
        ArgumentError: a camera with several optical centres, or one that is too large.
    """

    def __init__(self, from_: Camera, to: Camera, rotation: Array, rays: int = 1) -> None:
        for name, camera in (("from_", from_), ("to", to)):
            if not camera.central:
                expected = f"{name}: expected a camera with one optical centre"
                raise ArgumentError(f"{expected}, got {camera.name!r}: what it sees depends on depth")
            if max(camera.width, camera.height) > LARGEST_PX:
                size = f"{camera.width}x{camera.height}"
                raise ArgumentError(f"{name}: expected at most {LARGEST_PX} px a side, got {size}")
        self._from = from_
        self._rotation = rotation
        self._offsets = (np.arange(rays) + 0.5) / rays - 0.5
        self._shape = (to.height, to.width)
        count = rays * rays
        self._x = np.empty((count, *self._shape), np.float32)
        self._y = np.empty((count, *self._shape), np.float32)
        self._seen: Mask = np.empty((count, *self._shape), np.bool_)
        self._alone: Mask = np.zeros((count, *self._shape), np.bool_)
        self._to = to
        row_blocks(self._find, to.height, to.width * count)
        self._alone_pixels = [self._pixels_of(number, self._alone[number]) for number in range(count)]
        self._all_seen: Mask = np.asarray(self._seen.all(axis=(1, 2)))
        self.valid: Mask = np.asarray(self._seen.any(axis=0))

    def __call__(self, image: ArrayLike, *, nearest: bool = False, transfer: str = "unknown") -> NDArray[Any]:
        """Return a picture by the other camera; see :func:`reproject`.

        Args:
            image: (H, W) or (H, W, C).
            nearest: take the nearest pixel of the middle ray, and blend nothing.
            transfer: what 8-bit codes say of light.
        """
        picture = np.asarray(image)
        size = (self._from.height, self._from.width)
        if picture.ndim not in (2, 3) or picture.shape[:2] != size:
            expected = f"image: expected (H, W) or (H, W, C) of {size[1]}x{size[0]} px, as its camera has"
            raise ArgumentError(f"{expected}, got an array of shape {shown(picture.shape)}")
        middle = len(self._x) // 2
        if nearest:
            return self._nearest(picture, middle)
        if len(self._x) == 1:
            return self._bilinear(picture, 0)
        return self._mean(picture, transfer)

    def _find(self, rows: slice) -> None:
        """Find where rays of some rows lie in the pictures."""
        for number in range(len(self._x)):
            i, j = divmod(number, len(self._offsets))
            last = min(rows.stop, self._shape[0])
            pixels = np.empty((last - rows.start, self._shape[1], 2))
            pixels[..., 0] = np.arange(self._shape[1]) + 0.5 + self._offsets[j]
            pixels[..., 1] = np.arange(rows.start, last)[:, None] + 0.5 + self._offsets[i]
            rays = self._to.unproject(pixels)
            directions = np.where(rays.valid[..., None], rays.directions, (0.0, 0.0, 1.0)) @ self._rotation.T
            at, seen = self._from.project(directions)
            seen = seen & rays.valid
            at = np.where(seen[..., None], at, 0.5)
            self._x[number, rows] = at[..., 0] - 0.5
            self._y[number, rows] = np.clip(at[..., 1] - 0.5, 0, self._from.height - 1)
            if not self._from.wraps:
                seen = seen & self._has_pixel(number, rows)
                self._alone[number, rows] = seen & ~self._is_blended(number, rows, directions)
            self._seen[number, rows] = np.asarray(seen)

    def _has_pixel(self, number: int, rows: slice) -> Mask:
        """Return whether the nearest pixel has a ray: at the rim of an image circle it may have none."""
        u = np.clip(np.rint(self._x[number, rows]), 0, self._from.width - 1) + 0.5
        v = np.rint(self._y[number, rows]) + 0.5
        return self._from.valid(np.stack([u, v], axis=-1))

    def _is_blended(self, number: int, rows: slice, directions: Array) -> Mask:
        """Return whether all four pixels around a point show its surroundings on the sphere."""
        limit = _APART_PX / pixels_per_radian(self._from)
        left = np.floor(self._x[number, rows])
        above = np.floor(self._y[number, rows])
        blended = np.ones(left.shape, np.bool_)
        for across, down in ((0, 0), (1, 0), (0, 1), (1, 1)):
            u = np.clip(left + across, 0, self._from.width - 1) + 0.5
            v = np.clip(above + down, 0, self._from.height - 1) + 0.5
            corner = self._from.unproject(np.stack([u, v], axis=-1))
            chord = np.linalg.norm(corner.directions - directions, axis=-1)
            blended &= corner.valid & (chord < limit)
        return blended

    def _pixels_of(self, number: int, chosen: Mask) -> tuple[tuple[Ints, ...], Ints, Ints]:
        """Return where chosen pixels are, and the row and column that one ray of each meets nearest to it."""
        column = np.clip(np.rint(self._x[number][chosen]).astype(np.int64), 0, self._from.width - 1)
        row = np.rint(self._y[number][chosen]).astype(np.int64)
        return np.nonzero(chosen), row, column

    def _nearest(self, picture: NDArray[Any], number: int) -> NDArray[Any]:
        """Return the nearest pixels of one ray of each pixel."""
        seen, row, column = self._pixels_of(number, self._seen[number])
        values = np.zeros((*self._shape, *picture.shape[2:]), picture.dtype)
        values[seen] = picture[row, column]
        return values

    def _bilinear(self, picture: NDArray[Any], number: int) -> NDArray[Any]:
        """Return interpolated values of one ray of each pixel."""
        if picture.dtype.name not in _BLENDED:
            expected = f"image: expected pixels of {', '.join(_BLENDED)} to blend"
            raise ArgumentError(f"{expected}, got {picture.dtype}; filter='nearest' takes any")
        # Rows are within the picture, so that the border is that of columns.
        border = cv2.BORDER_WRAP if self._from.wraps else cv2.BORDER_REPLICATE
        x = self._x[number]
        y = self._y[number]
        sampled = cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=border)
        values = np.asarray(sampled).reshape(*self._shape, *picture.shape[2:])
        if not self._all_seen[number]:
            values[~self._seen[number]] = 0
        alone, row, column = self._alone_pixels[number]
        values[alone] = picture[row, column]
        return values

    def _mean(self, picture: NDArray[Any], transfer: str) -> NDArray[Any]:
        """Return the mean of all rays of each pixel that see something: of light, where codes say it."""
        is_light = light.known(transfer, picture)
        values: Floats = light.decode(picture, transfer) if is_light else picture.astype(np.float32)
        total = np.zeros((*self._shape, *picture.shape[2:]), np.float32)
        for number in range(len(self._x)):
            total += self._bilinear(values, number)
        counts = self._seen.sum(axis=0).astype(np.float32)
        counts = counts.reshape(*counts.shape, *[1] * (picture.ndim - 2))
        mean: NDArray[Any] = total / np.maximum(counts, 1)
        if is_light:
            return cast(NDArray[Any], light.encode(mean, transfer))
        if picture.dtype.kind in "ui":
            mean = np.rint(mean)
        return mean.astype(picture.dtype)
