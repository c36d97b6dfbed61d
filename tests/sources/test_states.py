"""States of the world in recordings: each is replayed from its own captures, whatever happened."""

import json
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.recorder import SMALL, STATES, requests
from support.recordings import contents

import omniscv
from omniscv.errors import ArgumentError, MissingCaptureError
from omniscv.geometry import Pose
from omniscv.geometry.instant import Instant
from omniscv.sources import SourceWrapper
from omniscv.sources.recording.folders import export, import_folder
from omniscv.sources.recording.inspection import info, verify

LATER, EMPTIER = STATES[1:]
SOME = [2, pytest.param(200, marks=[pytest.mark.soak, pytest.mark.timeout(1800)])]


@pytest.fixture(scope="module")
def scene():
    with omniscv.open_source("scene://workshop") as source:
        yield source


@pytest.fixture(scope="module")
def truth(scene):
    """By request, what the scene shows, traced at its instant."""
    found = {}
    for instant in STATES:
        with scene.at(instant) as there:
            for capture in there.capture(requests(SMALL, instant.state)):
                found[capture.request] = capture.pixels
    return found


@pytest.fixture
def recorded(scene, tmp_path):
    """A recording of the same few views in all states."""
    return record(scene, tmp_path / "room.sqlite", STATES)


def poses_of(source):
    return {name: pose.to_dict() for name, pose in source.poses().items()}


def record(scene, path, instants):
    with omniscv.record(scene.at(Instant()), path) as recording:
        for instant in instants:
            with recording.at(instant) as source:
                list(source.capture(requests(SMALL, source.state)[:12]))
    return path


SETS = st.sampled_from(["each", "whole"])
STEPS = st.tuples(st.integers(0, len(STATES) - 1), st.integers(0, 40), st.integers(1, 48), SETS)
RUNS = st.tuples(st.lists(STEPS, max_size=3), st.none() | STEPS)


@pytest.mark.parametrize("examples", SOME)
def test_states_never_mix(examples, processes, truth):
    """Whatever is recorded in which order, killed, and resumed: what is held is what its state shows."""

    @settings(max_examples=examples)
    @given(st.lists(RUNS, min_size=1, max_size=3))
    def check(runs):
        with TemporaryDirectory() as folder:
            path, held = Path(folder) / "room.sqlite", set()
            for steps, unfinished in runs:
                plan = [*steps, *([] if unfinished is None else [(*unfinished[:3], "killed")])]
                processes.run("states", path, json.dumps(plan))
                for which, first, last, _ in steps:
                    held.update(requests(SMALL, STATES[which].state)[first:last])
                assert verify(path).ok
                with omniscv.open_source(path) as replay:
                    for request, pixels in truth.items():
                        if request in held:
                            (capture,) = replay.capture([request])
                            assert capture.request == request
                            assert np.array_equal(capture.pixels, pixels)
                        else:
                            with pytest.raises(MissingCaptureError):
                                list(replay.capture([request]))

    check()


def test_images_are_replayed_of_their_own_state(scene, recorded):
    camera = omniscv.cameras.create("equirectangular", width=16, height=8)
    pose, modes = omniscv.Pose.from_angles((0.1, 0, 1.2)), ("lit", "object_mask", "depth")
    with omniscv.record(scene.at(Instant()), recorded) as recording:
        for instant in STATES:
            with recording.at(instant) as source:
                omniscv.render(camera, pose, source, modes, face_size=8)
    shown = []
    with omniscv.open_source(recorded) as replay:
        for instant in (*STATES, *STATES):
            with replay.at(instant) as there, scene.at(instant) as live:
                image, wanted = (omniscv.render(camera, pose, s, modes, face_size=8) for s in (there, live))
                assert all(np.array_equal(image[name], wanted[name]) for name in ("depth", "lit"))
                assert there.geometry().to_dict()["boxes"] == live.geometry().to_dict()["boxes"]
                assert (there.state, there.instant.to_dict()) == (instant.state, instant.to_dict())
                if instant.state:
                    assert poses_of(there) == poses_of(live)
                shown.append(image.depth.tobytes())
    assert len(set(shown)) == len(STATES)


