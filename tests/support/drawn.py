"""Cameras and poses with drawn parameters: what an automatic size must hold for."""

import numpy as np

from omniscv import cameras
from omniscv.geometry import Pose

_LEAST = 0.8  # of the largest side
_MOST_DEG = {"equidistant": 360.0, "stereographic": 340.0, "orthographic": 180.0, "equisolid": 360.0}
"""By fisheye."""


def drawn_camera(name, rng, most_px=256):
    """A camera of a model, its parameters drawn over what is built and sold."""
    sizes = rng.integers(int(_LEAST * most_px), most_px, 2, endpoint=True)
    width, height = map(int, sizes)
    if name == "lidar":  # a channel a row
        elevations = np.linspace(1, -1, height) * rng.uniform(10, 60)
        return cameras.create(name, width=width, table={"elevation_deg": elevations.tolist()})
    return cameras.create(name, width=width, height=height, **_parameters(name, rng, width))


def drawn_pose(rng):
    """A pose in the middle of a room, in which the scenes have nothing, turned any way."""
    position = (*rng.uniform(-0.3, 0.3, 2), rng.uniform(1.2, 1.7))
    return Pose.from_angles(position, rng.uniform(-180, 180), rng.uniform(-70, 70), rng.uniform(-90, 90))


def drawn_pose_at_a_wall(scene, rng):
    """A pose 0.1 to 0.5 m from a wall of a room, turned any way."""
    corners = scene.room.corners
    wall = int(rng.integers(len(corners)))
    start = corners[wall]
    along = np.roll(corners, -1, axis=0)[wall] - corners[wall]
    inward = np.array([-along[1], along[0]]) / np.linalg.norm(along)  # corners run counterclockwise
    x, y = start + rng.uniform(0.1, 0.9) * along + rng.uniform(0.1, 0.5) * inward
    return Pose.from_angles((x, y, rng.uniform(0.3, 2.5)), *rng.uniform(-180, 180, 3))


def _parameters(name, rng, width):
    def between(low, high):
        return float(rng.uniform(low, high))

    def focals(least, most):
        fx = width * between(least, most)
        return {"fx": fx, "fy": fx * between(0.97, 1.03)}

    match name:
        case "equirectangular" | "octahedral" | "cube-map" | "equiangular-cube":
            return {}
        case "cylindrical":
            return {"fov_h_deg": between(90, 360), "fov_v_deg": between(40, 170)}
        case "pinhole":
            return {"fov_deg": float(np.exp(between(np.log(1), np.log(150))))}
        case "catadioptric-parabolic":
            return {"semi_latus_rectum": between(0.02, 1), "fov_deg": between(150, 330)}
        case "catadioptric-hyperbolic":
            latus = between(0.05, 0.6)
            distance = between(0.1, 1.5)
            return {"distance": distance, "semi_latus_rectum": latus, "focal": between(0.25, 0.6) * width}
        case "catadioptric-planar":
            return {"fov_deg": between(20, 150)}
        case "scaramuzza":
            scale = width / 384 * between(0.8, 1.3)
            powers = scale ** (1.0 - np.arange(5))
            terms = [-122.0, 0.0, 0.0021, -3e-6, 1.2e-8] * powers
            return {"coefficients": terms, "fov_deg": between(120, 190)}
        case "kannala-brandt":
            focals = focals(0.2, 0.5)
            k = (0.02, -0.008, 0.002, -0.0004)
            return {**focals, "k": k, "fov_deg": between(100, 185), "skew": between(-0.02, 0.02)}
        case "fisheye624":
            terms = {"p": rng.uniform(-1e-3, 1e-3, 2).tolist(), "s": rng.uniform(-1e-3, 1e-3, 4).tolist()}
            k = (-0.03, 0.09, -0.06, 0.015, -0.002, 1e-4)
            return {**focals(0.3, 0.5), "k": k, **terms, "fov_deg": between(100, 165)}
        case "ftheta":
            scaled = width * between(0.25, 0.5) * np.array([1, between(-0.02, 0.02), between(-0.04, 0.02)])
            return {"polynomial": [0.0, *scaled.tolist()], "max_angle_deg": between(50, 95)}
        case "double-sphere":
            shape = {**focals(0.25, 0.6), "xi": between(-0.3, 0.9)}
            return {**shape, "alpha": between(0.5, 0.7), "fov_deg": between(100, 200)}
        case "extended-unified":
            shape = {**focals(0.25, 0.6), "alpha": between(0.5, 0.8)}
            return {**shape, "beta": between(0.8, 1.5), "fov_deg": between(100, 190)}
        case "field-of-view":
            return {**focals(0.3, 0.5), "omega": between(0.4, 1.3)}
        case "unified":
            return {
                **focals(0.5, 0.8),
                "xi": between(0.5, 1.5),
                "distortion": (between(-0.1, 0.05), 0.01, *rng.uniform(-1e-3, 1e-3, 2).tolist()),
                "fov_deg": between(100, 190),
            }
        case "division":
            return {"focal": width * between(0.3, 0.8), "k": between(-0.3, -0.02)}
        case "ods" | "vr180":
            return {"interpupillary": between(0.05, 0.2), "eye": ("left", "right")[int(rng.integers(2))]}
        case "push-broom":
            return {"travel": (between(0.2, 2), between(-0.2, 0.2), 0.0), "fov_deg": between(40, 120)}
        case "orthographic":
            return {"width_m": between(0.2, 1.5)}
        case "rolling-shutter":
            return {
                "base": {"model": "fisheye-equidistant", "fov_deg": between(60, 200)},
                "readout": 0.03,
                "velocity": rng.uniform(-10, 10, 3),
                "angular_velocity_deg": rng.uniform(-300, 300, 3),
            }
        case "noncentral-panorama":
            return {"radius": between(0, 1.5)}
        case "noncentral-spherical-mirror":
            ball = {"mirror_radius": between(0.05, 0.4), "distance": between(0.1, 0.5)}
            return {**ball, "focal": between(0.3, 1.0) * width}
        case "noncentral-conical-mirror":
            cone = {"half_angle_deg": between(48, 65), "distance": between(0.1, 0.4)}
            return {**cone, "focal": between(0.3, 0.8) * width}
    return {"fov_deg": between(60, _MOST_DEG[name.removeprefix("fisheye-")])}
