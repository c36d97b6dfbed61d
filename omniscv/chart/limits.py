"""Approaches to the limits of every camera model, and the round-trip error along them.

Error: ``|project(point on the ray of p) - p|`` in px, the largest of a few dozen pixels p, while a parameter
or the pixels approach a limit: the remainder ``left`` falls from 1 to 1e-16.

Of every registered model the pixel approaches the last valid one, and a field of view the largest that is
accepted. ``_LIMITS`` has the limits that only some models have.
"""

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from omniscv import cameras
from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.geometry import Array

SIZE = 512  # px, of square images
AZIMUTHS = np.linspace(-np.pi, np.pi, 13)[1:] - 0.1

Pixels = Callable[[Camera, float], Array]
"""(N, 2) pixels of a camera, by what is left to the limit."""


def bisect(inside: Callable[[float], bool], low: float, high: float, steps: int) -> float:
    """Return the largest number between ``low``, inside, and ``high`` that is still ``inside``, by halving
    the interval ``steps`` times."""
    for _ in range(steps):
        middle = (low + high) / 2
        if inside(middle):
            low = middle
        else:
            high = middle
    return low


def last_radius(camera: Camera) -> float:
    """Return the largest valid radius along a row, px, without knowledge of the model."""

    def inside(radius: float) -> bool:
        return bool(camera.valid(np.add(camera.center, (radius, 0))))

    # The centre itself may be invalid, as the tip of a cone is.
    return SIZE / 2 if inside(SIZE / 2) else bisect(inside, 1e-12 * SIZE, SIZE / 2, 60)


def _at_radii(fractions: Callable[[float], Sequence[float]]) -> Pixels:
    """Return pixels at fractions of the last valid radius, in all directions from the centre."""
    along = np.stack([np.cos(AZIMUTHS), np.sin(AZIMUTHS)], axis=-1)

    def pixels(camera: Camera, left: float) -> Array:
        """Return the pixels (N, 2) of ``camera`` where ``left`` is left to the limit."""
        offsets = np.multiply.outer(fractions(left), along).reshape(-1, 2)
        return np.asarray(camera.center + last_radius(camera) * offsets)

    return pixels


everywhere = _at_radii(lambda left: (0.1, 0.5, 0.9, 1 - 1e-12))
edge = _at_radii(lambda left: (1 - left,))
tip = _at_radii(lambda left: (left,))


def edge_to_the_right(camera: Camera, left: float) -> Array:
    """Return one pixel (1, 2) of ``camera``, ``left`` of the radius from the last valid one, for borders that
    are not circles."""
    return np.asarray(camera.center + np.array([[last_radius(camera) * (1 - left), 0.0]]))


def row(fraction: Callable[[float], float]) -> Pixels:
    """Return pixels of a panorama in the row at a fraction of its height, with those of both borders."""
    u = SIZE * np.array([0, 0.1, 0.3, 0.5, 0.7, 0.9, 1])
    return lambda camera, left: np.stack([u, np.full_like(u, fraction(left) * camera.height)], axis=-1)


def _column(u: Callable[[float], float], *fractions: float) -> Pixels:
    """Return pixels of a column that approaches a border, at fractions of its height."""
    v = SIZE * np.array(fractions)
    return lambda camera, left: np.stack([np.full_like(v, u(left)), v], axis=-1)


towards_pole = row(lambda left: 0.5 * left)
towards_seam = _column(lambda left: SIZE * (1 - 0.5 * left), 0.1, 0.4, 0.5, 0.8)
edge_of_a_face = _column(lambda left: SIZE / 3 * (1 - left / 3), 0.3, 0.4, 0.5)  # of a strip, and a corner


