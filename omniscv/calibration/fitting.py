"""Fit a camera of one model to another camera, for programs that lack its model."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np
from numpy.typing import NDArray

from omniscv import cameras
from omniscv.arguments import one_of, shown
from omniscv.calibration.intrinsics import camera_of
from omniscv.cameras import Camera
from omniscv.errors import ArgumentError

Floats = NDArray[np.float64]

_SCALED_PX = 256  # longer side of the image in which the numbers are fitted: they are near 1 there
_GRID = 25  # fitted rays across and down
_MOST_RAYS = 1 << 20  # rays whose errors are measured, at most
_STEPS = 60  # iterations of least squares, at most
_MATRIX = ("fx", "fy", "cx", "cy")
_ONE_FOCAL = ("focal", "cx", "cy")
_UNBOUNDED = (-np.inf, np.inf)


@dataclass(frozen=True)
class _Family:
    """How a model's numbers are fitted.

    Attributes:
        starts: values from which a number starts, by name; 0 where not given.
        bounds: least and largest value of a number, by name.
        reach_deg: the largest angle off the axis of rays that are fitted.
        terms: names of the numbers of the distortion; empty: all but the skew.
    """

    starts: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    reach_deg: float = 180.0
    terms: tuple[str, ...] = ()

    def names(self, model: str, one_focal: bool) -> tuple[str, ...]:
        """Return the names of the numbers, focal lengths and centre first.

        Args:
            model: the lens.
            one_focal: whether its focal lengths are fitted as one, though it may have two.
        """
        lens = cameras.model(model).lens
        assert lens is not None
        terms = list(self.terms)
        if not terms:
            for argument in lens.distortion:
                terms += [name for name in argument.names if name != "skew"]
        matrix = _ONE_FOCAL if one_focal or len(lens.focal) != 2 else _MATRIX
        return (*matrix, *terms)


_ALPHA = (1e-6, 1 - 1e-6)
_FAMILIES: dict[str, _Family] = {
    "pinhole": _Family(reach_deg=80.0, terms=("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")),
    "kannala-brandt": _Family(),
    "fisheye624": _Family(),
    "unified": _Family({"xi": (0.01, 0.5, 1.0, 1.5, 2.5)}, {"xi": (-1 + 1e-6, 30.0)}),
    "extended-unified": _Family(
        {"alpha": (0.1, 0.3, 0.5, 0.6, 0.75), "beta": (1.0,)}, {"alpha": _ALPHA, "beta": (1e-3, 1e3)}
    ),
    "double-sphere": _Family(
        {"xi": (-0.4, -0.2, 0.0, 0.5), "alpha": (0.2, 0.5, 0.6, 0.7)},
        {"xi": (-1 + 1e-6, 1.0), "alpha": _ALPHA},
    ),
    "division": _Family({"k": (-0.5, -0.2, -0.05, 0.0)}),
    "field-of-view": _Family({"omega": (0.2, 0.5, 0.9, 1.4)}, {"omega": (1e-3, 3.1)}),
    "ftheta": _Family(terms=("c2", "c3", "c4", "c5")),
    "fisheye-equidistant": _Family(),
    "fisheye-stereographic": _Family(),
    "fisheye-orthographic": _Family(reach_deg=90.0),
    "fisheye-equisolid": _Family(),
}


@dataclass(frozen=True)
class Fit:
    """A camera fitted to another one.

    Attributes:
        camera: of the model, with the image size of the other camera, without skew.
        max_px: largest distance between the pixels of a ray in the two cameras, over the rays that both see.
        rms_px: the root mean square of these distances.
        coverage: fraction of the other camera's valid pixels whose rays both see.
    """

    camera: Camera
    max_px: float
    rms_px: float
    coverage: float


def fit(camera: Camera, model: str) -> Fit:
    """Return the camera of a model whose pixels are nearest to those of another camera in least squares.

    Least squares leaves out rays that no camera of the model sees, and for ``pinhole`` those more than 80
    degrees off the axis, where tangents grow without bound. The errors are those of all rays that both see.

    Args:
        camera: a central camera that sees along +z.
        model: a central lens; the error for another word lists them.

    Raises:
        ArgumentError: another model, a camera that is not central or does not see along +z, or one that sees
            next to nothing that the model can see.
    """
    family = _FAMILIES[one_of("model", model, _FAMILIES)]
    if not isinstance(camera, Camera) or not camera.central:
        other = camera.name if isinstance(camera, Camera) else shown(camera)
        raise ArgumentError(f"camera: expected a central one, all of whose rays meet in a point, got {other}")
    (axis,), (is_seen,) = camera.project([[0.0, 0.0, 1.0]])
    if not is_seen:
        raise ArgumentError(f"camera: expected one that sees along +z, as lenses do, got {shown(camera)}")
    fitting = _Fitting(camera, model, family.names(model, _has_one_focal(camera)), axis)
    return fitting.measure(fitting.solve())


def _has_one_focal(camera: Camera) -> bool:
    """Return whether a camera has one focal length, or two that are equal."""
    fx = getattr(camera, "fx", None)
    fy = getattr(camera, "fy", None)
    if fx is None and fy is None:
        return getattr(camera, "focal", None) is not None
    return fx is None or fy is None or bool(fx == fy)


class _Fitting:
    """A fit. Its numbers belong to the image scaled to a longer side of 256 px.

    Args:
        camera: that is fitted.
        model: the lens.
        names: of the numbers, in order.
        axis: the pixel (2,) that sees along +z, px.
    """

    def __init__(self, camera: Camera, model: str, names: tuple[str, ...], axis: Floats) -> None:
        self._camera = camera
        self._model = model
        self._names = names
        self._family = _FAMILIES[model]
        self._scale = _SCALED_PX / max(camera.width, camera.height)
        self._axis = axis * self._scale

        u = np.linspace(0, camera.width, _GRID)
        v = np.linspace(0, camera.height, _GRID)
        self._pixels, self._rays = self._within_reach(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
        if len(self._rays) < 2 * len(names):
            wanted = f"at least {2 * len(names)} of {_GRID**2} rays that {model} can see"
            raise ArgumentError(f"camera: expected {wanted}, got {len(self._rays)}")

    def solve(self) -> Floats:
        """Return the numbers of least squares, from the best of the starts."""
        x = min(self._first_guesses(), key=lambda x: float(np.square(self._residuals(x)).sum()))
        names = self._names
        undistorted = (*_MATRIX, "focal", *self._family.starts)
        shape = [i for i, name in enumerate(names) if name in undistorted]
        if not x[len(shape) :].any():
            # First without distortion: together the two lie in a long valley.
            x = self._refine(x, shape)
        return self._refine(x, range(len(names)))

    def _refine(self, x: Floats, free: Sequence[int]) -> Floats:
        """Return the numbers of least squares when only those of the indices ``free`` may differ from
        ``x``."""
        from scipy.optimize import least_squares  # slow to load, and reading files does without

        free = list(free)
        bounds = np.array([self._family.bounds.get(self._names[i], _UNBOUNDED) for i in free]).T

        def with_free(values: Floats) -> Floats:
            changed = x.copy()
            changed[free] = values
            return changed

        def residuals(values: Floats) -> Floats:
            return self._residuals(with_free(values))

        solution = least_squares(
            residuals, x[free], bounds=tuple(bounds), x_scale="jac",
            ftol=1e-13, xtol=1e-13, gtol=1e-15, max_nfev=_STEPS,
        )  # fmt: skip
        return with_free(solution.x)

    def measure(self, x: Floats) -> Fit:
        """Return the camera of fitted numbers, and its errors."""
        camera = self._camera
        step = max(1, int(np.ceil(np.sqrt(camera.width * camera.height / _MOST_RAYS))))
        u = np.arange(0.5, camera.width, step)
        v = np.arange(0.5, camera.height, step)
        pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
        rays = camera.unproject(pixels)
        fitted = self._build(x, 1.0)
        seen, both = fitted.project(rays.directions[rays.valid])
        if not both.any():
            raise ArgumentError(f"camera: expected one that {self._model} can fit, got {shown(camera)}")
        off_px = np.linalg.norm(seen - pixels[rays.valid], axis=-1)[both]
        return Fit(
            camera=fitted,
            max_px=float(off_px.max()),
            rms_px=float(np.sqrt(np.mean(off_px**2))),
            coverage=float(both.mean()),
        )

    def _within_reach(self, pixels: Floats) -> tuple[Floats, Floats]:
        """Return the valid pixels (M, 2) of (N, 2) within the model's reach, and their rays (M, 3)."""
        rays = self._camera.unproject(pixels)
        near = rays.valid & (rays.directions[:, 2] >= np.cos(np.radians(self._family.reach_deg)) - 1e-9)
        return pixels[near], rays.directions[near]

    def _first_guesses(self) -> Iterator[Floats]:
        """Yield numbers to start from: the family's, with the focal lengths that fit best."""
        names = self._names
        matrix = {"fx": 100.0, "fy": 100.0, "focal": 100.0, "cx": self._axis[0], "cy": self._axis[1]}
        for values in product(*self._family.starts.values()):
            start = matrix | dict(zip(self._family.starts, values, strict=True))
            x = np.array([start.get(name, 0.0) for name in names])
            offsets = self._project(x, self._rays) - self._axis
            targets = self._pixels * self._scale - self._axis
            both = np.isfinite(offsets).all(axis=-1)
            ratio = (offsets[both] * targets[both]).sum() / max(np.square(offsets[both]).sum(), 1e-12)
            if ratio > 0:
                is_focal = [name in ("fx", "fy", "focal") for name in names]
                x[is_focal] *= ratio
            yield x
        if self._model == "pinhole":
            yield self._rational_start()

    def _rational_start(self) -> Floats:
        """Return OpenCV's radial terms fitted to ``r_d (1 + k4 r^2 + ...) = r (1 + k1 r^2 + ...)``, which is
        linear in them; all are at least 0, so that no denominator vanishes."""
        from scipy.optimize import nnls

        x, y, z = self._rays.T
        targets = self._pixels * self._scale - self._axis
        near = z > np.cos(np.radians(20.0))
        focals = [_slope(x[near] / z[near], targets[near, 0]), _slope(y[near] / z[near], targets[near, 1])]
        r = np.hypot(x, y) / z
        r_d = np.hypot(*(targets / np.maximum(focals, 1e-6)).T)
        powers = r[:, None] ** [2, 4, 6]
        terms = np.hstack([r[:, None] * powers, -r_d[:, None] * powers]) / (1 + r[:, None] ** 7)
        k1, k2, k3, k4, k5, k6 = nnls(terms, (r_d - r) / (1 + r**7))[0]
        distortion = [k1, k2, 0.0, 0.0, k3, k4, k5, k6]
        if "focal" in self._names:
            focals = [float(np.mean(focals))]
        return np.array([*focals, *self._axis, *distortion])

    def _residuals(self, x: Floats) -> Floats:
        """Return (2 N,) px; a ray that is not seen counts as one at the other end of the image."""
        off_px = self._project(x, self._rays) - self._pixels * self._scale
        return np.asarray(np.where(np.isfinite(off_px), off_px, _SCALED_PX).ravel())

    def _project(self, x: Floats, rays: Floats) -> Floats:
        """Return (N, 2) px of rays in the scaled image and beyond its sides; NaN if not seen."""
        try:
            camera = self._build(x, self._scale, margin=_SCALED_PX)
        except ArgumentError:  # the model refuses the numbers
            return np.full((len(rays), 2), np.nan)
        return camera.project(rays)[0] - _SCALED_PX

    def _build(self, x: Floats, scale: float, margin: int = 0) -> Camera:
        """Return the camera of fitted numbers with the original's image size times ``scale`` and a margin."""
        factor = scale / self._scale
        numbers = dict(zip(self._names, x.tolist(), strict=True))
        for name in {"fx", "fy", "focal", "cx", "cy"} & numbers.keys():
            numbers[name] = numbers[name] * factor + (margin if name in ("cx", "cy") else 0)
        width = max(1, round(self._camera.width * scale)) + 2 * margin
        height = max(1, round(self._camera.height * scale)) + 2 * margin
        return _create(self._model, width, height, numbers, factor)


def _slope(arguments: Floats, values: Floats) -> float:
    """Return the slope of the line through 0 that is nearest to points."""
    return float(values @ arguments / max(np.square(arguments).sum(), 1e-12))


def _create(model: str, width: int, height: int, numbers: dict[str, float], factor: float) -> Camera:
    """Return the camera of fitted numbers.

    Args:
        model: the lens.
        width: of the image, px.
        height: of the image, px.
        numbers: by name; of ``ftheta`` its coefficients from c2 on, of the scaled image in units of 0.01.
        factor: the size of the image over that of the scaled one.
    """
    if model == "ftheta":
        polynomial = [0.0, numbers["focal"], *(100 * factor * numbers[f"c{i}"] for i in range(2, 6))]
        return cameras.create(model, width, height, cx=numbers["cx"], cy=numbers["cy"], polynomial=polynomial)
    both = {"fx": numbers["focal"], "fy": numbers["focal"]} if "focal" in numbers else {}
    return camera_of(model, width, height, numbers | both)
