"""A recording holds one scene, and states of its world, each of which is replayed from its own captures."""

import json
from contextlib import closing, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.computed import Computed
from support.faces import face_requests
from support.recorder import SMALL, STATES, requests
from support.recordings import CountingSource, contents, filled

import mock_server
import omniscv
from omniscv.errors import (
    ArgumentError,
    MissingCaptureError,
    OtherMomentError,
    RecordingNotWritableError,
    TornSetError,
)
from omniscv.geometry import Pose
from omniscv.geometry.instant import Instant
from omniscv.importing.folders import export, import_folder
from omniscv.sources import Capabilities, ObjectTable, SceneIdentity, SourceWrapper
from omniscv.sources.recording.inspection import info, verify
from omniscv.sources.recording.store import Store
from omniscv.sources.recording.world_rows import WorldState
from omniscv.sources.scene import SceneSource
from omniscv.sources.stillness import verify_still

LATER, EMPTIER = STATES[1:]
SOME = [2, pytest.param(200, marks=[pytest.mark.soak, pytest.mark.timeout(1800)])]


@pytest.fixture(scope="module")
def scene():
    with omniscv.open_source("scene://workshop") as source:
        yield source


@pytest.fixture(scope="module")
def truth(scene):
    found = {}
    for instant in STATES:
        with scene.at(instant) as there:
            for capture in there.capture(requests(SMALL, instant.state)):
                found[capture.request] = capture.pixels
    return found


@pytest.fixture
def recorded(scene, tmp_path):
    return record_states(scene, tmp_path / "room.sqlite", STATES)


def poses_of(source):
    return {name: pose.to_dict() for name, pose in source.poses().items()}


def record_states(scene, path, instants):
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
            path = Path(folder) / "room.sqlite"
            held = set()
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
    pose = omniscv.Pose.from_angles((0.1, 0, 1.2))
    modes = ("lit", "object_mask", "depth")
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
    (still,) = requests(SMALL)[:1]
    (later,) = requests(SMALL, LATER.state)[:1]
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
    states = {instant.state: {"captures": 12, "instant": instant.to_dict()} for instant in STATES}
    assert info(again).states == info(recorded).states == states
    with omniscv.open_source(again) as replay, omniscv.open_source(recorded) as first:
        for instant in STATES:
            assert replay.at(instant).geometry().to_dict() == first.at(instant).geometry().to_dict()


def test_anew_replaces_captures_of_the_same_state_only(scene, recorded, truth):
    with omniscv.record(scene.at(Instant()), recorded, anew=True) as recording, recording.at(LATER) as source:
        list(source.capture(requests(SMALL, LATER.state)[:12]))
    counts = {state: each["captures"] for state, each in info(recorded).states.items()}
    assert counts == {instant.state: 12 for instant in STATES}
    with omniscv.open_source(recorded) as replay:
        for instant in STATES:
            for capture in replay.capture(requests(SMALL, instant.state)[:12]):
                assert np.array_equal(capture.pixels, truth[capture.request])


def test_an_instant_is_the_same_when_it_was_written():
    for instant in (*STATES, Instant({"Crate": Pose.from_angles((1, 2, 3), 40, 5, 6)}, name="x")):
        again = Instant.from_dict(json.loads(json.dumps(instant.to_dict())))
        assert (again.state, again.to_dict()) == (instant.state, instant.to_dict())


class Found(SourceWrapper):
    """A world that is paused, not set: it is found where it is."""

    def at(self, instant):
        return super().at(LATER)


def test_a_state_that_was_found_is_replayed_for_what_was_to_be_set(scene, truth, tmp_path):
    path = tmp_path / "room.sqlite"
    wanted = Instant(time=5.0)
    with omniscv.record(Found(scene.at(Instant())), path) as recording, recording.at(wanted) as source:
        assert (source.state, source.instant.to_dict()) == (LATER.state, LATER.to_dict())
        list(source.capture(requests(SMALL, source.state)[:6]))
    with omniscv.open_source(path) as replay:
        for there in (replay.at(wanted), replay.at(LATER)):
            assert there.instant.to_dict() == LATER.to_dict()
            for capture in there.capture(requests(SMALL, there.state)[:6]):
                assert np.array_equal(capture.pixels, truth[capture.request])


