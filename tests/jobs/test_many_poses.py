"""Jobs of many poses: what is planned at some of them stands for all."""

from dataclasses import replace

import numpy as np
import pytest
from support.datasets import job_file

from omniscv.geometry import Pose
from omniscv.job import load
from omniscv.make import costs, render


@pytest.fixture
def job(tmp_path):
    """A panorama at 30 places, at each of them looking two ways."""
    loaded = load(job_file(tmp_path))
    places = [(x, 0.1, 1.5) for x in np.linspace(-1, 1, 30)]
    poses = [Pose.from_angles(place, yaw_deg=yaw) for place in places for yaw in (0, 90)]
    return replace(loaded, cameras={"pano": loaded.cameras["pano"]}, poses=poses, times_ns=None, places=None)


def test_costs_of_some_places_stand_for_all(job, monkeypatch, caplog):
    every = costs(job)
    caplog.set_level("INFO", "omniscv")
    monkeypatch.setattr(render, "_PLANNED_CENTERS", 7)
    some = costs(job)
    assert "planned at 6 of 30 places and instants, which stand for the others" in caplog.text
    for whole, estimate in zip(every, some, strict=True):
        assert estimate.way == whole.way
        assert estimate.requests == pytest.approx(whole.requests, rel=0.02)
        assert estimate.seconds == pytest.approx(whole.seconds, rel=0.02)
