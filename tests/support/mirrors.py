"""Mirrors as bodies: a camera ray meets a quadric and bounces off its normal, in 50 digits.

Nothing here knows the models' formulas. A quadric is ``X^T Q X = 0`` in homogeneous coordinates; the normal
is its gradient; the law of reflection is ``d - 2 (d.n) n``. The central ones, with q the semi latus rectum,
which gives each surface its size, and the point where all rays seem to meet, a focus, at the origin:

- paraboloid ``x^2 + y^2 = 2 q (z + q / 2)`` under a telecentric camera: rays parallel to z, ``focal`` px
  per metre;
- hyperboloid of the foci (0, 0, 0) and (0, 0, -d), where the camera is: the sheet of the points that are 2a
  nearer to the first, ``q = b^2 / a``, ``a^2 + b^2 = (d / 2)^2``;
- plane halfway between a pinhole camera and its mirror image, the origin.

Of ball and cone the origin is the camera, and the nearest point or the tip is at a distance along z.
"""

from collections.abc import Callable
from typing import NamedTuple

import mpmath as mp
import numpy as np

DIGITS = 50


class Mirror(NamedTuple):
    """A surface ``X^T Q X = 0``, the part of it with z > ``above``, and the camera's rays."""

    quadric: mp.matrix
    above: mp.mpf
    ray: Callable  # (x, y) in units of the focal length -> start, direction


@mp.workdps(DIGITS)
def paraboloid(q):
    q = mp.mpf(q)
    quadric = mp.matrix([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, -q], [0, 0, -q, -q * q]])
    return Mirror(quadric, -q, lambda x, y: (mp.matrix([x, y, -10 * q, 1]), mp.matrix([0, 0, 1, 0])))


@mp.workdps(DIGITS)
def hyperboloid(d, q):
    d = mp.mpf(d)
    q = mp.mpf(q)
    c = d / 2
    a = (mp.sqrt(q * q + 4 * c * c) - q) / 2  # the positive root of a^2 + q a = c^2
    b2 = q * a
    # (z + c)^2 / a^2 - (x^2 + y^2) / b^2 = 1
    k = b2 / a**2
    quadric = mp.matrix([[-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, k, k * c], [0, 0, k * c, k * c * c - b2]])
    # -c: midway between the two sheets
    return Mirror(quadric, -c, lambda x, y: (mp.matrix([0, 0, -d, 1]), mp.matrix([x, y, 1, 0])))


@mp.workdps(DIGITS)
def plane(half_distance):
    h = mp.mpf(half_distance)
    # z = -h, as a quadric: (z + h) w = 0
    quadric = mp.matrix([[0] * 4, [0] * 4, [0, 0, 0, mp.mpf(1) / 2], [0, 0, mp.mpf(1) / 2, h]])
    return Mirror(quadric, -2 * h, lambda x, y: (mp.matrix([0, 0, -2 * h, 1]), mp.matrix([x, y, 1, 0])))


def pinhole(x, y):
    """A ray of a pinhole at the origin."""
    return mp.matrix([0, 0, 0, 1]), mp.matrix([x, y, 1, 0])


@mp.workdps(DIGITS)
def ball(radius, distance):
    radius, center = mp.mpf(radius), mp.mpf(distance) + mp.mpf(radius)
    k = center**2 - radius**2
    quadric = mp.matrix([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -center], [0, 0, -center, k]])
    return Mirror(quadric, mp.mpf(0), pinhole)


@mp.workdps(DIGITS)
def cone(half_angle_deg, distance):
    """Of the double cone the half that opens away from the camera."""
    k = mp.tan(mp.mpf(half_angle_deg) * mp.pi / 180) ** 2
    tip = mp.mpf(distance)
    quadric = mp.matrix([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -k, k * tip], [0, 0, k * tip, -k * tip**2]])
    return Mirror(quadric, tip, pinhole)


@mp.workdps(DIGITS)
def bounce(mirror, x, y):
    """(hit, unit direction) of a camera ray off the surface, or None where it misses."""
    start, ray = mirror.ray(x, y)
    a, b = (mp.fdot(ray, mirror.quadric * other) for other in (ray, start))
    c = mp.fdot(start, mirror.quadric * start)
    square = b * b - a * c
    if square < 0:
        return None
    # Not divided by a, which is 0 for the plane, and for rays along the paraboloid's axis.
    ways = [c / bottom for bottom in (-b + mp.sqrt(square), -b - mp.sqrt(square)) if bottom]
    ahead = [start + way * ray for way in ways if way > 0]
    hits = [p for p in ahead if p[2] > mirror.above]
    if not hits:
        return None
    hit = min(hits, key=lambda p: p[2])
    normal = unit((mirror.quadric * hit)[:3])
    d = unit(ray[:3])
    along = mp.fdot(d, normal)
    return [hit[i] for i in range(3)], [d[i] - 2 * along * normal[i] for i in range(3)]


def unit(vector):
    length = mp.norm(mp.matrix(vector))
    return [v / length for v in vector]


def body_of(camera):
    """The mirror of a non-central camera."""
    if camera.name == "noncentral-spherical-mirror":
        return ball(camera.mirror_radius, camera.distance)
    return cone(camera.half_angle_deg, camera.distance)


def seen_by(camera, pixel):
    """(hit, unit direction) of a pixel's ray off a non-central camera's mirror, or None."""
    at = (np.asarray(pixel, dtype=float) - camera.center) / camera.focal
    return bounce(body_of(camera), *at.tolist())


@mp.workdps(DIGITS)
def ray_errors(camera, pixel):
    """(angle, offset) of a valid pixel's ray from the reflected one.

    The angle between the directions, radians, and the distance of the origin from the true line over
    that of the camera from where the mirror was hit.
    """
    rays = camera.unproject(np.asarray(pixel))
    hit, truth = seen_by(camera, pixel)
    d = unit([mp.mpf(v) for v in rays.directions.tolist()])
    angle = mp.norm(cross(d, truth)) if mp.fdot(d, truth) > 0 else mp.pi
    offset = [mp.mpf(v) - w for v, w in zip(rays.origins.tolist(), hit, strict=True)]
    return float(angle), float(mp.norm(cross(offset, truth)) / mp.norm(mp.matrix(hit)))


def cross(a, b):
    return mp.matrix([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
