"""Cameras for the contract suite: each model's own example, and those at the ends of its parameters."""

import inspect
from typing import Any

from omniscv import cameras

WIDE = {"width": 96, "height": 48}
ROUND = {"width": 61, "height": 61}
LONG = {"width": 80, "height": 45}
TINY = {"width": 17, "height": 11}
"""Where a projection takes an iteration of its own for each point."""


def moving(base, scan, readout, velocity, turn, **options):
    """A rolling shutter on a camera that moves, m/s, and turns, degrees a second."""
    motion = {"readout": readout, "velocity": velocity, "angular_velocity_deg": turn, "scan": scan}
    return {**TINY, "base": {"model": base, **options}, **motion}


EXAMPLES: dict[str, list[dict[str, Any]]] = {
    "equirectangular": [WIDE, {"width": 45, "height": 33}],
    "cylindrical": [
        {**LONG, "fov_h_deg": 200, "fov_v_deg": 179},
        {**LONG, "fov_v_deg": 180},
        {**WIDE, "fov_h_deg": 360, "fov_v_deg": 170, "profile": "perspective"},
        {**ROUND, "fov_v_deg": 2 * 85.051, "profile": "mercator"},
        {**WIDE, "fov_v_deg": 180, "profile": "miller"},
        {**LONG, "fov_h_deg": 200, "fov_v_deg": 180, "profile": "equal-area"},
    ],
    "cube-map": [{**LONG, "layout": "strip"}, {**ROUND, "layout": "cross"}],
    "equiangular-cube": [LONG],
    "octahedral": [LONG],
    "fisheye-equidistant": [{**LONG, "fov_deg": 185}, {**ROUND, "fov_deg": 360}],
    "fisheye-stereographic": [{**LONG, "fov_deg": 220}, {**ROUND, "fov_deg": 359.9}],
    "fisheye-orthographic": [{**LONG, "fov_deg": 90}, {**ROUND, "focal": 22.5}],
    "fisheye-equisolid": [{**LONG, "fov_deg": 240}, {**ROUND, "fov_deg": 360}],
    "catadioptric-parabolic": [
        {**LONG, "semi_latus_rectum": 0.03, "focal": 300.0},
        {**ROUND, "fov_deg": 359.9},
    ],
    "catadioptric-hyperbolic": [
        {**LONG, "distance": 0.1, "semi_latus_rectum": 0.2, "focal": 40.0},
        {**ROUND, "distance": 3.0, "semi_latus_rectum": 0.1, "fov_deg": 200},
    ],
    "catadioptric-planar": [{**LONG, "focal": 12.0}, {**ROUND, "fov_deg": 175}],
    "scaramuzza": [
        {**LONG, "coefficients": [-20.0, 0.0, 0.012, -1e-5, 3e-6]},
        {**LONG, "coefficients": [-25.0, 0, 0.01], "affine": (1.02, 0.004, -0.003), "center": (43, 21)},
        {**ROUND, "coefficients": [-20.0, 0.0, 0.012, -1e-5, 3e-6], "fov_deg": 120},
        {**ROUND, "coefficients": [-30.0]},
    ],
    "kannala-brandt": [
        {**LONG, "fx": 19.0, "fy": 20.0, "k": [0.02, -0.008, 0.002, -0.0004]},
        {**LONG, "fx": 25.0, "fy": 24.0, "cx": 41.5, "cy": 20.0, "k": [-0.1, 0, 0, 0]},
        {**ROUND, "fx": 9.0, "fy": 9.0},
        {**ROUND, "fx": 17.0, "fy": 17.0, "fov_deg": 185, "skew": 0.03},
    ],
    "noncentral-panorama": [{**WIDE, "radius": 0.0}, {**LONG, "radius": 0.5}],
    "ods": [{**WIDE, "interpupillary": 0.5, "eye": "right"}, {**LONG, "interpupillary": 0.0}],
    "vr180": [{**LONG, "interpupillary": 0.2, "eye": "right"}],
    "lidar": [
        {**LONG, "preset": "vlp-16"},
        {"width": 64, "preset": "os1-128"},
        {**WIDE, "preset": "hdl-32e"},
    ],
    "push-broom": [{**LONG, "travel": (0.5, 0.1, -0.2), "focal": 30.0}],
    "orthographic": [{**LONG, "width_m": 0.3, "center": (10, 40)}],
    "rolling-shutter": [
        {**LONG, "base": {"model": "fisheye-equidistant"}, "readout": 0.0, "velocity": (1, 2, 3)},
        moving("fisheye-stereographic", "bottom-to-top", 0.05, (1, -2, 0.5), (100, -200, 50), fov_deg=200),
        moving("lidar", "left-to-right", 0.05, (0, 0, 1), (0, 20, 0), preset="vlp-16"),
    ],
    "noncentral-spherical-mirror": [
        {**ROUND, "mirror_radius": 0.5, "distance": 0.3},
        {**LONG, "mirror_radius": 0.1, "distance": 0.4, "fov_deg": 300},
    ],
    "noncentral-conical-mirror": [
        {**ROUND, "half_angle_deg": 55, "distance": 0.3},
        {**LONG, "half_angle_deg": 60, "distance": 0.2, "mirror_radius": 0.15},
    ],
    "fisheye624": [
        {**LONG, "fx": 20.0, "fy": 21.0, "k": [-0.03, 0.09, -0.06, 0.015, -0.002, 1e-4], "skew": 0.02},
        {**LONG, "fx": 14.0, "fy": 14.0, "p": [4e-3, -6e-3], "s": [-3e-3, 1e-3, 2e-3, 5e-4]},
    ],
    "ftheta": [
        {**LONG, "polynomial": [0, 0.05, 0, 2e-5], "reference": "pixel-to-angle", "linear": (1.02, 0.01, 0)},
        {**LONG, "polynomial": [0, 25.0, 0, -3.0], "cx": 41.0, "cy": 20.0},
        {**ROUND, "polynomial": [0, 9.7]},
    ],
    "double-sphere": [
        {**LONG, "fx": 20.0, "fy": 21.0, "xi": 0.9, "alpha": 0.65, "skew": -0.01},
        {**LONG, "fx": 8.0, "fy": 8.0, "xi": -0.9, "alpha": 0.5},
        {**ROUND, "fx": 12.0, "fy": 12.0, "xi": 1.0, "alpha": 0.0},
        {**ROUND, "fx": 25.0, "fy": 25.0, "xi": 1.0, "alpha": 0.9},
    ],
    "extended-unified": [
        {**LONG, "fx": 20.0, "fy": 21.0, "alpha": 0.3, "beta": 3.0, "skew": 0.01},
        {**ROUND, "fx": 12.0, "fy": 12.0, "alpha": 0.9, "beta": 0.3},
        {**ROUND, "fx": 12.0, "fy": 12.0, "alpha": 0.5, "beta": 1.0, "fov_deg": 300},
    ],
    "unified": [
        {**LONG, "fx": 30.0, "fy": 31.0, "xi": 1.5, "distortion": [-0.1, 0.02, 1e-3, 2e-3], "skew": 0.01},
        {**ROUND, "fx": 20.0, "fy": 20.0, "xi": 1.0},
        {**LONG, "fx": 30.0, "fy": 30.0, "xi": 0.8, "distortion": [-0.4, 0, 0, 0], "cx": 41.0},
    ],
    "division": [
        {**LONG, "focal": 30.0, "k": 0.4, "cx": 41.0},
        {**ROUND, "focal": 9.0, "k": -0.4, "fov_deg": 320},
    ],
    "field-of-view": [
        {**LONG, "fx": 20.0, "fy": 21.0, "omega": 1.2, "skew": 0.01},
        {**ROUND, "fx": 12.0, "fy": 12.0, "omega": 0.4, "fov_deg": 300},
    ],
    "pinhole": [
        LONG,
        {**LONG, "focal": 30.0, "center": (10, 40)},
        {**ROUND, "fov_deg": 175},
        {**LONG, "fx": 40.0, "fy": 41.0, "skew": 0.02, "distortion": [-0.3, 0.1, 1e-3, -2e-3], "fov_deg": 90},
        {**LONG, "fx": 30.0, "fy": 30.0, "distortion": [-0.4, 0, 0, 0, 0]},
        {
            **LONG,
            **{"fx": 35.0, "fy": 36.0, "cx": 41.0, "cy": 20.0},
            "distortion": [0.2, -0.05, 2e-3, -3e-3, 0.01, 0.3, -0.06, 0.02, 4e-3, -1e-3, -5e-3, 2e-3],
        },
    ],
}


