"""Calibrated lenses by their published formulas, in mpmath: from points to pixels, as each is written."""

import mpmath as mp
import numpy as np


def polar(x, y, z):
    rho = mp.hypot(x, y)
    return mp.atan2(rho, z), x / rho, y / rho


def opencv(x, y, k):
    """The distortion of OpenCV's documentation, calib3d."""
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = k
    r2 = x**2 + y**2
    c = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    u = x * c + 2 * p1 * x * y + p2 * (r2 + 2 * x**2) + s1 * r2 + s2 * r2**2
    v = y * c + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y + s3 * r2 + s4 * r2**2
    return np.array([u, v])


def by_focals(camera, x, y):
    return camera.cx + camera.fx * (x + camera.skew * y), camera.cy + camera.fy * y


def double_sphere(camera, x, y, z):
    d1 = mp.sqrt(x**2 + y**2 + z**2)
    shifted = camera.xi * d1 + z
    d2 = mp.sqrt(x**2 + y**2 + shifted**2)
    n = camera.alpha * d2 + (1 - mp.mpf(camera.alpha)) * shifted
    return by_focals(camera, x / n, y / n)


def kannala_brandt(camera, x, y, z):
    theta, cos_a, sin_a = polar(x, y, z)
    d = theta * (1 + sum(mp.mpf(k) * theta ** (2 * i + 2) for i, k in enumerate(camera.k.tolist())))
    return by_focals(camera, d * cos_a, d * sin_a)


def pinhole(camera, x, y, z):
    return by_focals(camera, *opencv(x / z, y / z, [mp.mpf(k) for k in camera.distortion.tolist()]))


FORMULAS = {"double-sphere": double_sphere, "kannala-brandt": kannala_brandt, "pinhole": pinhole}
