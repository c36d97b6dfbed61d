"""Jobs that move objects of a game: what they do not move stands still, and replay needs no game."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from PIL import Image
from support.datasets import tree

import mock_server
from mock_server import load_scene
from omniscv import Pose, dataset, open_source
from omniscv.chart import traced
from omniscv.job import load
from omniscv.make import make, run

JOB = """
source: {uri}
cameras: {{pano: {{model: equirectangular, width: 48, height: 24}}}}
poses: [{{position: [0, 0, 1.2]}}]
modes: [object_mask, depth]
face_size: 32
record: kept.sqlite
out: made
freeze: {freeze}
{more}
"""
TIMES = "times: [0, 0.5, 1]\ntruth: {boxes3d: true, flow: {scene: true}}\n"
SLIDE = "motions: {Cabinet: [{time: 0, position: [-2, -0.6, 0.85]}, {time: 2, position: [-1.2, 0.8, 0.85]}]}"


@pytest.fixture(scope="module")
def server():
    with mock_server.serve("workshop", size=(64, 64), time_step_s=0.05) as running:
        yield running


def made(folder, server, freeze, more=""):
    """Make the dataset of a job, and make it again from its recording: the same bytes; return its frames."""
    (folder / "job.yaml").write_text(
        JOB.format(uri=server.uri, freeze=freeze, more=TIMES + more), encoding="utf-8"
    )
    job = load(folder / "job.yaml")
    make(job)
    again = replace(job, source=str(folder / "kept.sqlite"), record=None, freeze=None, out=folder / "again")
    make(again)
    assert tree(folder / "again") == tree(folder / "made")
    return dataset.open(folder / "made")


def boxes(frame):
    return {box["name"]: np.array(box["center_world"]) for box in frame.truth["boxes3d"]}


def test_other_objects_stand_still_from_frame_to_frame(server, tmp_path):
    """The game is paused in between too; afterwards it runs, and the object is where it was."""
    with_box = np.array(server.world.placed().bounds("Cabinet"))
    frames = made(tmp_path, server, "puppet", SLIDE)
    for one, two in pairwise(map(boxes, frames)):
        for name in one.keys() & two.keys() - {"Cabinet"}:
            np.testing.assert_allclose(one[name], two[name], atol=1e-4)
    for time, frame in zip((0, 0.5, 1), frames, strict=True):
        place = (-2 + 0.4 * time, -0.6 + 0.7 * time, 0.85)
        np.testing.assert_allclose(frame.truth["poses"]["Cabinet"]["position"], place, atol=1e-9)
        np.testing.assert_allclose(boxes(frame)["Cabinet"], place, atol=1e-3)
    np.testing.assert_allclose(server.world.placed().bounds("Cabinet"), with_box, atol=1e-6)
    assert not server.world.paused


def test_a_game_that_is_paused_where_it_is_has_the_poses_that_were_read(server, tmp_path):
    """Objects that move by themselves go on between frames; the boxes of each are where its poses say."""
    frames = made(tmp_path, server, "pause")
    places = [np.array(frame.truth["poses"]["Crate"]["position"]) for frame in frames]
    assert len({tuple(place.round(3)) for place in places}) > 1  # no tick may fall between two of them
    for frame, place in zip(frames, places, strict=True):
        np.testing.assert_allclose(boxes(frame)["Crate"], place, atol=1e-3)


def test_a_job_without_times_shows_the_world_where_it_is(server, tmp_path):
    """Two places, one instant: it is paused in between, and its replay needs no word of it."""
    (tmp_path / "job.yaml").write_text(JOB.format(uri=server.uri, freeze="auto", more=""), encoding="utf-8")
    poses = tuple(Pose.from_angles((x, 0, 1.2)) for x in (0, 0.3))
    run(job := replace(load(tmp_path / "job.yaml"), poses=poses))  # pauses, as the job moves nothing
    assert not server.world.paused
    with open_source(tmp_path / "kept.sqlite") as source:
        (state,) = source.states()
        assert source.state == state != ""
        placed = {name: (each.rotation, each.position) for name, each in source.instant.poses.items()}
        scene = load_scene("workshop").at(0, placed)
        for i, pose in enumerate(job.poses):
            hits = traced(scene, job.cameras["pano"], pose)
            labels = np.array(Image.open(tmp_path / "made" / f"pano-{i}.labels.png"))
            assert (labels != hits.label).mean() < 0.06  # faces of 32 px
    replayed = {"source": str(tmp_path / "kept.sqlite"), "record": None, "freeze": None}
    again = replace(job, **replayed, out=tmp_path / "again")
    run(again)
    for name in ("pano-0.depth.exr", "pano-1.labels.png"):
        assert (tmp_path / "again" / name).read_bytes() == (tmp_path / "made" / name).read_bytes()