@dataclass(frozen=True)
class Approach:
    """An approach to a limit.

    Attributes:
        limit: its name.
        camera: by what is left to the limit, from 1 to 0; less than 0 is beyond.
        pixels: that are tested.
        metres: distance of the points on their rays.
        past: what is left one step beyond the limit.
        known_px: error of the points themselves in float64, if more than 1e-6 px.
    """

    limit: str
    camera: Callable[[float], Camera]
    pixels: Pixels = everywhere
    metres: Callable[[float], float] = lambda left: 10.0
    past: float = -1e-12
    known_px: Callable[[Array], Array] | None = None

    def error_px(self, left: float) -> float:
        """Return the largest error of the round trip, px; NaN if no pixel is valid.

        A pixel whose point is not projected counts as the image's width.

        Args:
            left: what is left to the limit, from 1 to 0.
        """
        camera = self.camera(left)
        pixels = self.pixels(camera, left)
        rays = camera.unproject(pixels)
        if not rays.valid.any():
            return np.nan
        projected, seen = camera.project(rays.origins + self.metres(left) * rays.directions)
        error = np.abs(projected - pixels)
        borders = camera.unproject([(0, camera.height / 2), (camera.width, camera.height / 2)]).directions
        if np.allclose(borders[0], borders[1], rtol=0, atol=1e-9):  # the left and right borders meet
            error[:, 0] = np.minimum(error[:, 0], np.abs(camera.width - error[:, 0]))
        return float(np.where(seen[:, None], error, camera.width)[rays.valid].max())

    def beyond(self) -> str:
        """Return what the model does one step past the limit."""
        try:
            camera = self.camera(self.past)
        except ArgumentError:
            return "refused"
        return "in domain" if camera.valid(self.pixels(camera, self.past)).any() else "marked"


def create(name: str, **options: object) -> Camera:
    """Return a camera of the size of all."""
    return cameras.create(name, **{"width": SIZE, "height": SIZE, **options})  # type: ignore[arg-type]


# -- the limits of each model -------------------------------------------------------------------

BEYOND_THE_CONE = 1e14  # metres: the last ray meets the cone 1e12 times as far away as its tip
_KB: dict[str, Any] = {"fx": 160.0, "fy": 160.0, "cx": SIZE / 2, "cy": SIZE / 2}


def _far(left: float) -> float:
    """Return metres that grow to infinity."""
    return 10 / left


def _at_the_cone(left: float) -> float:
    """Return metres at which rays meet the cone."""
    return BEYOND_THE_CONE


def _beyond(left: float) -> float:
    """Return metres that grow to infinity beyond the cone."""
    return BEYOND_THE_CONE / left


Limit = Callable[[str], Approach]
"""Returns the approach of a model by its name."""


def _to(limit: str, pixels: Pixels = everywhere, *, metres: Any = None, **options: Any) -> Limit:
    """Return an approach to a limit: its name, pixels and metres; further options of :class:`Approach`, and
    parameters of the model, also functions of what is left."""
    fields: dict[str, Any] = {key: options.pop(key) for key in ("past", "known_px") if key in options}
    if metres is not None:
        fields["metres"] = metres

    def parameters(left: float) -> dict[str, Any]:
        values = dict(options)
        for key, value in options.items():
            if callable(value):
                values[key] = value(left)
        return values

    return lambda name: Approach(limit, lambda left: create(name, **parameters(left)), pixels, **fields)


def _up_to(limit: float) -> Callable[[float], float]:
    """Return a parameter that grows to a limit."""
    return lambda left: limit * (1 - left)


def _down_from(start: float) -> Callable[[float], float]:
    """Return a parameter that falls to 0."""
    return lambda left: start * left