LIT = face_requests(size=16, modes=("lit",))
ELSEWHERE = face_requests(size=16, modes=("lit",), center=(0.2, 0.0, 1.5))


def record(address, path, requests=LIT):
    live = CountingSource(omniscv.open_source(address))
    filled(path, requests, live)
    return live.requests


@pytest.fixture
def room(tmp_path):
    path = tmp_path / "room.sqlite"
    record("mock://four-wall", path)
    return path


@pytest.mark.parametrize("address", ["scene://six-wall", "mock://six-wall?dialect=0.3.10&size=16x16"])
def test_another_scene_is_refused_in_a_sentence_that_names_both(address, room):
    before = contents(room)
    says = r"captures of the scene 'four-wall'.*, got 'six-wall'.*; record into another file$"
    with pytest.raises(RecordingNotWritableError, match=says) as error:
        record(address, room)
    assert len(str(error.value).splitlines()) == 1
    assert contents(room) == before


@pytest.mark.parametrize("address", ["mock://four-wall", "scene://four-wall"])
def test_the_same_scene_is_resumed(address, room):
    assert record(address, room, [*LIT, *ELSEWHERE]) == ELSEWHERE
    assert verify(room).captures == 12


def test_a_scene_of_the_same_name_with_other_content_is_refused(tmp_path):
    path = tmp_path / "room.sqlite"
    scene = mock_server.load_scene("four-wall")
    record("scene://four-wall", path)
    ball = {"objects": {"Ball": {"solids": [{"sphere": 0.5, "at": [1, 0, 1]}]}}}
    other = SceneSource(mock_server.Scene(scene.name, ball))
    with pytest.raises(RecordingNotWritableError, match=r"content '.*', got 'four-wall', content"):
        omniscv.record(other, path)
    assert record("scene://four-wall", path) == []


class Level(SourceWrapper):
    def __init__(self, identity):
        super().__init__(omniscv.open_source("scene://four-wall"))
        self.identity = identity

    @property
    def scene_identity(self):
        return self.identity


def test_levels_of_one_project_are_scenes_of_their_own(tmp_path):
    path = tmp_path / "room.sqlite"
    kitchen = SceneIdentity("House", "Kitchen")
    for identity, count in ((SceneIdentity("House"), 1), (kitchen, 2)):
        filled(path, LIT[:count], Level(identity))
    says = "'House', level 'Kitchen', got 'House', level 'Garden'"
    game = Level(kitchen)
    with omniscv.record(game, path) as source:
        game.identity = SceneIdentity("House", "Garden")  # the player leaves the level
        with pytest.raises(RecordingNotWritableError, match=says):
            list(source.capture(LIT[2:]))
    with pytest.raises(RecordingNotWritableError, match=says):
        omniscv.record(game, path)
    with omniscv.open_source(path) as replay:
        assert replay.scene_identity == kitchen


def test_captures_of_two_scenes_are_neither_recorded_nor_imported(room, tmp_path):
    before = room.read_bytes()
    says = "expected captures of the scene 'four-wall', got 'six-wall'"
    refused = pytest.raises(RecordingNotWritableError, match=says)
    with omniscv.open_source("mock://six-wall") as source, closing(Store(room, write=True)) as store, refused:
        store.add(next(source.capture(ELSEWHERE)))
    assert room.read_bytes() == before
    export(room, tmp_path / "faces")
    index = json.loads((tmp_path / "faces" / "captures.json").read_text())
    index[0]["provenance"]["scene"] = "six-wall"
    (tmp_path / "faces" / "captures.json").write_text(json.dumps(index))
    (tmp_path / "faces" / "scene.json").unlink()
    with pytest.raises(ArgumentError, match="of one scene, got some of 'four-wall' and 'six"):
        import_folder(tmp_path / "faces", tmp_path / "again.sqlite")
    assert not (tmp_path / "again.sqlite").exists()


class Plain(Computed):
    def __init__(self, table):
        super().__init__(lambda view: np.zeros((view.height, view.width, 3), np.uint8))
        self.table = table

    def objects(self):
        return self.table