def example_cameras(central_only: bool = False) -> dict[str, cameras.Camera]:
    """Return cameras of every registered model: its own example, and those above."""
    examples = {}
    for name in cameras.names():
        if central_only and not cameras.model(name).central:
            continue
        examples[f"{name}-example"] = cameras.model(name).example(32 if name == "rolling-shutter" else 64)
        for i, parameters in enumerate(EXAMPLES.get(name, ())):
            examples[f"{name}-{i}"] = cameras.create(name, **parameters)
    return examples


def changed(camera: cameras.Camera, **arguments: Any) -> cameras.Camera:
    """Return the camera with other arguments; models without ``center`` ignore it, None is its default."""
    center = arguments.pop("center", camera.center.tolist())
    keys = takes_center(camera.name)
    centers = (
        {"center": center} if keys == ("center",) else dict(zip(keys, center or (None, None), strict=False))
    )
    described = {**camera.to_dict(), **arguments, **centers}
    return cameras.from_dict({key: value for key, value in described.items() if value is not None})


def takes_center(name: str) -> tuple[str, ...]:
    """Return the constructor's parameters for the centre: ("center",), ("cx", "cy") or ()."""
    taken = inspect.signature(cameras.model(name)).parameters
    return ("center",) if "center" in taken else tuple(key for key in ("cx", "cy") if key in taken)
