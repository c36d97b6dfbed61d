"""Recordings that hold a mirror's strips as coarse as a face is in its middle, as they once were captured."""

import numpy as np
import pytest

import omniscv
from omniscv.cameras import create
from omniscv.errors import MissingCaptureError
from omniscv.geometry import Pose
from omniscv.planning.strips import strip_size, strip_views
from omniscv.sources import Request

POSE = Pose.from_angles((0.1, -0.2, 1.45), yaw_deg=20.0)
CONE = create("noncentral-conical-mirror", width=32, height=32, half_angle_deg=55.0, distance=0.3)
EDGE = 64


def recorded(path, focal_px):
    """A recording of the cone's strips at a focal length, and of what shows which centres are occluded."""
    with omniscv.open_source("scene://four-wall") as live, omniscv.record(live, path) as source:
        task = omniscv.Renderer(source).task(CONE, POSE, omniscv.RenderOptions("strips", face_size=EDGE))
        groups = task.groups()
        rays_w = [group.directions @ POSE.R_w_c.T for group in groups]
        border_px = max(2, 1 + int(np.ceil(focal_px * task.rays.typical_step / 2)))
        size = strip_size(rays_w, focal_px, border_px, source.capabilities)
        for group, rays in zip(groups, rays_w, strict=True):
            views = strip_views(POSE.to_world(group.center_c), rays, focal_px, border_px, size)
            list(source.capture(Request(view, "depth") for view in views))
    return path


def test_they_are_replayed(tmp_path):
    with omniscv.open_source(recorded(tmp_path / "older.sqlite", EDGE / 2)) as source:
        image = omniscv.render(CONE, POSE, source, ("depth",), strategy="strips", face_size=EDGE)
    with omniscv.open_source("scene://four-wall") as live:
        anew = omniscv.render(CONE, POSE, live, ("depth",), strategy="strips", face_size=EDGE)
    assert image.valid.any()
    near = np.abs(image.depth - anew.depth) < 0.01 * anew.depth
    assert near[image.valid].mean() > 0.97  # edges lie elsewhere


def test_others_are_missing(tmp_path):
    with (
        omniscv.open_source(recorded(tmp_path / "other.sqlite", 0.4 * EDGE)) as source,
        pytest.raises(MissingCaptureError),
    ):
        omniscv.render(CONE, POSE, source, ("depth",), strategy="strips", face_size=EDGE)
