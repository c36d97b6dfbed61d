"""Calibrated lenses drawn over what is built and sold, and rays all around."""

import numpy as np

from omniscv import cameras

SIZE = {"width": 640, "height": 480}


def drawn_intrinsics(rng):
    """fx, fy, cx, cy of an image of ``SIZE``."""
    fx = rng.uniform(100, 300)
    return {
        "fx": fx,
        "fy": fx * rng.uniform(0.97, 1.03),
        "cx": rng.uniform(300, 340),
        "cy": rng.uniform(220, 260),
    }


def drawn_lens(name, rng, **more):
    """A camera of a model with drawn parameters; its domain ends in the image or does not."""
    focals = drawn_intrinsics(rng)
    tangential, prism = rng.uniform(-2e-3, 2e-3, 2).tolist(), rng.uniform(-2e-3, 2e-3, 4).tolist()
    k1, k2, k3 = rng.uniform((-0.3, -0.05, -0.01), (0.2, 0.1, 0.01)).tolist()
    skew = {"skew": rng.uniform(-0.02, 0.02)}
    match name:
        case "double-sphere":
            own = {**focals, **skew, "xi": 1 - 2 * rng.uniform(0, 0.95), "alpha": rng.uniform(0, 1)}
        case "extended-unified":
            own = {**focals, **skew, "alpha": rng.uniform(0, 1), "beta": np.exp(rng.uniform(-1, 1))}
        case "unified":
            distortion = (0.3 * k1, 0.1 * k2, *tangential)
            own = {**focals, **skew, "xi": rng.uniform(0, 2), "distortion": distortion}
        case "kannala-brandt":
            own = {**focals, **skew, "k": rng.uniform(-0.05, 0.05, 4) * (1, 0.4, 0.1, 0.02)}
        case "fisheye624":
            k = rng.uniform(-1, 1, 6) * (0.05, 0.05, 0.03, 0.01, 2e-3, 2e-4)
            own = {**focals, **skew, "k": k, "p": tangential, "s": prism}
        case "ftheta":
            by_angle = rng.uniform() < 0.5
            first = focals["fx"] if by_angle else 1 / focals["fx"]
            higher = rng.uniform(-1, 1, 4) * (0.02, 0.05, 0.02, 0.01)
            polynomial = first * np.array([0, 1, *higher])
            if not by_angle:
                polynomial[1:] *= focals["fx"] ** (-np.arange(5.0))
            own = {
                "cx": focals["cx"],
                "cy": focals["cy"],
                "polynomial": polynomial,
                "reference": "angle-to-pixel" if by_angle else "pixel-to-angle",
                "linear": (rng.uniform(0.97, 1.03), *rng.uniform(-0.01, 0.01, 2)),
            }
        case "pinhole":
            denominator = rng.uniform(-0.05, 0.3, 3) * (1, 0.2, 0.02)
            own = {**focals, **skew, "distortion": [k1, k2, *tangential, k3, *denominator, *prism]}
        case "division":
            own = {"focal": focals["fx"], "cx": focals["cx"], "cy": focals["cy"], "k": rng.uniform(-0.5, 0.3)}
    return cameras.create(name, **SIZE, **own, **more)


LENSES = (
    "double-sphere",
    "extended-unified",
    "unified",
    "kannala-brandt",
    "fisheye624",
    "ftheta",
    "pinhole",
    "division",
)