def test_a_miss_names_the_states_that_are_held(recorded):
    with omniscv.open_source(recorded) as replay:
        with pytest.raises(MissingCaptureError, match=f"the still one, '{LATER.state}', '{EMPTIER.state}'"):
            replay.at(Instant(time=9.0))
        (unknown,) = requests(SMALL, "dusk")[:1]
        with pytest.raises(MissingCaptureError, match=f"in state 'dusk'; .* '{LATER.state}'"):
            list(replay.capture([unknown]))
        with replay.at(LATER) as there, pytest.raises(MissingCaptureError, match="nearest recorded view"):
            list(there.capture(requests(SMALL, LATER.state)[24:]))


def test_a_live_source_refuses_requests_of_another_state(scene):
    (still,), (later,) = requests(SMALL)[:1], requests(SMALL, LATER.state)[:1]
    with scene.at(LATER) as there:
        for source, request in ((scene, later), (there, still)):
            with pytest.raises(ArgumentError, match="expected requests of the world as it is"):
                list(source.capture([request]))
    with omniscv.open_source("mock://four-wall") as live, pytest.raises(ArgumentError, match="state"):
        list(live.capture([later]))


def test_folders_hold_states(recorded, tmp_path):
    again = tmp_path / "again.sqlite"
    assert export(recorded, tmp_path / "faces") == import_folder(tmp_path / "faces", again) == 36
    assert contents(again) == contents(recorded)
    assert (
        info(again).states
        == info(recorded).states
        == {instant.state: {"captures": 12, "instant": instant.to_dict()} for instant in STATES}
    )
    with omniscv.open_source(again) as replay, omniscv.open_source(recorded) as first:
        for instant in STATES:
            assert replay.at(instant).geometry().to_dict() == first.at(instant).geometry().to_dict()


def test_anew_replaces_captures_of_the_same_state_only(scene, recorded, truth):
    with omniscv.record(scene.at(Instant()), recorded, anew=True) as recording, recording.at(LATER) as source:
        list(source.capture(requests(SMALL, LATER.state)[:12]))
    assert {state: each["captures"] for state, each in info(recorded).states.items()} == dict.fromkeys(
        (instant.state for instant in STATES), 12
    )
    with omniscv.open_source(recorded) as replay:
        for instant in STATES:
            for capture in replay.capture(requests(SMALL, instant.state)[:12]):
                assert np.array_equal(capture.pixels, truth[capture.request])


@pytest.mark.parametrize(
    "instant", [*STATES, Instant({"Crate": Pose.from_angles((1, 2, 3), 40, 5, 6)}, name="x")]
)
def test_an_instant_is_the_same_when_it_was_written(instant):
    again = Instant.from_dict(json.loads(json.dumps(instant.to_dict())))
    assert (again.state, again.to_dict()) == (instant.state, instant.to_dict())


@pytest.mark.parametrize("change", [None, {"poses": {"Crate": {}}}, {"time": "soon"}, {"hidden": "Crate"}])
def test_what_is_no_instant_is_an_argument_error(change):
    with pytest.raises(ArgumentError):
        Instant.from_dict([] if change is None else Instant().to_dict() | change)


class Found(SourceWrapper):
    """A world that is paused, not set: it is found where it is."""

    def at(self, instant):
        return super().at(LATER)


def test_a_state_that_was_found_is_replayed_for_what_was_to_be_set(scene, truth, tmp_path):
    path, wanted = tmp_path / "room.sqlite", Instant(time=5.0)
    with omniscv.record(Found(scene.at(Instant())), path) as recording, recording.at(wanted) as source:
        assert (source.state, source.instant.to_dict()) == (LATER.state, LATER.to_dict())
        list(source.capture(requests(SMALL, source.state)[:6]))
    with omniscv.open_source(path) as replay:
        for there in (replay.at(wanted), replay.at(LATER)):
            assert there.instant.to_dict() == LATER.to_dict()
            for capture in there.capture(requests(SMALL, there.state)[:6]):
                assert np.array_equal(capture.pixels, truth[capture.request])
