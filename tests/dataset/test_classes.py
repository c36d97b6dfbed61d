"""Classes by the names of objects: rules, ids, what is frozen, and names that no rule matches."""

import csv
from importlib.resources import files

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.command_line import ROOT
from support.datasets import CLASSES, image, job_file

from mock_server import load_scene
from omniscv import cli, dataset
from omniscv.chart import traced
from omniscv.cli.dataset import object_names
from omniscv.dataset import manifest
from omniscv.errors import ArgumentError, DatasetError, UnmatchedNamesError
from omniscv.frame.classes import class_rules
from omniscv.job import load
from omniscv.make import make

NAMES = st.lists(st.text("abcXY_12", min_size=1, max_size=5), min_size=1, max_size=12, unique=True)


@given(NAMES, st.integers(1, 4))
def test_the_first_rule_that_matches_wins(names, count):
    """Rules of one name each, then one of all: objects are of their first; ids go in the order of rules."""
    rules = [{"match": name, "class": f"c{i % count}"} for i, name in enumerate(names)]
    later = [{"match": "*", "class": "last"}]
    table = class_rules({"rules": rules + later}).table([*names, "-"])
    assert table.of_object == {name: f"c{i % count}" for i, name in enumerate(names)} | {"-": "last"}
    assert [each.id for each in table.classes.values()] == list(range(1, len(table.classes) + 1))


@given(st.permutations(range(6)), st.sets(st.integers(1, 9), max_size=5))
def test_ids_are_unique_and_those_that_are_given_are_kept(order, given_ids):
    rules = [{"match": f"n{i}", "class": f"c{i}"} for i in order]
    for rule, number in zip(rules, sorted(given_ids), strict=False):
        rule["id"] = number
    found = class_rules({"rules": rules})
    ids = {name: each.id for name, each in found.classes.items()}
    assert len(set(ids.values())) == len(ids)
    assert all(ids[rule["class"]] == rule["id"] for rule in rules if "id" in rule)
    free = [ids[rule["class"]] for rule in rules if "id" not in rule]
    assert free == sorted(free)
    assert class_rules(found.to_dict()) == found


def test_patterns_match_whole_names_and_see_case():
    rules = [{"match": "Chair_*", "class": "a"}, {"regex": "(Sofa|Stool)_[0-9]", "class": "b"}]
    rules = class_rules({"rules": rules})
    found = [rules.class_of(name) for name in ("Chair_1", "chair_1", "My_Chair_1", "Sofa_1", "Sofa_12")]
    assert found == ["a", None, None, "b", None]


def test_nyu40_is_shipped_as_a_table_whose_names_and_ids_stay():
    text = (files("omniscv.frame") / "taxonomies" / "nyu40.csv").read_text(encoding="utf-8")
    rows = {row["name"]: int(row["id"]) for row in csv.DictReader(text.splitlines())}
    assert sorted(rows.values()) == list(range(1, 41))
    known = {"wall": 1, "floor": 2, "chair": 5, "door": 8, "ceiling": 22, "lamp": 35, "otherprop": 40}
    assert rows.items() >= known.items()  # as Structured3D and ScanNet number them
    table = class_rules({"taxonomy": "nyu40", "rules": [{"match": "L*", "class": "lamp"}]})
    assert table.classes["lamp"].id == 35
    for rule, says in (({"class": "chairs"}, "one of wall"), ({"class": "chair", "id": 4}, "expected 5")):
        with pytest.raises(ArgumentError, match=says):
            class_rules({"taxonomy": "nyu40", "rules": [{"match": "a", **rule}]})


def test_wrong_rules_are_one_line():
    for rules, says in (
        ([{"match": "a", "class": "x", "id": 1}, {"match": "b", "class": "y", "id": 1}], "1 is 'x'; got 'y'"),
        ([{"match": c, "class": "x", "id": i} for i, c in enumerate("ab", start=1)], "[1]: id: expected 1"),
        ([{"match": c, "class": "x", "stuff": c == "a"} for c in "ab"], "stuff"),
        ([{"match": "a", "regex": "a", "class": "x"}], "expected one of 'match' and 'regex'"),
        ([{"class": "x"}], "expected one of 'match' and 'regex'"),
        ([{"regex": "(", "class": "x"}], "rules[0].regex: expected a regular expression"),
        ([], "expected a list of"),
    ):
        with pytest.raises(ArgumentError) as failed:
            class_rules({"rules": rules})
        assert says in str(failed.value)
        assert len(str(failed.value)) <= 300


