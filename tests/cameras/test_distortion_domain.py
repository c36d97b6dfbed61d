"""Where distortion ends a lens: at its first turn, found here in 40 digits on the formula's derivative.

Beyond it two rays come to one pixel. Programs that do not look for it answer with either.
"""

import mpmath as mp
import numpy as np
import pytest

from omniscv import cameras

SIZE = {"width": 10_000, "height": 100}  # wide: the border is sought along the row of the centre
F = 100.0
STEPS = np.array([[[1.0], [0.0]], [[0.0], [1.0]]])
# k1, k2, p1, p2, k3, k4, k5, k6; what ends the domain.
RADIAL = [
    ((-0.3, 0, 0, 0, 0, 0, 0, 0), "turn"),
    ((-0.35, 0.12, 0, 0, -0.02, 0, 0, 0), "turn"),
    ((0.1, -0.7, 0, 0, 0.3, 0, 0, 0), "turn"),  # grows again after its turn: not the lens
    ((0.2, -0.05, 0, 0, 0.01, 0.8, 0.3, 0.1), "turn"),
    ((0.2, 0.05, 0, 0, 0.01, -0.3, 0, 0), "nothing"),  # a pole: the image reaches to infinity
    ((0.2, 0.1, 0, 0, 0.02, 0.1, 0, 0), "nothing"),
]


def distorted(k, r):
    k1, k2, _, _, k3, k4, k5, k6 = k
    return r * (1 + k1 * r**2 + k2 * r**4 + k3 * r**6) / (1 + k4 * r**2 + k5 * r**4 + k6 * r**6)


@mp.workdps(40)
def first_turn(k):
    """The first r where r c grows no more, on a grid and then by halves."""
    grid = np.linspace(0, 4, 4001)
    falls = np.flatnonzero(np.diff(distorted(k, grid)) <= 0)[0]
    low, high = mp.mpf(grid[falls - 1]), mp.mpf(grid[falls + 1])
    for _ in range(50):
        middle = (low + high) / 2
        growing = mp.diff(lambda r: distorted(list(map(mp.mpf, k)), r), middle) > 0
        low, high = (middle, high) if growing else (low, middle)
    return float(low)


def last_tangent(camera):
    """The largest x / z that the camera sees to the right, by bisection."""
    low, high = 0.0, 20.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if camera.project(np.array([middle, 0, 1.0]))[1] else (low, middle)
    return low


@pytest.mark.parametrize(("k", "ends"), RADIAL)
def test_radial_terms_end_at_their_first_turn(k, ends):
    camera = cameras.create("pinhole", **SIZE, fx=F, fy=F, distortion=k)
    if ends == "nothing":
        assert camera.valid(np.array([[0.5, 0.5], [9999.5, 99.5]])).all()
        return
    turn = first_turn(k)
    assert last_tangent(camera) == pytest.approx(turn, rel=1e-9)
    radius = F * distorted(k, turn)
    across = np.array([radius - 1e-9, radius + 1e-9])
    np.testing.assert_array_equal(camera.valid(np.stack([5000 + across, [50, 50]], axis=-1)), [True, False])


@pytest.mark.parametrize(
    "distortion", [(-0.3, 0, 3e-3, -2e-3), (-0.3, 0.01, 0, 0, 0, 0, 0, 0, 2e-3, 0, -3e-3, 0)]
)
def test_tangential_terms_and_prisms_end_where_a_direction_first_stops_to_grow(distortion):
    """On the disc's rim, and nowhere within, the distortion stretches some direction by nothing."""
    camera = cameras.create("pinhole", **SIZE, fx=F, fy=F, distortion=distortion)
    k = np.append(distortion, np.zeros(12 - len(distortion)))
    rim = last_tangent(camera)

    def least_stretch(r):
        """The least eigenvalue of the derivative's symmetric part around the circle, by differences."""
        a = np.linspace(0, 2 * np.pi, 721)
        at, h = r * np.stack([np.cos(a), np.sin(a)]), 1e-6
        dx, dy = ((opencv(at + aside, k) - opencv(at - aside, k)) / (2 * h) for aside in h * STEPS)
        off = (dx[1] + dy[0]) / 2
        return ((dx[0] + dy[1]) / 2 - np.hypot((dx[0] - dy[1]) / 2, off)).min()

    assert abs(least_stretch(rim)) < 1e-5
    assert all(least_stretch(part * rim) > 0 for part in (0.2, 0.5, 0.8, 0.95, 0.999))


def opencv(at, k):
    """OpenCV's formula, of places (2, N)."""
    (x, y), r2 = at, (at**2).sum(axis=0)
    c = (1 + k[0] * r2 + k[1] * r2**2 + k[4] * r2**3) / (1 + k[5] * r2 + k[6] * r2**2 + k[7] * r2**3)
    return np.stack(
        [
            x * c + 2 * k[2] * x * y + k[3] * (r2 + 2 * x**2) + k[8] * r2 + k[9] * r2**2,
            y * c + k[2] * (r2 + 2 * y**2) + 2 * k[3] * x * y + k[10] * r2 + k[11] * r2**2,
        ]
    )