SOFA = ObjectTable({"Sofa": (9, 0, 0)})
CAT = ObjectTable({"Cat": (8, 0, 0)})


def test_objects_none_of_which_is_known_are_another_scenes(tmp_path):
    path = tmp_path / "room.sqlite"
    with omniscv.record(Plain(SOFA), path) as source:
        source.objects()
        list(source.capture(LIT))
    refused = pytest.raises(RecordingNotWritableError, match=r"'Sofa'.*'Cat'")
    with omniscv.record(Plain(CAT), path) as source, refused:
        source.objects()
    with omniscv.record(Plain(ObjectTable({**SOFA.colors, **CAT.colors})), path) as source:
        assert source.objects().names() == ["Cat", "Sofa"]


def test_masks_are_never_recorded_without_their_objects(tmp_path):
    """Whoever records them: later objects of other colours would name them."""
    path = filled(tmp_path / "room.sqlite", face_requests(size=16, modes=("object_mask",)), Plain(SOFA))
    before = contents(path)
    assert before[1].names() == ["Sofa"]
    for other, says in (
        ({"Sofa": (1, 1, 1)}, r"of its object masks, but 'Sofa' is \(1, 1, 1\) and was \(9, 0, 0\)"),
        ({**SOFA.colors, "Cat": (9, 0, 0)}, r"'Cat' is \(9, 0, 0\), which was 'Sofa'"),
    ):
        refused = pytest.raises(RecordingNotWritableError, match=says)
        with omniscv.record(Plain(ObjectTable(other)), path) as source, refused:
            list(source.capture(face_requests(size=16, modes=("object_mask",), center=(1.0, 0.0, 0.0))))
        assert contents(path) == before


@pytest.mark.parametrize("anew", [False, True])
def test_the_description_of_a_state_is_written_once_and_anew_when_it_is_captured_anew(anew, scene, recorded):
    """What a file says of a state stays with what it shows of it; captured anew, both are new."""
    state = LATER.state
    with closing(Store(recorded, write=True)) as store:
        moving = {*store.state(state).poses}
        store.set_state(state, WorldState())
    assert len(moving) > 2
    with omniscv.record(scene.at(Instant()), recorded, anew=anew) as recording, recording.at(LATER) as source:
        list(source.capture(requests(SMALL, state)[12:]))
    with closing(Store(recorded)) as store:
        assert {*store.state(state).poses} == (moving if anew else set())


def test_the_still_world_is_no_state_also_after_others_were_captured(tmp_path):
    path = tmp_path / "room.sqlite"
    with omniscv.open_source("mock://four-wall") as live, omniscv.record(live, path) as source:
        with source.world.changes():
            source.world.hide("Sofa")
            hidden = source.state
            list(source.capture(requests(SMALL, hidden)[:2]))
        assert source.state == ""
        list(source.capture(requests(SMALL)[:2]))
    with closing(Store(path)) as store:
        assert set(store.states()) == {hidden}


class Moving(SourceWrapper):
    """A source that counts how often one instant is asked of it."""

    capabilities = Capabilities(frozenset(("lit", "depth")), moves=True)
    instants = 0

    @contextmanager
    def one_instant(self):
        self.instants += 1
        yield


@pytest.mark.parametrize(("torn", "succeeds"), [(0, True), (1, True), (2, True), (3, False)])
def test_a_set_that_is_torn_is_made_anew_three_times_at_most(torn, succeeds, scene):
    source = Moving(scene)
    tries = []

    def make(watched):
        tries.append(watched)
        if len(tries) <= torn:
            raise TornSetError("it moved")
        return "whole"

    if succeeds:
        assert verify_still(source, ("lit",), make) == "whole"
    else:
        with pytest.raises(TornSetError, match="it moved"):
            verify_still(source, ("lit",), make)
    assert len(tries) == source.instants == min(torn + 1, 3)


def test_a_set_of_another_moment_than_the_recordings_is_not_made_anew(scene):
    source = Moving(scene)

    def make(watched):
        raise OtherMomentError("the recording shows another moment")

    with pytest.raises(OtherMomentError):
        verify_still(source, ("lit",), make)
    assert source.instants == 1