def test_unmatched_names_are_listed_and_nothing_is_written(tmp_path, capsys):
    job = job_file(tmp_path)
    text = CLASSES.replace("unmatched: other", "unmatched: error")
    (tmp_path / "classes.yaml").write_text(text, encoding="utf-8")
    known = ("Layout", "Chair", "Door")
    expected = {name for name in object_names("four-wall") if not name.startswith(known)}
    assert len(expected) > 5
    assert cli.run(["dataset", "classes", "scene://four-wall", str(tmp_path / "classes.yaml")]) == 1
    listed = capsys.readouterr()
    assert cli.run(["dataset", "make", str(job)]) == 1
    refused = capsys.readouterr()
    for name in expected:
        assert name in listed.out
        assert name in listed.err
        assert name in refused.err
    with pytest.raises(UnmatchedNamesError) as failed:
        make(load(job))
    assert set(failed.value.names) == expected
    assert not (tmp_path / "dataset").exists()


def test_unmatched_names_may_be_other_or_nothing():
    for unmatched, known in (("other", "otherprop"), ("ignore", None)):
        data = {"taxonomy": "nyu40", "rules": [{"match": "Door", "class": "door"}], "unmatched": unmatched}
        table = class_rules(data).table(["Door", "Ball"])
        assert table.of_object.get("Ball") == known
        assert table.ids({"Door": 3, "Ball": 9})[[0, 3, 9]].tolist() == [0, 8, 40 if known else 0]


def test_names_come_from_scenes_sources_and_recordings():
    recording = str(ROOT / "captures" / "four-wall.sqlite")
    for place in ("four-wall", "scene://four-wall", "mock://four-wall", recording):
        names = object_names(place)
        assert {"Ball", "Layout_Floor"} <= set(names)
        assert list(names) == sorted(names)


def test_ids_are_frozen_by_name_across_scenes_and_time(tmp_path):
    """Objects of a second scene come after those of the first, whose ids stay, resumed or not; a closed
    dataset, which several processes write, refuses them."""
    first = image()
    second = image("scene://six-wall")
    with dataset.Writer(tmp_path / "both") as writer:
        writer.add("a", first, time=0.0)
        ids = dict(writer.manifest.names)
    with dataset.Writer(tmp_path / "both", resume=True) as writer:
        writer.add("a", first, time=0.0)
        writer.add("b", second, time=1.0)
    frames = dataset.open(tmp_path / "both")
    names = frames[1].instances
    assert ids == {name: i for i, name in enumerate(first.objects.names(), start=1)}
    late = sorted(set(second.objects.names()) - set(ids))
    assert names == {**ids, **{name: i for i, name in enumerate(late, start=len(ids) + 1)}}
    for frame, shown in zip(frames, (first, second), strict=True):
        labels = frame.layer("labels")
        for rank, name in enumerate(shown.objects.names(), start=1):
            np.testing.assert_array_equal(labels == names[name], shown.labels == rank)
    shared = set(first.objects.names()) & set(second.objects.names())
    assert any(second.objects.label(name) != names[name] for name in shared)
    begun = manifest.Manifest(names=ids)
    with dataset.Writer(tmp_path / "open", begun=begun) as writer:
        writer.add("b", second)
    assert dataset.open(tmp_path / "open")[0].instances == names
    with pytest.raises(DatasetError, match="expected the objects that the dataset was begun with"):
        dataset.Writer(tmp_path / "closed", begun=begun, closed=True).add("b", second)


def test_labels_and_classes_are_those_of_the_scene(whole):
    """Against exact tracing, away from the boundaries of objects; a table's legs are thinner than a pixel."""
    rules = class_rules(whole / "classes.yaml")
    scene = load_scene("four-wall")
    for frame in dataset.open(whole / "dataset"):
        traced_labels = traced(scene, frame.camera, frame.pose).label
        ids = {name: rules.classes[rules.class_of(name)].id for name in frame.instances}
        sure = frame.valid & ~frame.layer("label_edge")
        assert sure.mean() > 0.2
        for layer, wanted in (("labels", frame.instances), ("classes", ids)):
            of_label = {0: 0} | {scene.label(name): wanted[name] for name in scene.objects}
            found = frame.layer(layer)
            expected = np.vectorize(of_label.get)(traced_labels)
            assert (found == expected)[sure].mean() > 0.99
            assert not found[~frame.valid].any()