_LIMITS: dict[str, list[Limit]] = {
    "equirectangular": [_to("row → pole", towards_pole), _to("column → ±180°", towards_seam)],
    "cylindrical": [
        _to("fov_v → 180°, perspective", fov_v_deg=_up_to(180), profile="perspective"),
        _to("fov_v → 180°, mercator", fov_v_deg=_up_to(180), profile="mercator"),
        _to("row → pole", towards_pole, fov_v_deg=180, profile="equal-area"),
    ],
    "fisheye-orthographic": [_to("r → f", edge, focal=200)],
    "fisheye-equisolid": [_to("r → f", edge, focal=200)],
    "scaramuzza": [
        # Rays are known to 1e-16 rad: to 1e-8 of the radius where two pixels see one ray.
        _to(
            "r → where the polynomial turns back", edge, coefficients=(-150, 0, 1e-3, 0, -2e-8),
            known_px=lambda left: np.minimum(1e-13 / left, 1e-8 * SIZE),
        ),
        _to("a0 → 0", coefficients=lambda left: (-150 * left, 0, 1e-3)),
    ],
    "kannala-brandt": [
        _to("θ → turn of d(θ)", edge, k=(-0.1, 0, 0, 0), **_KB),
        _to("θ → 180°", edge, k=(0, 0, 0, 0), **{**_KB, "fx": 80.0, "fy": 80.0}),
    ],
    "fisheye624": [
        _to("θ → turn of r(θ)", edge, k=(-0.1, 0, 0, 0, 0, 0), **_KB),
        _to("r → turn of the distortion", edge_to_the_right, p=(2e-3, 0), s=(-0.2, 0, 0.1, 0), **_KB),
    ],
    "ftheta": [
        _to("θ → turn of f(θ)", edge, polynomial=(0, 150, 0, -15)),
        _to("r → turn of g(r)", edge, polynomial=(0, 1e-2, 0, -8e-8), reference="pixel-to-angle"),
    ],
    "double-sphere": [
        _to("r → fold of n", edge, xi=0.5, alpha=0.9, **_KB),
        _to("ξ → −1", xi=lambda left: left - 1, alpha=0.4, **_KB),
        _to("ξ → 1", xi=_up_to(1.0), alpha=0.6, **_KB),
        _to("α → 1/2", edge, xi=0.2, alpha=lambda left: 0.5 + 0.5 * left, **_KB),
        _to("α → 1", alpha=_up_to(1.0), xi=0.2, **_KB),
    ],
    "extended-unified": [
        _to("r → fold of n", edge, alpha=0.9, beta=1.2, **_KB),
        _to("β → 0", beta=_down_from(1.0), alpha=0.6, **_KB),
        _to("β → ∞", alpha=0.6, beta=lambda left: 1 / left, **_KB),
        _to("α → 1", alpha=_up_to(1.0), beta=1.2, **_KB),
    ],
    "unified": [
        _to("r → turn of the distortion", edge_to_the_right, distortion=(-0.2, 0, 1e-3, 2e-3), xi=1.2, **_KB),
        _to("r → fold, ξ > 1", edge, xi=1.6, **_KB),
        _to("ξ → 1 from above", edge, xi=lambda left: 1 + left, **_KB),
        _to("ξ → −1", xi=lambda left: left - 1, **_KB),
    ],
    "division": [
        _to("r → where the ray turns back", edge, focal=160.0, k=0.8),
        _to("k → −∞", focal=160.0, k=lambda left: -1 / left),
    ],
    "field-of-view": [
        _to("r → π / ω", edge, omega=0.9, **_KB),
        _to("ω → 0", omega=_down_from(1.0), **_KB),
        _to("ω → π", omega=_up_to(np.pi), **_KB),
    ],
    "pinhole": [
        _to("r → turn of the distortion", edge_to_the_right, distortion=(-0.3, 0.01, 1e-3, -2e-3), **_KB),
        _to("r → pole of the distortion", distortion=(0, 0, 0, 0, 0, -0.3, 0, 0), **_KB),
    ],
    "catadioptric-parabolic": [
        _to("2p → 0", semi_latus_rectum=_down_from(1.0)),
        _to("2p → ∞", semi_latus_rectum=lambda left: 1 / left),
    ],
    "catadioptric-hyperbolic": [
        _to("2p → 0", semi_latus_rectum=_down_from(1.0), distance=1.0),
        _to("d → 0", distance=_down_from(1.0), semi_latus_rectum=0.5),
        _to("r → hyperboloid's edge", edge, distance=1.0, semi_latus_rectum=0.5, focal=100),
    ],
    "cube-map": [_to("pixel → edge of a face", edge_of_a_face, layout="strip")],
    "equiangular-cube": [_to("pixel → edge of a face", edge_of_a_face, layout="strip")],
    "octahedral": [_to("column → ±180°", towards_seam)],
    "ods": [
        # The ray is tangent to the circle: its origin is known to the root of the rounding error.
        _to(
            "row → pole", towards_pole, interpupillary=0.064,
            known_px=lambda left: np.minimum(4e-16 * 0.032 / (10 * left), 3e-8) * SIZE,
        ),
        _to("b → 0", interpupillary=_down_from(1.0)),
    ],
    "push-broom": [_to("T → 0", travel=lambda left: (left, 0, 0))],
    "orthographic": [_to("w → 0", width_m=_down_from(1.0))],
    "rolling-shutter": [
        _to(
            "turn → 45° while the image is read", base={"model": "fisheye-equidistant", "fov_deg": 150},
            readout=0.1, angular_velocity_deg=lambda left: (100, 200, 450 * (1 - left)),
        )
    ],
    "noncentral-panorama": [
        _to("row → pole", towards_pole, radius=1.0),
        _to(
            "R → ∞ (points 10 m away)", row(lambda left: 0.3), radius=_far,
            known_px=lambda left: 4e-16 / left * SIZE / np.pi,
        ),
    ],
    "noncentral-conical-mirror": [
        _to("r → tan τ", edge, metres=_far, half_angle_deg=40, distance=0.3),
        _to("r → 0, the tip", tip, past=0.0, half_angle_deg=60, distance=0.3),
        _to("τ → 45°", metres=_at_the_cone, half_angle_deg=_up_to(45), distance=0.3),
        _to("τ → 90°, a plane", metres=_at_the_cone, half_angle_deg=_up_to(90), distance=0.3),
        _to("τ → 0, a needle", metres=_beyond, half_angle_deg=_down_from(60), distance=0.3),
    ],
    "noncentral-spherical-mirror": [
        _to("Z_m → 0", distance=_down_from(0.5), mirror_radius=0.5),
        _to("Z_m → ∞", metres=_far, mirror_radius=0.5, distance=lambda left: 0.5 / left),
    ],
}  # fmt: skip


