"""The number of instants of an exposure that is chosen by itself: enough, and not many more."""

import numpy as np
import pytest

import omniscv
from omniscv.cameras import create
from omniscv.geometry.motion import Motion, object_pose
from omniscv.geometry.trajectory import Trajectory
from omniscv.job.file import load
from omniscv.make.moments import instants_for, moments, motion_px

STILL = omniscv.Pose.from_angles((0, 0, 1.2))


@pytest.mark.parametrize(("px", "count"), [(0, 3), (1, 9), (4, 17), (16, 33), (64, 129), (1e6, 999)])
def test_twice_as_many_instants_as_pixels_of_motion(px, count):
    assert instants_for(px) == count


def error_of(count, px):
    """Largest error of an edge of full contrast that moves, in the box of a pixel: a mean of few instants."""
    x = np.linspace(-px, px, 4_001)

    def seen(n):
        shifts = px * ((np.arange(n) + 0.5) / n - 0.5)
        return np.mean([np.clip(x - shift + 0.5, 0, 1) for shift in shifts], axis=0)

    return np.abs(seen(count) - seen(1024)).max()


@pytest.mark.parametrize("px", [0.5, 2, 7, 16, 40])
def test_the_mean_of_so_many_is_within_two_levels_of_a_full_edge(px):
    assert 255 * error_of(instants_for(px), px) < 2


def test_motion_is_measured_in_pixels():
    camera = create("fisheye-equidistant", width=200, height=200, focal=60.0)
    turned = omniscv.Pose.from_angles((0, 0, 1.2), yaw_deg=10)
    assert motion_px(camera, (STILL, turned), (), (0, 1)) == pytest.approx(60 * np.radians(10), rel=0.3)
    moved = omniscv.Pose.from_angles((0.1, 0, 1.2))
    assert motion_px(camera, (STILL, moved), (), (0, 1)) == pytest.approx(6, rel=0.3)
    slide = Motion(
        Trajectory((object_pose((3.5, 0, 1.2), 0), object_pose((3.5, 1.2, 1.2), 0)), (0.0, 2.0)), "linear"
    )
    assert motion_px(camera, (STILL, STILL), (slide,), (0, 1)) == pytest.approx(60 * 0.2, rel=0.3)


def job(out, instants, **more):
    return load(
        {
            "source": "scene://workshop",
            "cameras": {"eye": {"model": "fisheye-equidistant", "width": 32, "height": 32, "fov_deg": 160}},
            "poses": [{"position": [0, 0, 1.2], "yaw_deg": 60 * time, "time": time} for time in (0, 1)],
            "times": "poses", "face_size": 20, "out": str(out),
            "exposure": {"seconds": 0.25, "instants": instants}, **more,
        }
    )  # fmt: skip


def test_moving_objects_need_instants_too(tmp_path):
    slide = [{"time": 0, "position": [-2, -0.6, 0.85]}, {"time": 1, "position": [-1.2, 0.8, 0.85]}]
    poses = {"poses": [{"position": [0, 0, 1.2]}], "times": [0.5]}
    counts = [
        len(next(moments(job(tmp_path, "auto", **poses, **more))).takes)
        for more in ({}, {"motions": {"Cabinet": slide}})
    ]
    assert counts[0] == 3 < counts[1]
