"""Replay: what a missing capture says, and which views cover another."""

import sys
from collections import Counter

import numpy as np
import pytest
from support.faces import face_requests

import omniscv
from omniscv.errors import MissingCaptureError
from omniscv.geometry import Pose
from omniscv.sources import Request, View

POSE = Pose.from_angles((0.0, 0.0, 1.5))
VIEW = View(POSE, 90.0, 32, 32)


NEAR = {
    "position by 0.001 m: (0, 0, 1.5) recorded, (0.001, 0, 1.5) requested": View(
        Pose((0.001, 0, 1.5), POSE.rotation), 90.0, 32, 32
    ),
    "position by 1e-06 m: (0, 0, 1.5) recorded, (0, 0, 1.500001) requested": View(
        Pose((0, 0, 1.500001), POSE.rotation), 90.0, 32, 32
    ),
    "orientation by 0.0001 deg of yaw, pitch, roll: (0, 0, 0) recorded, (0.0001, 0, 0) requested": View(
        Pose.from_angles((0, 0, 1.5), yaw_deg=1e-4), 90.0, 32, 32
    ),
    "field of view by 2e-06 deg: (90) recorded, (90.000002) requested": View(POSE, 90.000002, 32, 32),
    "size: 32 x 32 recorded, 32 x 31 px requested": View(POSE, 90.0, 32, 31),
}


@pytest.mark.parametrize("says", NEAR)
def test_a_missing_view_says_by_how_much_the_nearest_differs(says, recorded):
    message = missing(recorded, Request(NEAR[says], "lit"))
    assert f"; the nearest recorded view differs in {says}; 'omniscv recording places " in message


def missing(path, request):
    with omniscv.open_source(path) as replay, pytest.raises(MissingCaptureError) as error:
        next(replay.capture([request]))
    return str(error.value)


def test_views_turned_about_the_axis_cover_a_view(tmp_path):
    """As plugin 0.3.10 is recorded straight up and down; recorded in fewer modes they do not."""
    up = View(Pose.from_angles((0, 0, 1.5), pitch_deg=90), 90.0, 16, 16)
    half = View(Pose(up.pose.position, up.pose.rotation @ np.diag([-1.0, -1.0, 1.0])), 90.0, 16, 16)
    others = [
        View(Pose((0, 0.1, 1.5), half.pose.rotation), 90.0, 16, 16),
        View(half.pose, 91.0, 16, 16),
        View(half.pose, 90.0, 16, 8),
        View(Pose.from_angles((0, 0, 1.5), pitch_deg=89.99), 90.0, 16, 16),
    ]
    path = tmp_path / "room.sqlite"
    with omniscv.record(omniscv.open_source("scene://four-wall"), path) as source:
        list(source.capture(Request(view, "lit") for view in (up, half, *others)))
    with omniscv.open_source(path) as replay:
        assert replay.cover(up) == (up, half)
        assert replay.cover(half) == (half, up)
        assert replay.cover(others[0]) == (others[0],)
        assert replay.cover(VIEW) == (VIEW,)
    with omniscv.record(omniscv.open_source("scene://four-wall"), path) as source:
        list(source.capture([Request(up, "depth")]))
    with omniscv.open_source(path) as replay:
        assert replay.cover(up) == (up,)


def calls_to_open(path):
    """How many functions of Python opening a recording calls."""
    calls = Counter()
    sys.setprofile(lambda frame, event, _: calls.update([event]))
    try:
        source = omniscv.open_source(path)
    finally:
        sys.setprofile(None)
    source.close()
    return calls["call"]


def test_opening_reads_no_views(tmp_path):
    """A recording of 20,000 captures opens at once: a row costs its checksum, and nothing else."""
    path = tmp_path / "room.sqlite"
    with omniscv.open_source("scene://four-wall") as scene, omniscv.record(scene, path) as source:
        list(source.capture(face_requests(4, ("lit",))))
        few = [calls_to_open(path) for _ in range(2)][-1]
        many = face_requests(4, ("lit",), (0.5, 0.0, 1.5)) + face_requests(4, ("lit",), (0.0, 0.5, 1.5))
        list(source.capture(many))
    assert calls_to_open(path) - few < 30 * len(many)