def approaches(name: str) -> list[Approach]:
    """Return the approaches of any registered model, and the further ones of this model."""
    cls = cameras.model(name)
    ways = [Approach("pixel → last valid one", lambda left: cls.example(SIZE), edge, _metres(cls))]
    for key in inspect.signature(cls).parameters:
        if key.startswith("fov_"):
            ways.append(_widest(cls, key))
    ways += [limit(name) for limit in _LIMITS.get(name, [])]
    return ways


def _widest(cls: type[Camera], key: str) -> Approach:
    """Return the approach of a field of view to the largest that is accepted, by bisection."""

    def accepts(degrees: float) -> bool:
        try:
            _with_field_of_view(cls, key, degrees)
        except ArgumentError:
            return False
        return True

    start = next(degrees for degrees in range(60, 360, 10) if accepts(degrees))
    limit = bisect(accepts, float(start), 1000.0, 80)
    return Approach(
        f"{key.removesuffix('_deg')} → {limit:.6g}°",
        lambda left: _with_field_of_view(cls, key, limit - (limit - start) * left),
        metres=_metres(cls),
    )


def _metres(cls: type[Camera]) -> Callable[[float], float]:
    """Return the distance of points on rays: 10 m, of cameras with several centres ever more."""
    return (lambda left: 10.0) if cls.central else _beyond


def _with_field_of_view(cls: type[Camera], key: str, degrees: float) -> Camera:
    """Return the model's example with a field of view."""
    description = {**cls.example(SIZE).to_dict(), key: degrees}
    focal = inspect.signature(cls).parameters.get("focal")
    if focal is not None and focal.default is None:  # the other way to give the same number
        description.pop("focal", None)
    return cameras.from_dict(description)
