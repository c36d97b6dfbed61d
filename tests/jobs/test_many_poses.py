"""Jobs of many poses: what is planned at some of them stands for all."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.datasets import job_file

from omniscv.compose.renderer import Renderer
from omniscv.geometry import Pose
from omniscv.job import Recipe, load, read
from omniscv.make import capture, costs, estimates, run
from omniscv.sources import registry
from omniscv.sources.base import SourceWrapper
from omniscv.sources.registry import open_source


@pytest.fixture
def job(tmp_path):
    """A panorama at 30 places, at each of them looking two ways, others than at the places before."""
    loaded = load(job_file(tmp_path))
    places = [(x, 0.1, 1.5) for x in np.linspace(-1, 1, 30)]
    poses = []
    for number, place in enumerate(places):
        poses += [Pose.from_angles(place, yaw_deg=number), Pose.from_angles(place, yaw_deg=number + 90)]
    return replace(loaded, cameras={"pano": loaded.cameras["pano"]}, poses=poses, times_ns=None, places=None)


def test_costs_of_some_places_stand_for_all(job, monkeypatch, caplog):
    every = costs(job)
    caplog.set_level("INFO", "omniscv")
    monkeypatch.setattr(estimates, "_PLANNED_CENTERS", 7)
    some = costs(job)
    assert "planned at 6 of 30 places and instants, which stand for the others" in caplog.text
    for whole, estimate in zip(every, some, strict=True):
        assert estimate.way == whole.way
        assert estimate.requests == pytest.approx(whole.requests, rel=0.02)
        assert estimate.pixels == pytest.approx(whole.pixels, rel=0.02)


def test_a_camera_is_planned_once_where_only_its_position_differs(job, monkeypatch):
    poses = [Pose.from_angles((x, 0.1, 1.5), yaw_deg=30) for x in np.linspace(-1, 1, 30)]
    plans = []
    made = Renderer.plan
    monkeypatch.setattr(Renderer, "plan", lambda *given, **how: plans.append(given) or made(*given, **how))
    (alone, *_) = costs(replace(job, poses=poses[:1]))
    (whole, *_) = costs(replace(job, poses=poses))
    assert len(plans) == 2
    assert whole == alone.times(30)


def test_a_rolling_shutter_is_planned_at_some_of_its_poses(monkeypatch):
    rolling = {
        "model": "rolling-shutter",
        "width": 32,
        "height": 24,
        "base": {"model": "pinhole", "fov_deg": 90},
    }
    line = {"waypoints": [[-1, -1, 1.4], [1, 1, 1.4]], "speed": 1, "rate": 3}
    moving = read({
        "source": "mock://four-wall",
        "cameras": {"rolling": {**rolling, "readout": 0.03}},
        "poses": {"path": line},
        "modes": ["lit", "depth"],
    }, Path())  # fmt: skip
    some = costs(moving)
    monkeypatch.setattr(estimates, "_PLANNED_POSES", 100)
    every = costs(moving)
    for estimate, whole in zip(some, every, strict=True):
        assert estimate.requests == pytest.approx(whole.requests, rel=0.05)  # turns are not all alike


@pytest.mark.parametrize("record", [None, "seen.sqlite"], ids=["a source", "a recording of the job"])
def test_times_are_of_measures_or_of_a_recording_and_change_no_plan(job, tmp_path, record, caplog):
    caplog.set_level("INFO", "omniscv")
    job = replace(job, source="mock://four-wall", poses=job.poses[:4], out=tmp_path / "out")
    plain = costs(job)
    assert {cost.seconds for cost in plain} == {None}
    if record is not None:
        job = replace(job, record=tmp_path / record)
        capture(job, job.record)
    timed = costs(job, measure=record is None)
    assert [replace(cost, seconds=None) for cost in timed] == plain
    assert min(cost.seconds for cost in timed) > 0
    assert ("measured: capture_ms=[" in caplog.text) == (record is None)
    assert not (tmp_path / "out").exists()


class Slow(SourceWrapper):
    """A source whose colours take 20 ms each, and depth 10 ms: other work is little beside that."""

    captured = 0

    def capture(self, requests):
        for request in requests:
            Slow.captured += 1
            time.sleep({"lit": 0.02, "depth": 0.01}[request.mode])
            yield from self._source.capture([request])


def test_measured_seconds_are_those_of_the_job(job, tmp_path, monkeypatch):
    """In the units of its sleeps, which no load of the machine makes shorter."""
    opener = lambda address, **options: Slow(open_source("scene://four-wall?traces=0"))  # noqa: E731
    monkeypatch.setitem(registry._openers, "slow", opener)
    job = replace(job, source="slow://", modes=("lit", "depth"), poses=job.poses[:3], out=tmp_path / "out")
    job = replace(job, recipe=Recipe())
    (auto, *_) = costs(job, measure=True)
    assert Slow.captured >= 4 + auto.requests / 2  # those of the first image, and of the next poses
    waits_s = 0.015 * auto.requests
    assert waits_s <= auto.seconds
    started = time.perf_counter()
    run(job)
    assert auto.seconds <= 2 * (time.perf_counter() - started) + 1  # other work is measured beside others'
