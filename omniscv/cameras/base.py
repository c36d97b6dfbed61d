"""What every camera model is: a map from pixels to rays and back.

Conventions
    Pixels are continuous: (0, 0) is the image's top-left corner, pixel (i, j) has its centre at
    (i + 0.5, j + 0.5), and the image is the closed rectangle [0, width] x [0, height].
    Camera frame: x right, y down, z forward. Rays have an origin (metres) and a unit direction.

A pixel or point that the model cannot serve is data, not an error: it comes back with
``valid = False`` and NaN in its numbers. A wrong call (shape, parameter) raises ``ArgumentError``.

To add a model
    1. Write a class in the file of its family (or a new one): subclass :class:`Camera` (or a family
       base), give it ``name``, a docstring that is the model in ten lines (formula, parameters with
       units, domain, source), ``parameters()``, ``_unproject`` and ``_project``.
    2. List it in ``_MODELS`` of ``omniscv/cameras/__init__.py``.
    3. Add an example of it to ``tests/cameras/examples.py``: the contract suite then runs on it.
    4. Show it: its ways into its limits in ``APPROACHES`` of ``scripts/draw-stability``, an image in
       ``_EVERY_MODEL`` of ``omniscv/demo.py``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv.errors import ArgumentError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_FARTHEST = 1e150  # metres: of what is farther, float64 cannot hold the square
_NEAREST = float(np.finfo(np.float64).tiny)  # metres: of what is nearer, float64 drops digits
_ROUNDING = 1e-12  # relative: what rounding may add to a pixel at the border


@dataclass(frozen=True, eq=False)
class Rays:
    """Half-lines in the camera frame.

    Attributes:
        origins: (..., 3) float64, metres, a point on each ray's line: the optical centre.
        directions: (..., 3) float64, unit; NaN where not valid.
        valid: (...) bool.
    """

    origins: Array
    directions: Array
    valid: Mask

    def lines(self) -> Array:
        """(..., 6) Plücker coordinates: direction, then moment ``origin x direction``."""
        return np.concatenate([self.directions, np.cross(self.origins, self.directions)], axis=-1)


@dataclass(frozen=True, eq=False)
class Viewpoints:
    """The optical centres of an image, and which pixel belongs to which.

    Attributes:
        centers: (K, 3) float64, camera frame, metres.
        index: (H, W) int32, row of ``centers``; -1 for invalid pixels.
    """

    centers: Array
    index: NDArray[np.int32]


class Camera(ABC):
    """A camera model with its image size.

    Args:
        width, height: image size in pixels, each at least 1.
        center: (u, v) px, where the axis meets the image; the image's middle if not given.

    Raises:
        ArgumentError: a size below 1, or a centre that is not two finite numbers.
    """

    name: ClassVar[str]
    central: ClassVar[bool] = True
    has_center: ClassVar[bool] = True  # the constructor takes ``center``

    def __init__(self, width: int, height: int, center: ArrayLike | None = None) -> None:
        self.width, self.height = (
            self._whole_number(key, value, "pixels") for key, value in (("width", width), ("height", height))
        )
        middle = np.array([self.width / 2, self.height / 2])
        self.center = middle if center is None else self._numbers("center", center, 2)

    # -- the contract ---------------------------------------------------------------------------

    def unproject(self, pixels: ArrayLike | None = None) -> Rays:
        """The rays of pixels.

        Args:
            pixels: (..., 2) (u, v) in px; every pixel's centre, (H, W, 2), if not given.

        Returns:
            Rays of shape (...), camera frame.
        """
        uv = self.pixels() if pixels is None else _last_axis("pixels", pixels, 2)
        with np.errstate(all="ignore"):
            u, v = uv[..., 0], uv[..., 1]
            inside = np.asarray((u >= 0) & (u <= self.width) & (v >= 0) & (v <= self.height))
            origins, directions, valid = self._unproject(_where(inside, uv, self.center))
        valid = np.asarray(valid & inside, dtype=bool)
        return Rays(_where(valid, origins, np.nan), _where(valid, directions, np.nan), valid)

    def project(self, points: ArrayLike) -> tuple[Array, Mask]:
        """The pixels that see points.

        Args:
            points: (..., 3), camera frame, metres.

        Returns:
            pixels (..., 2) in px, NaN where not valid, and valid (...): the point is seen by a
            valid pixel within the image. Points farther than 1e150 m and, by central cameras, the
            optical centre (to 1e-308 m) are not seen.
        """
        xyz = _last_axis("points", points, 3)
        with np.errstate(all="ignore"):
            x, y, z = np.abs(xyz[..., 0]), np.abs(xyz[..., 1]), np.abs(xyz[..., 2])
            largest = np.maximum(np.maximum(x, y), z)
            placed = np.asarray((largest >= (_NEAREST if self.central else 0.0)) & (largest <= _FARTHEST))
            pixels, valid = self._project(_where(placed, xyz, 1.0))
            pixels, inside = self._within_image(pixels)
        valid = np.asarray(valid & placed & inside)
        return _where(valid, pixels, np.nan), valid

    def valid(self, pixels: ArrayLike | None = None) -> Mask:
        """(...) bool: which pixels have a ray; (H, W) for the whole image if not given."""
        return self.unproject(pixels).valid

    def viewpoints(self, count: int | None = None) -> Viewpoints:
        """The optical centres. One for a central camera; ``count`` asks for fewer otherwise."""
        if count is not None:
            self._whole_number("count", count, "viewpoints")
        index = np.where(self.valid(), 0, -1).astype(np.int32)
        return Viewpoints(np.zeros((1, 3)), index)

    def parameters(self) -> dict[str, Any]:
        """The model's own constructor arguments, beyond width, height and center, JSON-ready."""
        return {}

    @abstractmethod
    def _unproject(self, pixels: Array) -> tuple[Array, Array, Mask]:
        """Origins, unit directions, valid of pixels (..., 2) inside the rectangle; warnings are off."""

    @abstractmethod
    def _project(self, points: Array) -> tuple[Array, Mask]:
        """Pixels, valid of finite points (..., 3), for central models not the optical centre.

        Warnings are off, the rectangle is checked outside.
        """

    # -- common to all --------------------------------------------------------------------------

    def pixels(self) -> Array:
        """(H, W, 2) the centre (u, v) of every pixel."""
        u, v = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
        return np.stack([u, v], axis=-1)

    def to_dict(self) -> dict[str, Any]:
        """Name, size, centre and parameters: what :func:`omniscv.cameras.from_dict` takes."""
        return {
            "model": self.name,
            "width": self.width,
            "height": self.height,
            **({"center": self.center.tolist()} if self.has_center else {}),
            **self.parameters(),
        }

    def __repr__(self) -> str:
        fields = ", ".join(f"{k}={v!r}" for k, v in self.to_dict().items() if k != "model")
        return f"{type(self).__name__}({fields})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Camera) and self.to_dict() == other.to_dict()

    def __hash__(self) -> int:
        return hash(repr(self))

    def _within_image(self, pixels: Array) -> tuple[Array, Mask]:
        """Which pixels (..., 2) lie in the rectangle; those that rounding took out of it are put back."""
        size = np.array([self.width, self.height])
        slack = _ROUNDING * (size + np.abs(self.center))
        u, v = pixels[..., 0], pixels[..., 1]
        inside = (u >= 0) & (u <= self.width) & (v >= 0) & (v <= self.height)
        near = (u >= -slack[0]) & (u <= size[0] + slack[0]) & (v >= -slack[1]) & (v <= size[1] + slack[1])
        rounded = near & ~inside
        return _where(~rounded, pixels, np.clip(pixels, 0, size)) if rounded.any() else pixels, near

    # -- argument checks that models share ------------------------------------------------------

    @staticmethod
    def _whole_number(key: str, value: int, of_what: str) -> int:
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
            raise ArgumentError(f"{key}: expected a whole number of {of_what} >= 1, got {value!r}")
        return int(value)

    @staticmethod
    def _numbers(key: str, value: ArrayLike, count: int) -> Array:
        try:
            array = np.array(value, dtype=np.float64)
        except (TypeError, ValueError) as cause:
            raise ArgumentError(f"{key}: expected {count} finite numbers, got {value!r}") from cause
        if array.shape != (count,) or not np.isfinite(array).all():
            raise ArgumentError(f"{key}: expected {count} finite numbers, got {value!r}")
        return array

    @staticmethod
    def _number(
        key: str,
        value: float,
        *,
        above: float = -np.inf,
        least: float = -np.inf,
        below: float = np.inf,
        most: float = np.inf,
    ) -> float:
        """``value`` as a float within its limits (``above``, ``below`` exclude them)."""
        limits = [
            text
            for text, bound in (
                (f"> {above:.15g}", above),
                (f">= {least:.15g}", least),
                (f"< {below:.15g}", below),
                (f"<= {most:.15g}", most),
            )
            if np.isfinite(bound)
        ]
        wanted = "a finite number" + (" " + " and ".join(limits) if limits else "")
        try:
            number = float(value)
        except (TypeError, ValueError) as cause:
            raise ArgumentError(f"{key}: expected {wanted}, got {value!r}") from cause
        if not (np.isfinite(number) and above < number < below and least <= number <= most):
            raise ArgumentError(f"{key}: expected {wanted}, got {value!r}")
        return number


