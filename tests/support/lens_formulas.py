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


def extended_unified(camera, x, y, z):
    n = camera.alpha * mp.sqrt(camera.beta * (x**2 + y**2) + z**2) + (1 - mp.mpf(camera.alpha)) * z
    return by_focals(camera, x / n, y / n)


def unified(camera, x, y, z):
    """As OpenCV's omnidir has it, whose K[0, 1] is fx skew."""
    k1, k2, p1, p2 = map(mp.mpf, camera.distortion.tolist())
    length = mp.sqrt(x**2 + y**2 + z**2)
    xs, ys, zs = x / length, y / length, z / length
    xu, yu = xs / (zs + camera.xi), ys / (zs + camera.xi)
    r2 = xu**2 + yu**2
    radial = 1 + k1 * r2 + k2 * r2**2
    xd = xu * radial + 2 * p1 * xu * yu + p2 * (r2 + 2 * xu**2)
    yd = yu * radial + p1 * (r2 + 2 * yu**2) + 2 * p2 * xu * yu
    return camera.fx * xd + camera.fx * mp.mpf(camera.skew) * yd + camera.cx, camera.fy * yd + camera.cy


def kannala_brandt(camera, x, y, z):
    theta, cos_a, sin_a = polar(x, y, z)
    d = theta * (1 + sum(mp.mpf(k) * theta ** (2 * i + 2) for i, k in enumerate(camera.k.tolist())))
    return by_focals(camera, d * cos_a, d * sin_a)


def fisheye624(camera, x, y, z):
    theta, cos_a, sin_a = polar(x, y, z)
    r = theta * (1 + sum(mp.mpf(k) * theta ** (2 * i + 2) for i, k in enumerate(camera.k.tolist())))
    xr, yr, rd2 = r * cos_a, r * sin_a, r**2
    (p0, p1), (s0, s1, s2, s3) = map(mp.mpf, camera.p.tolist()), map(mp.mpf, camera.s.tolist())
    return by_focals(
        camera,
        xr + p0 * (2 * xr**2 + rd2) + 2 * p1 * xr * yr + s0 * rd2 + s1 * rd2**2,
        yr + p1 * (2 * yr**2 + rd2) + 2 * p0 * xr * yr + s2 * rd2 + s3 * rd2**2,
    )


def ftheta(camera, x, y, z):
    theta, cos_a, sin_a = polar(x, y, z)
    coefficients = list(map(mp.mpf, camera.polynomial.tolist()))

    def value(at):
        return sum(c * at**i for i, c in enumerate(coefficients))

    delta = value(theta)
    if camera.reference == "pixel-to-angle":
        high = mp.mpf(8)  # px: the first root, by steps and halves
        while value(high) < theta:
            high += 8
        low = high - 8
        for _ in range(60):
            middle = (low + high) / 2
            low, high = (middle, high) if value(middle) < theta else (low, middle)
        delta = low
    c, d, e = camera.linear.tolist()
    return camera.cx + delta * (c * cos_a + d * sin_a), camera.cy + delta * (e * cos_a + sin_a)


def pinhole(camera, x, y, z):
    return by_focals(camera, *opencv(x / z, y / z, [mp.mpf(k) for k in camera.distortion.tolist()]))


def field_of_view(camera, x, y, z):
    """As the paper has it, with the perspective radius; beyond 90 degrees its continuation."""
    theta, cos_a, sin_a = polar(x, y, z)
    w = mp.mpf(camera.omega)
    r = (mp.atan(2 * mp.tan(theta) * mp.tan(w / 2)) + (mp.pi if z < 0 else 0)) / w
    return by_focals(camera, r * cos_a, r * sin_a)


def division(camera, x, y, z):
    """x / z = x_d / (1 + k r_d^2): the smaller root r_d, which is the one that grows from the centre."""
    theta, cos_a, sin_a = polar(x, y, z)
    s, c, k = mp.sin(theta), mp.cos(theta), mp.mpf(camera.k)
    r = (c - mp.sqrt(c**2 - 4 * k * s**2)) / (2 * k * s)
    return camera.cx + camera.focal * r * cos_a, camera.cy + camera.focal * r * sin_a


FORMULAS = {
    "double-sphere": double_sphere,
    "extended-unified": extended_unified,
    "unified": unified,
    "kannala-brandt": kannala_brandt,
    "fisheye624": fisheye624,
    "ftheta": ftheta,
    "pinhole": pinhole,
    "division": division,
    "field-of-view": field_of_view,
}
