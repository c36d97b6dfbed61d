"""Sets of captures of a running game, over the wire: torn ones are refused, frozen ones are the scene's."""

import random

import numpy as np
import pytest
from support.worlds import CENTER, SIZE, at_time, serve

import omniscv
from omniscv.cameras import create
from omniscv.cameras.rig import Rig, RigCamera
from omniscv.errors import TornSetError
from omniscv.geometry.instant import Instant
from omniscv.sources.recording.inspection import info

MODES = ("lit", "object_mask", "depth")
LAYERS = ("lit", "labels", "depth")
WIDE = create("equirectangular", width=16, height=8)
CIRCLE = create("noncentral-panorama", width=6, height=3, radius=0.2)
RIG = Rig({"left": RigCamera.turned(WIDE, (-0.1, 0, 0)), "right": RigCamera.turned(WIDE, (0.1, 0, 0))})


def central(source, pose):
    return [omniscv.render(WIDE, pose, source, MODES, face_size=SIZE)]


def exact(source, pose):
    return [omniscv.render(CIRCLE, pose, source, MODES, strategy="exact")]


def planned(source, pose):
    return [omniscv.render(CIRCLE, pose, source, MODES, face_size=SIZE)]


def rig(source, pose):
    return list(omniscv.render_rig(RIG, pose, source, MODES, face_size=SIZE).values())


SHOTS = {"central": central, "exact": exact, "planned": planned, "rig": rig}
FEW = [("0.3.10", "central"), ("M", "central"), ("N1", "rig"), ("N2", "planned"), ("N3", "exact")]


def turned(seed):
    return omniscv.Pose.from_angles(CENTER, yaw_deg=random.Random(seed).uniform(-180, 180))


@pytest.mark.parametrize(("dialect", "shot"), FEW)
def test_captures_of_a_running_game_are_never_delivered(dialect, shot):
    with (
        serve(dialect, time_step_s=1 / 60) as server,
        omniscv.open_source(server.uri, freeze="none") as source,
        pytest.raises(TornSetError),
    ):
        SHOTS[shot](source, turned(0))


@pytest.mark.parametrize("freeze", ["puppet", "pause", "batch"])
def test_every_way_to_freeze_is_proven_and_recorded(freeze, tmp_path):
    path, instant = tmp_path / "yard.sqlite", at_time(0.8)
    with (
        serve("N2", time_step_s=0.02) as server,
        omniscv.record(omniscv.open_source(server.uri, freeze=freeze), path) as source,
        source.at(instant) as frozen,
    ):
        (image,) = central(frozen, turned(0))
    assert len(info(path).states) == 1
    with omniscv.open_source(path) as replay, replay.at(instant) as there:
        (again,) = central(there, turned(0))
        assert set(there.instant.poses) == {"Ball"}
    assert all(np.array_equal(image[name], again[name]) for name in LAYERS)


def test_a_still_game_is_captured_as_before():
    """Nothing is proven, where nothing is known to move."""
    with serve("N1") as server, omniscv.open_source(server.uri) as source:
        assert not source.capabilities.moves
        with source.at(Instant()) as same:
            assert (same.state, same.capabilities.moves) == ("", False)


def test_a_pause_that_does_not_hold_is_found():
    """The game says that it is paused, and the objects move on."""
    with (
        serve("N1", time_step_s=0.02, faults=["ignore-pause"]) as server,
        omniscv.open_source(server.uri) as source,
        source.at(Instant(time=0.0)) as frozen,
        pytest.raises(TornSetError),
    ):
        central(frozen, turned(0))