def _last_axis(key: str, value: ArrayLike, size: int) -> Array:
    array = np.asarray(value)
    if array.shape[-1:] != (size,) or array.dtype.kind not in "fiu":
        raise ArgumentError(
            f"{key}: expected numbers of shape (..., {size}), got {array.dtype} of shape {array.shape}"
        )
    return array.astype(np.float64, copy=False)


def _where(keep: Mask, vectors: Array, instead: ArrayLike) -> Array:
    """``vectors`` (..., n), and ``instead`` where ``keep`` (...) is False; no copy where all are kept."""
    return vectors if keep.all() else np.where(keep[..., None], vectors, instead)


def sin_cos_of_half(angle_deg: float) -> tuple[Array, Array]:
    """Sine and cosine of ``angle_deg / 2``, 0 to 180, that keep their digits next to 0, 90 and 180 degrees.

    In radians a right angle is not exact: tan of the last number before it is off by half.
    """
    half = angle_deg / 2
    return np.sin(np.radians(min(half, 180 - half))), np.sin(np.radians(90 - half))


def polar(pixels: Array, center: Array) -> tuple[Array, Array, Array]:
    """Radius in px and the unit vector (cos a, sin a) of the azimuth; (1, 0) at the centre."""
    x, y = pixels[..., 0] - center[0], pixels[..., 1] - center[1]
    r = np.hypot(x, y)
    at_center = r < _NEAREST
    safe = np.where(at_center, 1.0, r)
    return r, np.where(at_center, 1.0, x / safe), np.where(at_center, 0.0, y / safe)
