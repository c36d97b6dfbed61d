"""Base of all camera models: a map from pixels to rays and back.

Conventions
    Pixels are continuous: (0, 0) is the image's top-left corner, pixel (i, j) has its centre at
    (i + 0.5, j + 0.5), and the image is the closed rectangle [0, width] x [0, height].
    Camera frame: x right, y down, z forward. Rays have an origin (metres) and a unit direction.

A pixel or point outside the model's domain is no error: its result has ``valid = False`` and NaN in its
numbers. Wrong arguments (shapes, parameters, numbers that a model cannot compute with) raise
``ArgumentError``. Points more than 1e150 m away are not seen.

To add a model
    1. Subclass :class:`CentralCamera` (or :class:`Camera`, or the base of a family), here or in another
       package, and decorate the class with ``omniscv.cameras.register``. Give it ``name``, a docstring that
       is the model in ten lines (formula, parameters with units, domain, source), a constructor that keeps
       each argument in an attribute of the same name, ``_directions`` (``Camera``: ``_unproject``) and
       ``_project``.
    2. Unless ``cls(width, width)`` is a typical camera, give typical parameters as ``typical`` and
       ``typical_focal``, or override ``example``. The demo, the stability chart and the contract suite use
       the example; ``tests/cameras/examples.py`` may add cameras at the limits of its parameters.
    3. In this package, import it in ``omniscv/cameras/__init__.py``.
"""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial, wraps
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv.arguments import numbers, shown, whole_number
from omniscv.cameras.lens_parameters import Parameters
from omniscv.errors import ArgumentError
from omniscv.geometry.arrays import ROUNDING

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

Parameter = float | str | Sequence[float] | Array | Mapping[str, Any] | None  # of constructors
FARTHEST = 1e150  # metres: float64 cannot hold the square of more
LARGEST_PX = 10**6  # rounding at the border of larger images would exceed 1e-6 px
_SAME_RAY = 1e-9  # tolerance of Plücker coordinates, metres
LARGEST_IMAGE = 1 << 27  # pixels, 16384 x 8192: its rays take 7 GB


def grid_axes(pixels: Array) -> tuple[Array, Array]:
    """Return u and v of pixels (..., 2); of a grid (H, W, 2), a row (1, W) of u and a column (H, 1) of v."""
    u = pixels[..., 0]
    v = pixels[..., 1]
    if pixels.ndim == 3 and (u == u[:1]).all() and (v == v[:, :1]).all():
        return u[:1], v[:, :1]
    return u, v


def vectors(x: Array, y: Array, z: Array) -> Array:
    """Return vectors (..., 3) of coordinates x, y and z that broadcast, such as rows and columns of a
    grid."""
    xyz = np.empty((*np.broadcast_shapes(x.shape, y.shape, z.shape), 3))
    xyz[..., 0] = x
    xyz[..., 1] = y
    xyz[..., 2] = z
    return xyz


def refuse_focal_and_fov(focal: object, fov_deg: object) -> None:
    """Raise ArgumentError if both ``focal`` and ``fov_deg`` are given, of which the focal length follows."""
    if focal is not None and fov_deg is not None:
        raise ArgumentError(f"focal: expected focal or fov_deg, got both ({shown(focal)}, {shown(fov_deg)})")


def sin_cos_of_half(angle_deg: float) -> tuple[Array, Array]:
    """Return sine and cosine of ``angle_deg / 2``; exact to the last digits near 0, 90 and 180 degrees."""
    half = angle_deg / 2
    return np.sin(np.radians(min(half, 180 - half))), np.sin(np.radians(90 - half))


def polar(xy: Array, center: ArrayLike = (0.0, 0.0)) -> tuple[Array, Array, Array]:
    """Return radius r and azimuth (cos a, sin a) of points ``xy`` (..., 2) about ``center``; (1, 0) there."""
    offset = xy - np.asarray(center)
    x = offset[..., 0]
    y = offset[..., 1]
    r = np.hypot(x, y)
    at_center = r == 0
    safe = np.where(at_center, 1.0, r)
    return r, np.where(at_center, 1.0, x / safe), np.where(at_center, 0.0, y / safe)


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
        """Return Plücker coordinates (..., 6): direction, then moment ``origin x direction``."""
        return np.concatenate([self.directions, np.cross(self.origins, self.directions)], axis=-1)


