"""Sets of captures of a running game, over the wire: torn ones are refused, frozen ones are the scene's."""

import random

import numpy as np
import pytest
from support.worlds import CENTER, DIALECTS, SCENE, SIZE, at_time, serve

import mock_server
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


def strips(source, pose):
    return [omniscv.render(CIRCLE, pose, source, MODES, strategy="strips")]


def adaptive(source, pose):
    return [omniscv.render(CIRCLE, pose, source, MODES, strategy="adaptive", face_size=SIZE)]


def rig(source, pose):
    return list(omniscv.render_rig(RIG, pose, source, MODES, face_size=SIZE).values())


SHOTS = {"central": central, "strips": strips, "adaptive": adaptive, "rig": rig}
ABLE = [(dialect, shot) for dialect in DIALECTS for shot in SHOTS if (dialect, shot) != ("0.3.10", "strips")]
FEW = [("0.3.10", "central"), ("M", "central"), ("N1", "rig"), ("N2", "adaptive"), ("N3", "strips")]
LONG = [pytest.mark.soak, pytest.mark.timeout(3600)]
CASES = [(*each, 1) for each in FEW] + [pytest.param(*each, 100, marks=LONG) for each in ABLE]


def turned(seed):
    return omniscv.Pose.from_angles(CENTER, yaw_deg=random.Random(seed).uniform(-180, 180))


@pytest.mark.parametrize(("dialect", "shot", "seeds"), CASES)
def test_captures_of_a_running_game_are_never_delivered(dialect, shot, seeds):
    delivered = []
    for seed in range(seeds):
        step = random.Random(seed).choice([1 / 120, 1 / 60, 1 / 30])
        with (
            serve(dialect, time_step_s=step, seed=seed) as server,
            omniscv.open_source(server.uri, freeze="none") as source,
        ):
            try:
                SHOTS[shot](source, turned(seed))
            except TornSetError:
                continue
            delivered.append(seed)
    assert not delivered


@pytest.mark.parametrize("dialect", DIALECTS)
def test_a_frozen_game_shows_what_a_still_scene_does(dialect):
    pose, instant = turned(3), at_time(0.8)
    still = mock_server.serve(SCENE.at(0.8), dialect=dialect, size=(SIZE, SIZE), time_step_s=0.0)
    with still as server, omniscv.open_source(server.uri) as source:
        (wanted,) = central(source, pose)
    with (
        serve(dialect, time_step_s=0.02) as server,
        omniscv.open_source(server.uri) as source,
        source.at(instant) as frozen,
    ):
        assert frozen.capabilities.moves
        (image,) = central(frozen, pose)
    assert all(np.array_equal(image[name], wanted[name]) for name in LAYERS)


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
