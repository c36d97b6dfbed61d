"""The limits of every camera model: those that only some have, and those that any may have.

Of every registered model the pixel runs to the last valid one, and a field of view to the largest that is
accepted; ``MORE`` has the limits that only some models have.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable

import numpy as np

from omniscv import cameras
from omniscv.cameras import Camera
from omniscv.chart.approach import (
    SIZE,
    Approach,
    at_the_edge_of_a_face,
    create,
    edge,
    edge_to_the_right,
    fan,
    parameter,
    rows,
    towards_pole,
    towards_seam,
    vanishing,
)
from omniscv.errors import ArgumentError

CONE = "noncentral-conical-mirror"
BALL = "noncentral-spherical-mirror"
BEYOND_THE_CONE = 1e14  # metres: the last ray meets it 1e12 times as far away as its tip
KB = {"fx": 160.0, "fy": 160.0, "cx": SIZE / 2, "cy": SIZE / 2}

MORE: dict[str, list[Approach]] = {
    "equirectangular": [towards_pole("equirectangular"), towards_seam("equirectangular")],
    "cylindrical": [
        parameter("cylindrical", "fov_v_deg", 180, "fov_v → 180°, perspective", profile="perspective"),
        parameter("cylindrical", "fov_v_deg", 180, "fov_v → 180°, mercator", profile="mercator"),
        towards_pole("cylindrical", fov_v_deg=180, profile="equal-area"),
    ],
    "fisheye-orthographic": [Approach("r → f", lambda left: create("fisheye-orthographic", focal=200), edge)],
    "fisheye-equisolid": [Approach("r → f", lambda left: create("fisheye-equisolid", focal=200), edge)],
    "scaramuzza": [
        Approach(
            "r → where the polynomial turns back",
            lambda left: create("scaramuzza", coefficients=(-150, 0, 1e-3, 0, -2e-8)),
            edge,
            # A ray is known to 1e-16 rad; where two pixels come to see one ray, that is 1e-8 of the radius.
            known_px=lambda left: np.minimum(1e-13 / left, 1e-8 * SIZE),
        ),
        Approach("a0 → 0", lambda left: create("scaramuzza", coefficients=(-150 * left, 0, 1e-3))),
    ],
    "kannala-brandt": [
        Approach("θ → turn of d(θ)", lambda left: create("kannala-brandt", k=(-0.1, 0, 0, 0), **KB), edge),
        Approach(
            "θ → 180°",
            lambda left: create("kannala-brandt", k=(0, 0, 0, 0), **{**KB, "fx": 80.0, "fy": 80.0}),
            edge,
        ),
    ],
    "fisheye624": [
        Approach("θ → turn of r(θ)", lambda left: create("fisheye624", k=(-0.1, 0, 0, 0, 0, 0), **KB), edge),
        Approach(
            "r → turn of the distortion",
            lambda left: create("fisheye624", k=(0,) * 6, p=(2e-3, 0), s=(-0.2, 0, 0.1, 0), **KB),
            edge_to_the_right,
        ),
    ],
    "ftheta": [
        Approach("θ → turn of f(θ)", lambda left: create("ftheta", polynomial=(0, 150, 0, -15)), edge),
        Approach(
            "r → turn of g(r)",
            lambda left: create("ftheta", polynomial=(0, 1e-2, 0, -8e-8), reference="pixel-to-angle"),
            edge,
        ),
    ],
    "double-sphere": [
        Approach("r → fold of n", lambda left: create("double-sphere", xi=0.5, alpha=0.9, **KB), edge),
        Approach("ξ → −1", lambda left: create("double-sphere", xi=left - 1, alpha=0.4, **KB)),
        parameter("double-sphere", "xi", 1.0, "ξ → 1", alpha=0.6, **KB),
        Approach("α → 1/2", lambda left: create("double-sphere", xi=0.2, alpha=0.5 + 0.5 * left, **KB), edge),
        parameter("double-sphere", "alpha", 1.0, "α → 1", xi=0.2, **KB),
    ],
    "extended-unified": [
        Approach("r → fold of n", lambda left: create("extended-unified", alpha=0.9, beta=1.2, **KB), edge),
        vanishing("extended-unified", "beta", 1.0, "β → 0", alpha=0.6, **KB),
        Approach("β → ∞", lambda left: create("extended-unified", alpha=0.6, beta=1 / left, **KB)),
        parameter("extended-unified", "alpha", 1.0, "α → 1", beta=1.2, **KB),
    ],
    "unified": [
        Approach(
            "r → turn of the distortion",
            lambda left: create("unified", distortion=(-0.2, 0, 1e-3, 2e-3), xi=1.2, **KB),
            edge_to_the_right,
        ),
        Approach("r → fold, ξ > 1", lambda left: create("unified", xi=1.6, **KB), edge),
        Approach("ξ → 1 from above", lambda left: create("unified", xi=1 + left, **KB), edge),
        Approach("ξ → −1", lambda left: create("unified", xi=left - 1, **KB)),
    ],
    "division": [
        Approach("r → where the ray turns back", lambda left: create("division", focal=160.0, k=0.8), edge),
        Approach("k → −∞", lambda left: create("division", focal=160.0, k=-1 / left)),
    ],
    "pinhole": [
        Approach(
            "r → turn of the distortion",
            lambda left: create("pinhole", distortion=(-0.3, 0.01, 1e-3, -2e-3), **KB),
            edge_to_the_right,
        ),
        Approach(
            "r → pole of the distortion",
            lambda left: create("pinhole", distortion=(0, 0, 0, 0, 0, -0.3, 0, 0), **KB),
        ),
    ],
    "catadioptric-parabolic": [
        vanishing("catadioptric-parabolic", "semi_latus_rectum", 1.0, "2p → 0"),
        Approach("2p → ∞", lambda left: create("catadioptric-parabolic", semi_latus_rectum=1 / left)),
    ],
    "catadioptric-hyperbolic": [
        vanishing("catadioptric-hyperbolic", "semi_latus_rectum", 1.0, "2p → 0", distance=1.0),
        vanishing("catadioptric-hyperbolic", "distance", 1.0, "d → 0", semi_latus_rectum=0.5),
        Approach(
            "r → hyperboloid's edge",
            lambda left: create("catadioptric-hyperbolic", distance=1.0, semi_latus_rectum=0.5, focal=100),
            edge,
        ),
    ],
    "cube-map": [at_the_edge_of_a_face("cube-map")],
    "equiangular-cube": [at_the_edge_of_a_face("equiangular-cube")],
    "octahedral": [towards_seam("octahedral")],
    "ods": [
        Approach(
            "row → pole",
            lambda left: create("ods", interpupillary=0.064),
            rows(lambda left: 0.5 * left),
            # The ray touches the circle: where it comes off it is known to the root of a rounding.
            known_px=lambda left: np.minimum(4e-16 * 0.032 / (10 * left), 3e-8) * SIZE,
        ),
        vanishing("ods", "interpupillary", 1.0, "b → 0"),
    ],
    "push-broom": [Approach("T → 0", lambda left: create("push-broom", travel=(left, 0, 0)))],
    "orthographic": [vanishing("orthographic", "width_m", 1.0, "w → 0")],
    "rolling-shutter": [
        Approach(
            "turn → 45° while the image is read",
            lambda left: create(
                "rolling-shutter",
                base={"model": "fisheye-equidistant", "fov_deg": 150},
                readout=0.1,
                angular_velocity_deg=(100, 200, 450 * (1 - left)),
            ),
        ),
    ],
    "noncentral-panorama": [
        towards_pole("noncentral-panorama", radius=1.0),
        Approach(
            "R → ∞ (points 10 m away)",
            lambda left: create("noncentral-panorama", radius=10 / left),
            rows(lambda left: 0.3),
            known_px=lambda left: 4e-16 / left * SIZE / np.pi,
        ),
    ],
    CONE: [
        Approach(
            "r → tan τ",
            lambda left: create(CONE, half_angle_deg=40, distance=0.3),
            edge,
            lambda left: 10 / left,
        ),
        Approach(
            "r → 0, the tip",
            lambda left: create(CONE, half_angle_deg=60, distance=0.3),
            lambda camera, left: fan(camera, np.array([left])),
            past=0.0,
        ),
        parameter(CONE, "half_angle_deg", 45, "τ → 45°", BEYOND_THE_CONE, distance=0.3),
        parameter(CONE, "half_angle_deg", 90, "τ → 90°, a plane", BEYOND_THE_CONE, distance=0.3),
        Approach(
            "τ → 0, a needle",
            lambda left: create(CONE, half_angle_deg=60 * left, distance=0.3),
            metres=lambda left: BEYOND_THE_CONE / left,
        ),
    ],
    BALL: [
        vanishing(BALL, "distance", 0.5, "Z_m → 0", mirror_radius=0.5),
        Approach(
            "Z_m → ∞",
            lambda left: create(BALL, mirror_radius=0.5, distance=0.5 / left),
            metres=lambda left: 10 / left,
        ),
    ],
}


def approaches(name: str) -> list[Approach]:
    """The ways into the limits of any registered model, and the further ones of this model."""
    cls = cameras.model(name)
    found = [Approach("pixel → last valid one", lambda left: cls.example(SIZE), edge, _metres(cls))]
    fields = [key for key in inspect.signature(cls).parameters if key.startswith("fov_")]
    return [*found, *(widest(cls, key) for key in fields), *MORE.get(name, [])]


def widest(cls: type[Camera], key: str) -> Approach:
    """A field of view that grows to the largest that is accepted."""
    start, limit = accepted_range(cls, key)
    return Approach(
        f"{key.removesuffix('_deg')} → {limit:.6g}°",
        lambda left: with_field_of_view(cls, key, limit - (limit - start) * left),
        metres=_metres(cls),
    )


def _metres(cls: type[Camera]) -> Callable[[float], float]:
    return (lambda left: 10.0) if cls.central else (lambda left: BEYOND_THE_CONE / left)


def accepted_range(cls: type[Camera], key: str) -> tuple[float, float]:
    """A field of view, degrees, that the model's example may have, and the largest, by bisection."""
    start = next(degrees for degrees in range(60, 360, 10) if accepts(cls, key, degrees))
    low, high = float(start), 1000.0
    for _ in range(80):
        middle = (low + high) / 2
        low, high = (middle, high) if accepts(cls, key, middle) else (low, middle)
    return start, low


def accepts(cls: type[Camera], key: str, degrees: float) -> bool:
    """Whether the model's example may have a field of view."""
    try:
        with_field_of_view(cls, key, degrees)
    except ArgumentError:
        return False
    return True


def with_field_of_view(cls: type[Camera], key: str, degrees: float) -> Camera:
    """The model's example with a field of view."""
    described = {**cls.example(SIZE).to_dict(), key: degrees}
    focal = inspect.signature(cls).parameters.get("focal")
    if focal is not None and focal.default is None:  # a second way to give the same number
        described.pop("focal", None)
    return cameras.from_dict(described)