@dataclass(frozen=True, eq=False)
class Viewpoints:
    """The optical centres of an image, and the centre of each pixel.

    Attributes:
        centers: (K, 3) float64, camera frame, metres.
        index: (H, W) int32, row of ``centers``; -1 for invalid pixels.
    """

    centers: Array
    index: NDArray[np.int32]


class Camera(ABC):
    """A camera model with its image size. Cameras are immutable; equal parameters make equal cameras.

    Constructors keep their arguments in attributes of the same names (or, like ``fov_deg``, in others
    that follow from them); :meth:`parameters`, :meth:`to_dict`, equality and pickling use these.

    Args:
        width: of the image, px, 1 to 1,000,000.
        height: of the image, px, likewise; the image has at most ``LARGEST_IMAGE`` pixels.
        center: (u, v) px, where the axis meets the image; the image's middle if not given.

    Raises:
        ArgumentError: another size, or a centre that is not two finite numbers.
    """

    name: ClassVar[str]
    central: ClassVar[bool] = True
    lens: ClassVar[Parameters | None] = None  # of lenses: their numbers
    typical: ClassVar[dict[str, Any]] = {}
    typical_focal: ClassVar[float] = 0.0  # in widths of the image; 0: the default
    typical_aspect: ClassVar[float] = 1.0  # height by width
    typical_pitch_deg: ClassVar[float] = 0.0  # 90: a mirror above the camera; -90: a plan

    def __init__(self, width: int, height: int, center: ArrayLike | None = None) -> None:
        self.width = whole_number("width", width, "pixels", most=LARGEST_PX)
        self.height = whole_number("height", height, "pixels", most=LARGEST_PX)
        if self.width * self.height > LARGEST_IMAGE:
            size = f"{self.width} x {self.height}"
            raise ArgumentError(f"size: expected at most {LARGEST_IMAGE} pixels (16384 x 8192), got {size}")
        middle = (self.width / 2, self.height / 2)
        self.center = numbers("center", middle if center is None else center, (2,))

    @classmethod
    def example(cls, width: int = 512) -> Self:
        """Return a typical camera of the model: an image ``width`` pixels wide, parameters ``typical``."""
        parameters = dict(cls.typical)
        if cls.typical_focal:
            names = [argument.name for argument in cls.lens.focal] if cls.lens else ["focal"]
            parameters |= dict.fromkeys(names, cls.typical_focal * width)
        return cls(width, max(1, int(width * cls.typical_aspect)), **parameters)

    # -- the contract ---------------------------------------------------------------------------

    def unproject(self, pixels: ArrayLike | None = None) -> Rays:
        """Return the rays of pixels.

        Args:
            pixels: (..., 2) (u, v) in px; every pixel's centre, (H, W, 2), if not given.

        Returns:
            Rays of shape (...), camera frame.
        """
        uv = self.pixels() if pixels is None else _last_axis("pixels", pixels, 2)
        with np.errstate(all="ignore"):
            u = uv[..., 0]
            v = uv[..., 1]
            inside = np.ones(u.shape, dtype=bool)
            if pixels is not None:
                inside = np.asarray((u >= 0) & (u <= self.width) & (v >= 0) & (v <= self.height))
            origins, directions, valid = self._unproject(_replace(uv, inside, self.center))
        valid = np.asarray(valid & inside, dtype=bool)
        if origins.shape != directions.shape:  # one per row or column of a grid
            origins = np.array(np.broadcast_to(origins, directions.shape))
        return Rays(_blank(origins, valid), _blank(directions, valid), valid)

    def project(self, points: ArrayLike) -> tuple[Array, Mask]:
        """Return the pixels that see points.

        Args:
            points: (..., 3), camera frame, metres.

        Returns:
            pixels (..., 2) in px, NaN where not valid, and valid (...): the point is seen by a
            valid pixel within the image.
        """
        xyz = _last_axis("points", points, 3)
        with np.errstate(all="ignore"):
            largest = np.maximum(np.abs(xyz[..., 0]), np.abs(xyz[..., 1]))
            largest = np.maximum(largest, np.abs(xyz[..., 2]))
            known = np.asarray((largest > 0 if self.central else True) & (largest <= FARTHEST))
            pixels, valid = self._project(_replace(xyz, known, 1.0))
            pixels, inside = self._within_image(pixels)
            valid = np.asarray(valid & known & inside)
        return _replace(pixels, valid, np.nan), valid

    def valid(self, pixels: ArrayLike | None = None) -> Mask:
        """Return which pixels have a ray, (...) bool; (H, W) for every pixel if not given."""
        return self.unproject(pixels).valid

    def viewpoints(self, count: int | None = None) -> Viewpoints:
        """Return the optical centres: one for a central camera, else at most ``count`` if given."""
        if count is not None:
            whole_number("count", count, "viewpoints")
        index = np.where(self.valid(), 0, -1).astype(np.int32)
        return Viewpoints(np.zeros((1, 3)), index)

    @cached_property
    def wraps(self) -> bool:
        """Whether the borders of the image meet: pixels at u = 0 and u = width have the same rays."""
        left = self._column(0.0)
        right = self._column(self.width)
        if not (left.valid.all() and right.valid.all()):
            return False
        return bool(np.abs(left.lines() - right.lines()).max() <= _SAME_RAY)

    def _column(self, u: float) -> Rays:
        """Return the rays (H,) of the pixels of each row's middle at u px."""
        v = np.arange(self.height) + 0.5
        return self.unproject(np.stack([np.full_like(v, u), v], axis=-1))

    @abstractmethod
    def _unproject(self, pixels: Array) -> tuple[Array, Array, Mask | bool]:
        """Return origins, unit directions (new arrays), valid of pixels (..., 2) of the image."""

    @abstractmethod
    def _project(self, points: Array) -> tuple[Array, Mask | bool]:
        """Return pixels, in the image or not, and valid of finite points (..., 3)."""

    # -- common to all --------------------------------------------------------------------------

    def pixels(self) -> Array:
        """Return the centre (u, v) of every pixel, (H, W, 2)."""
        pixels = np.empty((self.height, self.width, 2))
        pixels[..., 0] = np.arange(self.width) + 0.5
        pixels[..., 1] = np.arange(self.height)[:, None] + 0.5
        return pixels

    def parameters(self) -> dict[str, Any]:
        """Return the constructor arguments beyond width, height and center, ready for JSON."""
        arguments = self._arguments()
        for key in ("width", "height", "center"):
            arguments.pop(key, None)
        return arguments

    def to_dict(self) -> dict[str, Any]:
        """Return name, size, centre and parameters: what :func:`omniscv.cameras.from_dict` takes."""
        return {"model": self.name, **self._arguments()}

    def _arguments(self) -> dict[str, Any]:
        """Return the constructor arguments that reproduce this camera, without those that are None."""
        arguments: dict[str, Any] = {}
        for key in inspect.signature(type(self)).parameters:
            value = getattr(self, key, None)
            if value is not None:
                arguments[key] = value.tolist() if hasattr(value, "tolist") else value
        return arguments

    def __repr__(self) -> str:
        fields = ", ".join(f"{key}={value!r}" for key, value in self._arguments().items())
        return f"{type(self).__name__}({fields})"

    @cached_property
    def _key(self) -> tuple[type[Camera], str]:
        """What equality compares: the class, and all arguments."""
        return type(self), repr(self)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Camera) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    def __reduce__(self) -> tuple[Any, ...]:
        return partial(type(self), **self._arguments()), ()

    def __init_subclass__(cls, **options: Any) -> None:
        """Wrap the constructor: it checks and freezes the camera at its end.

        The signature of one that passes ``**others`` on to its base has those of the base: by name alone, but
        for the size, unless it passes ``*size`` on, too.
        """
        super().__init_subclass__(**options)
        construct = cls.__init__
        own = inspect.signature(construct).parameters.values()
        kinds = {parameter.kind for parameter in own}

        @wraps(construct)
        def __init__(self: Camera, *args: Any, **kwargs: Any) -> None:  # noqa: N807
            with np.errstate(all="ignore"):
                construct(self, *args, **kwargs)
            if type(self) is cls:
                self._freeze()

        if inspect.Parameter.VAR_KEYWORD in kinds:
            by_name = inspect.Parameter.VAR_POSITIONAL not in kinds
            parameters = []
            for index, parameter in enumerate(
                inspect.signature(super(cls, cls).__init__).parameters.values()
            ):
                after_size = index > 2  # self, width, height
                if by_name and after_size:
                    parameter = parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)
                parameters.append(parameter)
            parameters += [parameter for parameter in own if parameter.kind is inspect.Parameter.KEYWORD_ONLY]
            __init__.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        cls.__init__ = __init__  # type: ignore[method-assign]

    def _freeze(self) -> None:
        """Make attributes immutable; ArgumentError for a number that is not finite."""
        for key, value in vars(self).items():
            if isinstance(value, float | np.ndarray) and not np.isfinite(value).all():
                raise ArgumentError(f"camera: expected numbers that float64 can compute with, got {self!r}")
            if isinstance(value, np.ndarray) and value.flags.writeable:
                vars(self)[key] = value = value.copy()
                value.flags.writeable = False
        vars(self)["_frozen"] = True

    def __setattr__(self, name: str, value: object) -> None:
        if "_frozen" in vars(self):
            raise self._immutable(name)
        super().__setattr__(name, value)

    def __delattr__(self, name: str) -> None:
        raise self._immutable(name)

    def _immutable(self, name: str) -> AttributeError:
        """Return the error of changing an attribute."""
        advice = "create another one, for example with omniscv.cameras.from_dict({**camera.to_dict(), ...})"
        return AttributeError(f"{type(self).__name__}.{name}: cameras are immutable; {advice}")

    def _within_image(self, pixels: Array) -> tuple[Array, Mask]:
        """Return pixels (..., 2) clipped to the image, and which of them were in it but for rounding."""
        size = np.array([self.width, self.height])
        slack = ROUNDING * (size + np.abs(self.center))
        near = np.asarray(((pixels >= -slack) & (pixels <= size + slack)).all(axis=-1))
        return np.clip(pixels, 0, size), near

    @cached_property
    def _pixel_rounding(self) -> float:
        """Rounding error, px, of a pixel that is computed as an offset from the centre."""
        return float(4e-16 * (max(self.width, self.height) + np.abs(self.center).max()))


