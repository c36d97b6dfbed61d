"""Mirrors as bodies: a camera ray meets a quadric and bounces off its normal, in 50 digits.

Nothing here knows the models' formulas. A quadric is ``X^T Q X = 0`` in homogeneous coordinates; the
normal is its gradient; the law of reflection is ``d - 2 (d.n) n``.
"""

import mpmath as mp
import numpy as np

DIGITS = 50


@mp.workdps(DIGITS)
def ball(radius, distance):
    """The quadric of a ball whose nearest point is ``distance`` from the camera."""
    radius, center = mp.mpf(radius), mp.mpf(distance) + mp.mpf(radius)
    return mp.matrix([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -center], [0, 0, -center, center**2 - radius**2]])


@mp.workdps(DIGITS)
def cone(half_angle_deg, distance):
    """The quadric of a (double) cone with its tip ``distance`` from the camera, opening along +z."""
    k, tip = mp.tan(mp.mpf(half_angle_deg) * mp.pi / 180) ** 2, mp.mpf(distance)
    return mp.matrix([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -k, k * tip], [0, 0, k * tip, -k * tip**2]])


@mp.workdps(DIGITS)
def reflect(quadric, distance, x, y):
    """The camera ray (x, y, 1) off the first hit with z >= distance: (hit, unit direction), or None.

    z >= distance keeps the half of the cone that opens away from the camera.
    """
    ray, start = mp.matrix([x, y, 1, 0]), mp.matrix([0, 0, 0, 1])
    a, b, c = _form(quadric, ray, ray), _form(quadric, ray, start), _form(quadric, start, start)
    square = b * b - a * c
    if square < 0:
        return None
    # Not divided by a, which is 0 where the ray is parallel to a cone's side.
    roots = [c / bottom for bottom in (-b + mp.sqrt(square), -b - mp.sqrt(square)) if bottom]
    ahead = [z for z in roots if z >= distance]
    if not ahead:
        return None
    hit = start + min(ahead) * ray
    normal, d = _unit((quadric * hit)[:3]), _unit(ray[:3])
    along = mp.fdot(d, normal)
    return [hit[i] for i in range(3)], [d[i] - 2 * along * normal[i] for i in range(3)]


def bounce(camera, pixel):
    """``reflect`` for a pixel of one of the mirror models."""
    x, y = ((np.asarray(pixel, dtype=float) - camera.center) / camera.focal).tolist()
    if camera.name == "noncentral-spherical-mirror":
        return reflect(ball(camera.mirror_radius, camera.distance), camera.distance, x, y)
    return reflect(cone(camera.half_angle_deg, camera.distance), camera.distance, x, y)


@mp.workdps(DIGITS)
def ray_errors(camera, pixel):
    """(angle, offset) of a valid pixel's ray from the reflected one.

    The angle between the directions, radians, and the distance of the origin from the true line over
    that of the camera from where the mirror was hit.
    """
    rays = camera.unproject(np.asarray(pixel))
    hit, truth = bounce(camera, pixel)
    d = _unit([mp.mpf(v) for v in rays.directions.tolist()])
    angle = mp.norm(_cross(d, truth)) if mp.fdot(d, truth) > 0 else mp.pi
    offset = [mp.mpf(v) - w for v, w in zip(rays.origins.tolist(), hit, strict=True)]
    return float(angle), float(mp.norm(_cross(offset, truth)) / mp.norm(mp.matrix(hit)))


def _form(quadric, left, right):
    return mp.fdot(left, quadric * right)


def _unit(vector):
    length = mp.norm(vector if isinstance(vector, mp.matrix) else mp.matrix(vector))
    return [v / length for v in vector]


def _cross(a, b):
    return mp.matrix([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
