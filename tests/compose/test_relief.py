"""Bounds and marks in fine relief, judged by the tracer of tests/support/relief.py."""

import numpy as np
import pytest
from support.relief import EDGE_PX, KINDS, captured, judge, world

from omniscv.geometry import Pose
from omniscv.planning.depth_shell import depth_shell, distances
from omniscv.sources import View

MOST = {1.4: 0.01, 2.0: 0.006, 3.0: 0.003, 4.5: 0.002, 8.0: 0.002}
"""Share of the pixels on a structure that may be wrong and unmarked, by captured px of a feature."""


@pytest.mark.parametrize(
    ("kind", "px"), [("logs", 3.0), ("saw 20", 2.0), ("panels 3 mm", 3.0), ("stairs", 1.4), ("bars", 1.4)]
)
def test_relief_is_bounded_or_marked(kind, px):
    judged = judge(kind, px, seed=11, camera_px=140)
    assert judged.depth <= MOST[px], judged
    assert judged.labels <= MOST[px], judged


def test_what_rays_are_marched_through_knows_its_relief():
    scene, rng = world("logs", 1.4, 11), np.random.default_rng(0)
    view = View(Pose(np.zeros(3), np.eye(3)), 90.0, EDGE_PX, EDGE_PX)
    shell = depth_shell(np.zeros(3), [captured(scene, view)["depth"]], cube=False)
    rays = np.concatenate([rng.uniform(-0.6, 0.6, (4000, 2)), np.ones((4000, 1))], axis=1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    distance, label = scene.trace(rays)
    least, most = distances(shell, rays)
    wrong = (least > distance * (1 + 1e-6)) | (distance > most * (1 + 1e-6))
    assert wrong[label > 1].mean() <= MOST[1.4]


@pytest.mark.soak
@pytest.mark.parametrize("px", MOST)
@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_bounded_or_marked(kind, px):
    judged = [judge(kind, px, seed) for seed in (21, 22)]
    assert np.mean([each.depth for each in judged]) <= MOST[px], judged
    assert np.mean([each.labels for each in judged]) <= MOST[px], judged
