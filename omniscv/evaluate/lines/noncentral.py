"""A line in space from the rays of one non-central image: algebraic, and with known directions.

Every ray of the line gives one linear equation in its six Pluecker coordinates. All rays of a panorama or of
a mirror of revolution also meet the axis, so that the axis is always a solution, which has to be left out.

Source: Bermudez-Cameo, Demonceaux, Lopez-Nicolas, Guerrero 2016, Line reconstruction using prior knowledge in
single non-central view; Gasparini and Caglioti 2011, Line localization from single catadioptric images.
"""

from __future__ import annotations

import numpy as np

from omniscv.evaluate.lines import plucker
from omniscv.geometry.pose import Array


def free_line(rows: Array, axis: Array) -> Array:
    """Return the line (6,) that rays meet, other than the axis.

    Orthogonally to the axis A the last singular vector b is the line but for a share of the axis:
    ``L = b + t A``, and ``l . m = 0`` gives ``t = -(l_b . m_b) / (a . m_b)``.

    Args:
        rows: (N, 6), N >= 4, of rays: :func:`omniscv.evaluate.lines.plucker.incidence`.
        axis: (3,) unit, through the origin: every ray meets it.
    """
    line = np.concatenate([axis, np.zeros(3)])
    without = np.linalg.svd(line[None])[2][1:]  # (5, 6) a basis of what is orthogonal to the axis
    b = _right_singular(rows @ without.T)[-1] @ without
    return plucker.on_klein(b - line * (b[:3] @ b[3:]) / (axis @ b[3:]))


def line_along(rows: Array, direction: Array) -> Array:
    """Return the line (6,) of a known direction (3,), unit, that rays meet: two unknowns, linear.

    Its moment is orthogonal to the direction. Args as of :func:`free_line`; N >= 2.
    """
    across = np.linalg.svd(direction[None])[2][1:]  # (2, 3)
    found = np.linalg.lstsq(rows[:, 3:] @ across.T, -rows[:, :3] @ direction, rcond=None)[0]
    return np.concatenate([direction, found @ across])


def level_line(rows: Array, gravity: Array) -> Array:
    """Return the line (6,) across gravity (3,), unit, that rays meet: five unknowns, and Klein's quadric.

    The two last singular vectors span what noise cannot tell apart; of its lines, which ``l . m = 0`` picks
    out, that which the rays meet best is returned. Args as of :func:`free_line`; N >= 4: of three
    rays, two lines are as good.
    """
    basis = np.zeros((5, 6))
    basis[:2, :3] = np.linalg.svd(gravity[None])[2][1:]
    basis[2:, 3:] = np.eye(3)
    b, c = _right_singular(rows @ basis.T)[:-3:-1] @ basis
    quadric = [c[:3] @ c[3:], b[:3] @ c[3:] + c[:3] @ b[3:], b[:3] @ b[3:]]
    shares = np.roots(quadric)
    lines = [plucker.on_klein(b + t * c) for t in shares[np.isreal(shares)].real]
    lines = lines or [plucker.on_klein(b)]
    return min(lines, key=lambda line: float(np.linalg.norm(rows @ line)))


def effective_baseline(origins: Array, directions: Array) -> float:
    """Return the spread of the rays' origins out of the plane that the rays fit best, metres.

    Rays (N, 3) of a central camera lie in a plane with the line; only what is out of it tells its distance.
    """
    normal = _right_singular(directions)[2]
    return float(np.ptp(origins @ normal))


def _right_singular(rows: Array) -> Array:
    """(K, K) the right singular vectors of rows (N, K), also those of fewer rows than columns, which rows of
    zeros make complete."""
    padded = np.concatenate([rows, np.zeros((rows.shape[1], rows.shape[1]))])
    return np.asarray(np.linalg.svd(padded, full_matrices=False)[2])
