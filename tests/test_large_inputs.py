"""What work grows with: opening a recording reads no capture, and nothing is done for each pair of things."""

import numpy as np
import pytest
from support.faces import CENTER, face_requests

import omniscv
from omniscv import Pose, truth
from omniscv.sources import ObjectTable
from omniscv.sources.labels import labels_of
from omniscv.sources.recording import replay
from omniscv.sources.unreal import instants
from omniscv.truth import Points, point_cloud


@pytest.fixture
def room(tmp_path):
    path = tmp_path / "room.sqlite"
    with omniscv.record(omniscv.open_source("scene://four-wall"), path) as source:
        list(source.capture(face_requests(8, ("depth",))))
    return path


def counted(monkeypatch, module, name):
    """Count the calls of a function of a module: a list of their first arguments."""
    function = getattr(module, name)
    calls = []

    def called(*values, **options):
        calls.append(values[0] if values else None)
        return function(*values, **options)

    monkeypatch.setattr(module, name, called)
    return calls


def test_a_recording_is_opened_and_replayed_without_its_other_views(room, monkeypatch):
    read = counted(monkeypatch, replay, "view_from_json")
    with omniscv.open_source(room) as source:
        list(source.capture(face_requests(8, ("depth",), CENTER)[:1]))
        assert read == []
        assert len(source.recorded_views()) == len(read) == 6


def test_labels_compare_no_colours_with_each_other():
    compared = []

    class Color(tuple):
        def __eq__(self, other):
            compared.append(other)
            return tuple.__eq__(self, other)

        __hash__ = tuple.__hash__

    colors = {f"object-{i:03d}": Color((i, 1, 2)) for i in range(1, 201)}
    labels, _ = labels_of(np.array(list(colors.values()), np.uint8), ObjectTable(colors))
    assert labels.tolist() == list(range(1, 201))
    assert len(compared) < 10 * len(colors)  # of a dictionary; each with each are 20,000


def test_noting_changes_describes_no_instant(monkeypatch):
    described = counted(monkeypatch, instants, "Instant")
    journal = instants.Journal("unreal://localhost:9000")
    described.clear()
    for i in range(50):
        journal.note("pose", f"Crate-{i}", Pose.from_angles((i, 0, 0)))
    assert len(journal.instant.poses) == 50
    assert journal.instant is journal.instant
    assert len(described) == 1


def test_clouds_are_joined_a_few_times_however_many(monkeypatch):
    thinned = counted(monkeypatch, point_cloud, "_thin")
    places = np.arange(6400.0).reshape(64, 100)
    clouds = [Points(np.column_stack([x, x, x]), np.ones(100)) for x in places]
    assert len(truth.merged(clouds, 0.1)) == 6400
    assert sum(map(len, thinned)) <= 4 * 6400  # with each cloud anew: 32 * 6400
