"""Errors by angle, distance and across the seam, judged by planted errors and sums in plain Python."""

import numpy as np
import pytest

from omniscv import cameras, score
from omniscv.score import groups

PANORAMA = cameras.create("equirectangular", width=64, height=32)
FISHEYE = cameras.create("fisheye-equidistant", width=48, height=48, fov_deg=180)
RNG = np.random.default_rng(2)


def grouped(p, t, camera):
    return groups.group(p, t, camera.valid(), camera)


def test_rings_bands_and_distances_are_those_of_a_loop():
    t = RNG.uniform(0.3, 40, (48, 48))
    p = t * RNG.uniform(0.6, 1.5, t.shape)
    found = grouped(p, t, FISHEYE)
    areas = score.solid_angles(FISHEYE)
    directions = FISHEYE.unproject().directions
    expected = {}
    for v, u in zip(*np.nonzero(FISHEYE.valid()), strict=True):
        angle = int(np.degrees(np.arccos(directions[v, u, 2])) // 15)
        band = int((90 - np.degrees(np.arccos(np.clip(-directions[v, u, 1], -1, 1))) + 90) // 15)
        for name in (f"{15 * angle} to {15 * angle + 15} degrees off the axis", f"latitude {15 * band - 90}"):
            row = expected.setdefault(name, [0.0, 0.0])
            row[0] += areas[v, u]
            row[1] += areas[v, u] * abs(p[v, u] - t[v, u]) / t[v, u]
        far = int(np.floor(np.log2(t[v, u])))
        row = expected.setdefault(f"{2.0**far:g} to {2.0 ** (far + 1):g} m", [0.0, 0.0])
        row[0] += areas[v, u]
        row[1] += areas[v, u] * abs(p[v, u] - t[v, u]) / t[v, u]
    rows = groups.by_ring(found) + groups.by_distance(found)
    for row in groups.by_band(found):
        rows.append(groups.Row(row.name.split(" to")[0], row.share, row.abs_rel, row.delta1, 0.0))
    assert len(rows) == len(expected)
    for row in rows:
        total, error = expected[row.name]
        assert row.abs_rel == pytest.approx(error / total)
        assert row.share == pytest.approx(total / areas[FISHEYE.valid()].sum())


def test_an_error_of_the_poles_is_in_their_bands_alone():
    t = np.full((32, 64), 3.0)
    p = t.copy()
    p[:2] *= 1.5
    rows = groups.by_band(grouped(p, t, PANORAMA))
    assert rows[-1].abs_rel > 0.15
    assert [row.abs_rel for row in rows[:-1]] == pytest.approx([0] * 11)
    assert sum(row.share for row in rows) == pytest.approx(1)


def test_an_error_that_the_angle_makes_is_none_of_the_distance_at_equal_angle():
    """Far surfaces lie low, and the error is that of the latitude alone: at equal angle all distances have
    the same."""
    v = np.arange(32)[:, None] + np.zeros(64)
    t = np.where(RNG.uniform(size=(32, 64)) < v / 40 + 0.1, 12.0, 3.0)
    band = ((v + 0.5) * 180 / 32) // 15
    p = t * (1 + 0.01 * band)
    rows = groups.by_distance(grouped(p, t, PANORAMA), by_latitude=True)
    near, far = rows
    assert abs(near.abs_rel - far.abs_rel) > 0.01
    assert near.abs_rel_at_equal == pytest.approx(far.abs_rel_at_equal, rel=1e-9)


def test_an_error_of_distance_is_none_of_the_angle_at_equal_distance():
    v = np.arange(32)[:, None] + np.zeros(64)
    t = np.where(RNG.uniform(size=(32, 64)) < v / 40 + 0.1, 12.0, 3.0)
    p = t * np.where(t > 5, 1.2, 1.05)
    rows = groups.by_band(grouped(p, t, PANORAMA))
    assert max(row.abs_rel for row in rows) > min(row.abs_rel for row in rows) + 0.03
    both = [row.abs_rel_at_equal for row in rows if row.abs_rel_at_equal > 0.06]
    assert both == pytest.approx([both[0]] * len(both), rel=1e-9)


def test_a_seam_is_a_step_that_the_truth_has_not():
    t = RNG.uniform(2, 4, (32, 64))
    p = t * np.exp(np.linspace(0, 0.3, 64))
    steps = groups.seam(grouped(p, t, PANORAMA))
    assert steps["across the seam"] == pytest.approx(0.3)
    assert steps["elsewhere"] == pytest.approx(0.3 / 63)
    assert groups.seam(grouped(t * 1.3, t, PANORAMA))["across the seam"] == pytest.approx(0, abs=1e-12)
    pinhole = cameras.create("pinhole", width=8, height=8, fov_deg=60)
    assert groups.seam(grouped(t[:8, :8], t[:8, :8], pinhole)) == {}


def test_sums_of_images_are_those_of_all_their_pixels():
    t = RNG.uniform(1, 9, (2, 32, 64))
    p = t * RNG.uniform(0.8, 1.2, t.shape)
    total = grouped(p[0], t[0], PANORAMA) + grouped(p[1], t[1], PANORAMA)
    twice = groups.by_ring(total)
    areas = score.solid_angles(PANORAMA)
    ring = np.degrees(np.arccos(PANORAMA.unproject().directions[..., 2])) < 15
    expected = (areas * ring * np.abs(p - t) / t).sum() / (2 * (areas * ring).sum())
    assert twice[0].abs_rel == pytest.approx(expected)
