"""A recording holds one scene: captures of another one are refused, a resumed recording never is."""

import json
from contextlib import closing

import numpy as np
import pytest
from support.faces import face_requests
from support.recordings import CountingSource, contents

import mock_server
import omniscv
from omniscv.errors import ArgumentError, RecordingNotWritableError
from omniscv.sources import Capture, ObjectTable, SceneIdentity, Source, SourceWrapper
from omniscv.sources.recording.folders import export, import_folder
from omniscv.sources.recording.inspection import verify
from omniscv.sources.recording.store import Store
from omniscv.sources.scene import SceneSource

LIT = face_requests(size=16, modes=("lit",))
ELSEWHERE = face_requests(size=16, modes=("lit",), center=(0.2, 0.0, 1.5))


def record(address, path, requests=LIT):
    live = CountingSource(omniscv.open_source(address))
    with omniscv.record(live, path) as source:
        list(source.capture(requests))
    return live.requests


@pytest.fixture
def room(tmp_path):
    """Colours of the four-wall room, without object masks."""
    path = tmp_path / "room.sqlite"
    record("mock://four-wall", path)
    return path


@pytest.mark.parametrize(
    "address", ["mock://six-wall", "scene://six-wall", "mock://six-wall?dialect=0.3.10&size=16x16"]
)
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
    """Known where the scene is traced in the same process."""
    path, scene = tmp_path / "room.sqlite", mock_server.load_scene("four-wall")
    record("scene://four-wall", path)
    ball = {"objects": {"Ball": {"solids": [{"sphere": 0.5, "at": [1, 0, 1]}]}}}
    other = SceneSource(mock_server.Scene(scene.name, ball))
    with pytest.raises(
        RecordingNotWritableError, match=r"'four-wall', content '.*', got 'four-wall', content"
    ):
        omniscv.record(other, path)
    assert record("scene://four-wall", path) == []


class Level(SourceWrapper):
    """A game whose level is known."""

    def __init__(self, identity):
        super().__init__(omniscv.open_source("scene://four-wall"))
        self.identity = identity

    @property
    def scene_identity(self):
        return self.identity


def test_levels_of_one_project_are_scenes_of_their_own(tmp_path):
    path, kitchen = tmp_path / "room.sqlite", SceneIdentity("House", "Kitchen")
    with omniscv.record(Level(SceneIdentity("House")), path) as source:
        list(source.capture(LIT[:1]))
    with omniscv.record(Level(kitchen), path) as source:
        list(source.capture(LIT[:2]))
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
    with pytest.raises(
        ArgumentError, match="expected captures of one scene, got some of 'four-wall' and 'six"
    ):
        import_folder(tmp_path / "faces", tmp_path / "again.sqlite")
    assert not (tmp_path / "again.sqlite").exists()


class Plain(Source):
    """A source that knows nothing of its scene but the objects."""

    def __init__(self, table):
        self.table = table

    @property
    def capabilities(self):
        return omniscv.sources.Capabilities()

    def objects(self):
        return self.table

    def capture(self, requests):
        for request in requests:
            shape = request.view.height, request.view.width, 3
            yield Capture(request, request.view, np.zeros(shape, np.uint8))


SOFA, CAT = ObjectTable({"Sofa": (9, 0, 0)}), ObjectTable({"Cat": (8, 0, 0)})


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


@pytest.mark.parametrize(
    ("other", "says"),
    [
        (
            {"Sofa": (1, 1, 1)},
            r"mask colours of its object masks, but 'Sofa' is \(1, 1, 1\) and was \(9, 0, 0\)",
        ),
        ({**SOFA.colors, "Cat": (9, 0, 0)}, r"'Cat' is \(9, 0, 0\), which was 'Sofa'"),
    ],
)
def test_masks_are_never_recorded_without_their_objects(other, says, tmp_path):
    """Whoever records them: later objects of other colours would name them."""
    path = tmp_path / "room.sqlite"
    masks = face_requests(size=16, modes=("object_mask",))
    with omniscv.record(Plain(SOFA), path) as source:
        list(source.capture(masks))
    before = contents(path)
    assert before[1].names() == ["Sofa"]
    refused = pytest.raises(RecordingNotWritableError, match=says)
    with omniscv.record(Plain(ObjectTable(other)), path) as source, refused:
        list(source.capture(face_requests(size=16, modes=("object_mask",), center=(1.0, 0.0, 0.0))))
    assert contents(path) == before
