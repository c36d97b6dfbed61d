"""The nearest camera of one model to another camera: for programs that lack its model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import one_of, shown
from omniscv.calibration.intrinsics import MODELS, camera_of
from omniscv.cameras import Camera, create
from omniscv.errors import ArgumentError

Floats = NDArray[np.float64]
Values = Mapping[str, float]

_SCALED_PX = 256  # the longer side of the image in which the numbers are fitted: they are near 1 there
_GRID = 25  # rays across and down that are fitted
_MOST_RAYS = 1 << 20  # whose errors are measured
_STEPS = 60  # of least squares, at most
_PLACE = ("fx", "fy", "cx", "cy")
_ENDLESS = (-np.inf, np.inf)


@dataclass(frozen=True)
class _Family:
    """What is fitted of a model.

    Attributes:
        names: of the numbers, those of the place first.
        starts: values from which the fit may start, by name; 0 where not given.
        bounds: of numbers that the model limits.
        reach_deg: off the axis, up to which rays are fitted; beyond, the model loses its meaning.
    """

    names: tuple[str, ...]
    starts: Mapping[str, tuple[float, ...]]
    bounds: Mapping[str, tuple[float, float]]
    reach_deg: float = 180.0


def _family(names: str, starts: Mapping[str, tuple[float, ...]] | None = None, **others: object) -> _Family:
    bounds = others.pop("bounds", {})
    place = others.pop("place", _PLACE)
    return _Family((*place, *names.split()), starts or {}, bounds, **others)  # type: ignore[arg-type, misc]


_ONE_FOCAL = ("focal", "cx", "cy")
_ALPHA = (1e-6, 1 - 1e-6)
_FAMILIES: dict[str, _Family] = {
    "pinhole": _family("k1 k2 p1 p2 k3 k4 k5 k6", reach_deg=80.0),
    "kannala-brandt": _family("k1 k2 k3 k4"),
    "fisheye624": _family("k0 k1 k2 k3 k4 k5 p0 p1 s0 s1 s2 s3"),
    "unified": _family(
        "xi k1 k2 p1 p2", {"xi": (0.01, 0.5, 1.0, 1.5, 2.5)}, bounds={"xi": (-1 + 1e-6, 30.0)}
    ),
    "extended-unified": _family(
        "alpha beta",
        {"alpha": (0.1, 0.3, 0.5, 0.6, 0.75), "beta": (1.0,)},
        bounds={"alpha": _ALPHA, "beta": (1e-3, 1e3)},
    ),
    "double-sphere": _family(
        "xi alpha",
        {"xi": (-0.4, -0.2, 0.0, 0.5), "alpha": (0.2, 0.5, 0.6, 0.7)},
        bounds={"xi": (-1 + 1e-6, 1.0), "alpha": _ALPHA},
    ),
    "division": _family("k", {"k": (-0.5, -0.2, -0.05, 0.0)}, place=_ONE_FOCAL),
    "ftheta": _family("c2 c3 c4 c5", place=_ONE_FOCAL),
    "fisheye-equidistant": _family("", place=_ONE_FOCAL),
    "fisheye-stereographic": _family("", place=_ONE_FOCAL),
    "fisheye-orthographic": _family("", place=_ONE_FOCAL, reach_deg=90.0),
    "fisheye-equisolid": _family("", place=_ONE_FOCAL),
}


@dataclass(frozen=True)
class Fit:
    """A camera near another one.

    Attributes:
        camera: of the model that was wanted, with an image of the same size, without skew.
        max_px, rms_px: how far from each other the two see the same ray, over the rays that both see: the
            largest distance, and the root of the mean square.
        coverage: which part of the other camera's valid pixels these rays are.
    """

    camera: Camera
    max_px: float
    rms_px: float
    coverage: float


def models() -> list[str]:
    """Return the names of the models that can be fitted."""
    return list(_FAMILIES)


def fit(camera: Camera, model: str) -> Fit:
    """Return the camera of a model that sees a camera's rays nearest to where that does, in least squares.

    Rays that no camera of the model sees are left out, and for ``pinhole`` those more than 80 degrees off the
    axis, where tangents grow without end.

    Args:
        camera: a central camera that sees along +z.
        model: one of :func:`models`.

    Raises:
        ArgumentError: another model, a camera that is not central or does not see along +z, or one that sees
            next to nothing that the model can see.
    """
    family = _FAMILIES[one_of("model", model, _FAMILIES)]
    if not isinstance(camera, Camera) or not camera.central:
        got = camera.name if isinstance(camera, Camera) else shown(camera)
        raise ArgumentError(f"camera: expected a central one, all of whose rays meet in a point, got {got}")
    (axis,), (seen,) = camera.project([[0.0, 0.0, 1.0]])
    if not seen:
        raise ArgumentError(f"camera: expected one that sees along +z, as lenses do, got {shown(camera)}")
    focals = {getattr(camera, name, None) for name in ("fx", "fy")} - {None}
    if len(focals or {getattr(camera, "focal", None)} - {None}) == 1:
        one = (*_ONE_FOCAL, *(name for name in family.names if name not in (*_PLACE, "focal")))
        family = replace(family, names=one)
    fitting = _Fitting(camera, model, family, axis)
    return fitting.measured(fitting.solved())


class _Fitting:
    """A fit under way. Numbers are those of the image scaled to a longer side of 256 px."""

    def __init__(self, camera: Camera, model: str, family: _Family, axis: Floats) -> None:
        self._camera, self._model, self._family = camera, model, family
        self._scale = _SCALED_PX / max(camera.width, camera.height)
        self._axis = axis * self._scale
        u, v = np.linspace(0, camera.width, _GRID), np.linspace(0, camera.height, _GRID)
        self._pixels, self._rays = self._within_reach(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
        if len(self._rays) < 2 * len(family.names):
            wanted = f"at least {2 * len(family.names)} of {_GRID**2} rays that {model} can see"
            raise ArgumentError(f"camera: expected {wanted}, got {len(self._rays)}")

    def solved(self) -> Floats:
        """The numbers of least squares, from the best of the starts."""
        x = min(self._starts(), key=lambda x: float(np.square(self._residuals(x)).sum()))
        names = self._family.names
        shape = [i for i, name in enumerate(names) if name in (*_PLACE, "focal", *self._family.starts)]
        # The model without its distortion first: both together lie in a long valley.
        return self._refined(self._refined(x, shape) if x[len(shape) :].any() == 0 else x, range(len(names)))

    def _refined(self, x: Floats, free: Sequence[int]) -> Floats:
        """Numbers of least squares in which only some, by index, differ from ``x``."""
        from scipy.optimize import least_squares  # slow to load, and reading files does without

        free = list(free)
        bounds = np.array([self._family.bounds.get(self._family.names[i], _ENDLESS) for i in free]).T

        def whole(part: Floats) -> Floats:
            changed = x.copy()
            changed[free] = part
            return changed

        def residuals(part: Floats) -> Floats:
            return self._residuals(whole(part))

        low, high = bounds
        found = least_squares(
            residuals, x[free], bounds=(low, high), x_scale="jac",
            ftol=1e-13, xtol=1e-13, gtol=1e-15, max_nfev=_STEPS,
        )  # fmt: skip
        return whole(found.x)

    def measured(self, x: Floats) -> Fit:
        """The camera of fitted numbers, and its errors."""
        camera = self._camera
        step = max(1, int(np.ceil(np.sqrt(camera.width * camera.height / _MOST_RAYS))))
        u, v = np.arange(0.5, camera.width, step), np.arange(0.5, camera.height, step)
        pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
        everything = int(np.count_nonzero(camera.valid(pixels)))
        pixels, rays = self._within_reach(pixels)
        found = self._built(x, 1.0)
        both = found.valid(pixels)
        off = np.linalg.norm(self._seen(x, rays[both]) / self._scale - pixels[both], axis=-1)
        off = off[np.isfinite(off)]
        if not len(off):
            raise ArgumentError(f"camera: expected one that {self._model} can come near, got {shown(camera)}")
        return Fit(found, float(off.max()), float(np.sqrt(np.mean(off**2))), len(off) / everything)

    def _within_reach(self, pixels: Floats) -> tuple[Floats, Floats]:
        """Those of pixels (N, 2) that the camera sees, within the model's reach; their rays (N, 3)."""
        rays = self._camera.unproject(pixels)
        near = rays.valid & (rays.directions[:, 2] >= np.cos(np.radians(self._family.reach_deg)) - 1e-9)
        return pixels[near], rays.directions[near]

    def _starts(self) -> Iterator[Floats]:
        names = self._family.names
        place = {"fx": 100.0, "fy": 100.0, "focal": 100.0, "cx": self._axis[0], "cy": self._axis[1]}
        for values in product(*self._family.starts.values()):
            start = place | dict(zip(self._family.starts, values, strict=True))
            x = np.array([start.get(name, 0.0) for name in names])
            offsets = self._seen(x, self._rays) - self._axis
            wanted = self._pixels * self._scale - self._axis
            both = np.isfinite(offsets).all(axis=-1)
            ratio = (offsets[both] * wanted[both]).sum() / max(np.square(offsets[both]).sum(), 1e-12)
            if ratio > 0:
                x[[name in ("fx", "fy", "focal") for name in names]] *= ratio
            yield x
        if self._model == "pinhole":
            yield self._rational_start()

    def _rational_start(self) -> Floats:
        """OpenCV's radial terms, which are linear in ``r_d (1 + k4 r^2 + ...) = r (1 + k1 r^2 + ...)``, none
        of them below 0: so no denominator vanishes."""
        from scipy.optimize import nnls

        x, y, z = self._rays.T
        wanted = self._pixels * self._scale - self._axis
        near = z > np.cos(np.radians(20.0))
        focal = [
            float(wanted[near, i] @ (each / z)[near] / max(np.square((each / z)[near]).sum(), 1e-12))
            for i, each in enumerate((x, y))
        ]
        r, r_d = np.hypot(x, y) / z, np.hypot(*(wanted / np.maximum(focal, 1e-6)).T)
        powers = r[:, None] ** [2, 4, 6]
        terms = np.hstack([r[:, None] * powers, -r_d[:, None] * powers]) / (1 + r[:, None] ** 7)
        k1, k2, k3, k4, k5, k6 = nnls(terms, (r_d - r) / (1 + r**7))[0]
        found = [k1, k2, 0.0, 0.0, k3, k4, k5, k6]
        one = "focal" in self._family.names
        return np.array([*([np.mean(focal)] if one else focal), *self._axis, *found])

    def _residuals(self, x: Floats) -> Floats:
        """(2 N,) px; a ray that is not seen counts as one at the other end of the image."""
        off = self._seen(x, self._rays) - self._pixels * self._scale
        return np.asarray(np.where(np.isfinite(off), off, _SCALED_PX).ravel())

    def _seen(self, x: Floats, rays: Floats) -> Floats:
        """(N, 2) where rays are seen in the scaled image and beyond its sides; NaN where not."""
        try:
            camera = self._built(x, self._scale, margin=_SCALED_PX)
        except ArgumentError:  # numbers that the model refuses
            return np.full((len(rays), 2), np.nan)
        return camera.project(rays)[0] - _SCALED_PX

    def _built(self, x: Floats, scale: float, margin: int = 0) -> Camera:
        """The camera of fitted numbers, of an image of the original's size times ``scale`` and a margin."""
        factor = scale / self._scale
        numbers = dict(zip(self._family.names, x.tolist(), strict=True))
        for name in {"fx", "fy", "focal", "cx", "cy"} & numbers.keys():
            numbers[name] = numbers[name] * factor + (margin if name in ("cx", "cy") else 0)
        width, height = (
            max(1, round(size * scale)) + 2 * margin for size in (self._camera.width, self._camera.height)
        )
        return _made(self._model, width, height, numbers, factor)


def _made(model: str, width: int, height: int, numbers: dict[str, float], factor: float) -> Camera:
    if model in MODELS:
        both = {"fx": numbers["focal"], "fy": numbers["focal"]} if "focal" in numbers else {}
        return camera_of(model, width, height, numbers | both)
    if model == "ftheta":
        polynomial = [0.0, numbers["focal"], *(100 * factor * numbers[f"c{i}"] for i in range(2, 6))]
        given = {"cx": numbers["cx"], "cy": numbers["cy"], "polynomial": polynomial}
        return create(model, width, height, **given)  # type: ignore[arg-type]
    return create(model, width, height, focal=numbers["focal"], center=[numbers["cx"], numbers["cy"]])
