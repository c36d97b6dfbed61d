"""Rays marched through depth from another centre: what they meet lies within the bound of the reach."""

import numpy as np
import pytest
from support.exact import float_source

from mock_server import load_scene
from omniscv.geometry import Pose, cube_rotations
from omniscv.planning.depth_shell import depth_shell
from omniscv.planning.ray_marching import march
from omniscv.sources.base import Request, View

FENCE = load_scene("fence")
CENTER = np.array([0.13, 0.11, 1.43])
FACE_PX = 384


@pytest.fixture(scope="module")
def shell():
    views = [View(Pose(CENTER, R_w_c), 90.0, FACE_PX, FACE_PX) for _, R_w_c in cube_rotations()]
    captures = float_source(FENCE).capture([Request(view, "depth") for view in views])
    return depth_shell(CENTER, list(captures))


@pytest.mark.parametrize("aside_m", [0.003, 0.02, 0.1, 0.4])
def test_rays_through_a_fence_end_within_their_bounds(aside_m, shell):
    """Its bars are two pixels wide, and a ray from beside the centre passes them within a step of a pixel."""
    rng = np.random.default_rng(7)
    origins = CENTER + aside_m * rng.normal(size=(20_000, 3)) / np.sqrt(3)
    directions = rng.uniform((2.6, -1.1, 0.2), (2.6, 1.1, 1.9), (20_000, 3)) - origins
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    truth = FENCE.trace(origins, directions).distance
    hits = march(shell, origins, directions)
    known = hits.sure & np.isfinite(hits.reach)
    off = np.abs(hits.reach - truth)[known]
    wrong = off > hits.error[known] + 1e-4  # metres: captures are float32
    assert known.mean() > 0.5
    assert not wrong.any()


def test_rays_end_within_the_bounds_of_finer_views(shell):
    """Of bars that are ten pixels wide there: fewer rays pass another surface within a pixel."""
    bars = Pose(CENTER, cube_rotations()[0][1])
    (finer,) = float_source(FENCE).capture([Request(View(bars, 60.0, 1600, 1600), "depth")])
    rng = np.random.default_rng(7)
    origins = CENTER + 0.05 * rng.normal(size=(20_000, 3))
    directions = rng.uniform((2.6, -1.1, 0.6), (2.6, 1.1, 1.9), (20_000, 3)) - origins
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    truth = FENCE.trace(origins, directions).distance
    coarse, hits = (march(some, origins, directions) for some in (shell, shell.refined([finer])))
    known = hits.sure & np.isfinite(hits.reach)
    assert not (np.abs(hits.reach - truth)[known] > hits.error[known] + 1e-4).any()
    assert hits.grazes.mean() < 0.6 * coarse.grazes.mean()
    assert np.median(hits.error[known]) < np.median(coarse.error[coarse.sure & np.isfinite(coarse.reach)])