class CentralCamera(Camera):
    """A camera whose rays all start at the origin: subclasses give their directions."""

    @abstractmethod
    def _directions(self, pixels: Array) -> tuple[Array, Mask | bool]:
        """Return unit directions (a new array), valid of pixels (..., 2) of the image."""

    def _unproject(self, pixels: Array) -> tuple[Array, Array, Mask | bool]:
        directions, valid = self._directions(pixels)
        return np.zeros(directions.shape), directions, valid  # np.zeros_like would write the memory


def _last_axis(key: str, value: ArrayLike, size: int) -> Array:
    """Return numbers (..., size) as float64; ArgumentError that names ``key`` for anything else."""
    array = np.asarray(value)
    if array.shape[-1:] != (size,) or array.dtype.kind not in "fiu":
        raise ArgumentError(f"{key}: expected numbers (..., {size}), got {array.dtype} of {array.shape}")
    return array.astype(np.float64, copy=False)


def _replace(rows: Array, keep: Mask, value: ArrayLike) -> Array:
    """Return ``rows`` (..., n) with ``value`` where ``keep`` (...) is False; no copy if all are kept."""
    return rows if keep.all() else np.where(keep[..., None], rows, value)


def _blank(rows: Array, keep: Mask) -> Array:
    """Return ``rows`` (..., 3), which may be changed in place, with NaN where ``keep`` (...) is False."""
    if not keep.all():
        from omniscv.cameras import camera_kernels  # slow to load

        rows = np.require(rows, requirements=("C", "W"))
        camera_kernels.blank(rows.reshape(-1, 3), keep.reshape(-1))
    return rows


def viewpoints_by_line(origins: Array, valid: Mask, axis: int, count: int | None) -> Viewpoints:
    """Return one centre per line of an image, or at most ``count``, each for the same number of lines.

    A shared centre is the mean of the lines' centres; if all are equal, there is one. Centres without a valid
    pixel are left out.

    Args:
        origins: (L, 3) the centre of each line, camera frame, metres.
        valid: (H, W) which pixels have a ray.
        axis: 0 where lines are rows, 1 where they are columns.
        count: at most so many centres; None: one a line.
    """
    lines = len(origins)
    count = whole_number("count", lines if count is None else count, "viewpoints")
    groups = 1 if (origins == origins[0]).all() else min(count, lines)
    group = np.arange(lines) * groups // lines
    first = np.searchsorted(group, np.arange(groups))
    centers = np.add.reduceat(origins, first) / np.bincount(group)[:, None]
    if groups == 1 and count == lines:
        centers = origins[:1]
    used, group = np.unique(np.where(valid.any(axis=1 - axis), group, -1), return_inverse=True)
    visible = used[used >= 0]
    line = np.expand_dims(group - (len(used) - len(visible)), 1 - axis)
    return Viewpoints(centers[visible], np.where(valid, line, -1).astype(np.int32))
