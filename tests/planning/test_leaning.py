"""Faces of a source that cannot look straight up: plugin 0.3.10 stops at 89.9 degrees."""

import numpy as np
import pytest
from support.plans import plan_of, viewpoints_of

import omniscv
from omniscv.cameras import create
from omniscv.geometry import Pose
from omniscv.sources import View

CENTER = np.array([0.3, -0.2, 1.5])
CAMERA = create("equirectangular", width=64, height=32)


def as_captured(view, fov_deg):
    """What the plugin makes of a view: pitch limited, field of view the window's."""
    yaw, pitch, roll = view.pose.angles()
    pose = Pose.from_angles(view.pose.t_w_c, yaw, np.clip(pitch, -89.9, 89.9), roll)
    return View(pose, fov_deg, view.width, view.height)


def sees(view, points):
    u, v, z = view.project(points).T
    return (z > 0) & (u >= 0) & (u <= view.width) & (v >= 0) & (v <= view.height)


@pytest.fixture(scope="module")
def faces():
    """The views of a cube map that a source of that plugin plans."""
    with omniscv.open_source("mock://four-wall?dialect=0.3.10&size=256x256") as source:
        task = plan_of(CAMERA, Pose.from_angles(CENTER), source.capabilities, cover=source.cover)
        [viewpoint] = viewpoints_of(task)
    return viewpoint.views


@pytest.fixture(scope="module")
def around():
    """Points in all directions, most of them near the edges of up and down, where views lean away."""
    rng = np.random.default_rng(1)
    near_edges = rng.uniform(-1, 1, (30_000, 3)) * (1, 1.003, 1)
    near_edges[:, 0] = rng.choice([-1, 1], 30_000) * rng.uniform(0.996, 1.004, 30_000)
    near_edges[:, 2] = rng.choice([-1, 1], 30_000)
    return CENTER + np.concatenate([rng.normal(size=(30_000, 3)), near_edges, near_edges[:, [1, 0, 2]]])


def test_leaning_views_of_90_degrees_see_everything(around, faces):
    views = [as_captured(view, 90.0) for view in faces]
    assert np.any([sees(view, around) for view in views], axis=0).all()


def test_the_six_faces_alone_would_not(around, faces):
    views = [as_captured(view, 90.0) for view in faces[:6]]
    assert not np.any([sees(view, around) for view in views], axis=0).all()


def test_other_sources_capture_six():
    [viewpoint] = viewpoints_of(plan_of(CAMERA, Pose.from_angles(CENTER)))
    assert len(viewpoint.views) == 6
