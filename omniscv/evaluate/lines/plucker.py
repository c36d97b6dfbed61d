"""Straight lines in space by Pluecker coordinates, and their reconstruction from the rays of one image.

A line through the point p along the direction l is ``(l, m)``, ``m = p x l``: six numbers up to scale, with
``l . m = 0`` (Klein's quadric). A ray from o along d meets it where ``d . m + (o x d) . l = 0``. Each ray of
a line's image is one such linear equation. All rays of a panorama or of a mirror of revolution also meet the
axis, so that the axis is always a solution, which has to be left out.

Source: Bermudez-Cameo, Demonceaux, Lopez-Nicolas, Guerrero 2016, Line reconstruction using prior knowledge in
single non-central view; Gasparini and Caglioti 2011, Line localization from single catadioptric images.
"""

import numpy as np

from omniscv.geometry.pose import Array


def through(points: Array, directions: Array) -> Array:
    """Return lines (..., 6) through points (..., 3) along directions (..., 3), of unit direction."""
    unit = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    return np.concatenate([unit, np.cross(points, unit)], axis=-1)


def incidence(origins: Array, directions: Array) -> Array:
    """Return rows (..., 6) whose product with a line is 0 where a ray meets it; metres if both are unit."""
    return np.concatenate([np.cross(origins, directions), directions], axis=-1)


def nearest_to_rays(line: Array, origins: Array, directions: Array) -> Array:
    """Return (N, 3) the points of a line (6,) of unit direction that are nearest to rays (N, 3), unit."""
    middle = np.cross(line[:3], line[3:])  # nearest to the origin
    cosine, offset = directions @ line[:3], origins - middle
    along = (offset @ line[:3] - cosine * (offset * directions).sum(axis=-1)) / (1 - cosine**2)
    return np.asarray(middle + along[:, None] * line[:3])


def distance_to(line: Array, points: Array) -> Array:
    """Return (N,) the distances of points (N, 3) from a line (6,) of unit direction."""
    return np.asarray(np.linalg.norm(np.cross(points, line[:3]) - line[3:], axis=-1))


def angle_deg(a: Array, b: Array) -> float:
    """Return the angle between two undirected lines along (3,), 0 to 90 degrees."""
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), abs(a @ b))))


def across(direction: Array) -> Array:
    """Return (2, 3) two unit vectors across a direction (3,) and each other."""
    return np.asarray(np.linalg.svd(direction[None])[2][1:])


def free_line(rows: Array, axis: Array) -> Array:
    """Return the line (6,) that rays meet, other than the axis.

    Orthogonally to the axis A the last singular vector b is the line but for a share of the axis:
    ``L = b + t A``, and ``l . m = 0`` gives ``t = -(l_b . m_b) / (a . m_b)``.

    Args:
        rows: (N, 6), N >= 4, of rays: :func:`incidence`.
        axis: (3,) unit, through the origin: every ray meets it.
    """
    line = np.concatenate([axis, np.zeros(3)])
    basis = np.linalg.svd(line[None])[2][1:]  # (5, 6) of what is orthogonal to the axis
    b = _right_singular(rows @ basis.T)[-1] @ basis
    return _on_klein(b - line * (b[:3] @ b[3:]) / (axis @ b[3:]))


def line_along(rows: Array, direction: Array) -> Array:
    """Return the line (6,) of a known direction (3,), unit, that rays meet: two unknowns, linear.

    Its moment is orthogonal to the direction. Args as of :func:`free_line`; N >= 2.
    """
    basis = across(direction)
    moment = np.linalg.lstsq(rows[:, 3:] @ basis.T, -rows[:, :3] @ direction, rcond=None)[0]
    return np.concatenate([direction, moment @ basis])


def level_line(rows: Array, gravity: Array) -> Array:
    """Return the line (6,) across gravity (3,), unit, that rays meet: five unknowns, and Klein's quadric.

    The two last singular vectors span what noise does not distinguish. Of the lines in this span, the one
    that the rays meet best is returned. Args as of :func:`free_line`; N >= 4, because three rays have two
    such lines.
    """
    basis = np.zeros((5, 6))
    basis[:2, :3] = across(gravity)
    basis[2:, 3:] = np.eye(3)
    b, c = _right_singular(rows @ basis.T)[:-3:-1] @ basis
    quadric = [c[:3] @ c[3:], b[:3] @ c[3:] + c[:3] @ b[3:], b[:3] @ b[3:]]
    shares = np.roots(quadric)
    lines = [_on_klein(b + t * c) for t in shares[np.isreal(shares)].real] or [_on_klein(b)]
    return min(lines, key=lambda line: float(np.linalg.norm(rows @ line)))


def effective_baseline(origins: Array, directions: Array) -> float:
    """Return the spread of the rays' origins out of the plane that fits the rays best, metres.

    The rays (N, 3) of a line in a central image lie in one plane, and do not depend on the line's distance.
    """
    normal = _right_singular(directions)[2]
    return float(np.ptp(origins @ normal))


def _on_klein(line: Array) -> Array:
    """Return the line (6,) of unit direction nearest to six numbers, with the same direction."""
    length = float(np.linalg.norm(line[:3]))
    along, moment = line[:3] / length, line[3:] / length
    return np.concatenate([along, moment - along * (along @ moment)])


def _right_singular(rows: Array) -> Array:
    """Return the right singular vectors (K, K) of rows (N, K), completed by rows of zeros."""
    padded = np.concatenate([rows, np.zeros((rows.shape[1], rows.shape[1]))])
    return np.asarray(np.linalg.svd(padded, full_matrices=False)[2])
