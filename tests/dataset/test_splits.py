"""Splits: places are never divided, and stay where they are when frames are added."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import pdist
from support.cases import cases

from omniscv import dataset
from omniscv.dataset import manifest
from omniscv.errors import ArgumentError
from omniscv.job import load
from omniscv.job.recipe import Split, read_split
from omniscv.make import make

SPLIT = Split({"train": 0.7, "val": 0.2, "test": 0.1}, distance_m=1.0)
_PLACE = st.tuples(st.floats(-6, 6), st.floats(-6, 6), st.floats(0, 2))
POSITIONS = st.lists(_PLACE, min_size=2, max_size=25).map(np.array)


@cases(50)
@given(POSITIONS)
def test_places_are_those_of_single_linkage(positions):
    """Judged by SciPy's clustering: what is nearer than the distance is of one place, by chains too."""
    places = SPLIT.places(positions)
    if np.abs(pdist(positions) - SPLIT.distance_m).min() < 1e-9:
        return
    clusters = fcluster(linkage(positions, "single"), SPLIT.distance_m, "distance")
    same = np.equal.outer(places, places)
    np.testing.assert_array_equal(same, np.equal.outer(clusters, clusters))


@cases(50)
@given(POSITIONS, POSITIONS)
def test_places_stay_in_their_split_when_others_come(before, after):
    both = np.concatenate([before, after + 100])
    assert SPLIT.places(both)[: len(before)] == SPLIT.places(before)


def test_a_place_that_is_given_is_kept():
    positions = np.zeros((3, 3))
    assert SPLIT.places(positions, ("a", "", "b")) == ("a", "0.000,0.000,0.000", "b")


SHARES = st.sampled_from([
    {"train": 0.8, "val": 0.2},
    {"train": 1 / 3, "val": 2 / 3},
    {"train": 0.7, "val": 0.2, "test": 0.1},
    {"a": 0.25, "b": 0.25, "c": 0.25, "d": 0.25},
    {"train": 0.97, "val": 0.0, "test": 0.03},
])  # fmt: skip


@cases(50)
@given(SHARES, st.integers(0, 200), st.integers(0, 9))
def test_shares_of_a_job_are_kept_within_one_place(shares, count, seed):
    found = Split(shares, seed=seed).divide(f"{i}" for i in range(count))
    assert len(found) == count
    for split, share in shares.items():
        off = abs(sum(other == split for other in found.values()) - share * count)
        assert off < 1 if len(shares) == 2 else off <= 1


def test_sixty_places_are_divided_as_asked_and_not_every_fifth():
    found = list(Split({"train": 0.8, "val": 0.2}).divide(f"{i}" for i in range(60)).values())
    assert (found.count("train"), found.count("val")) == (48, 12)
    assert len({number % 5 for number, split in enumerate(found) if split == "val"}) >= 3


@cases(50)
@given(SHARES, st.integers(0, 60), st.integers(0, 60))
def test_places_that_are_added_move_no_others(shares, count, more):
    places = [f"{i}" for i in range(count + more)]
    before = Split(shares).divide(places[:count])
    assert before.items() <= Split(shares).divide(places).items()
    assert Split(shares).divide([*places, *places]) == Split(shares).divide(places)


def test_shares_by_hash_are_kept_on_average_and_another_seed_shares_otherwise():
    places = [f"{i}" for i in range(4000)]
    found = [SPLIT.of(place) for place in places]
    for split, share in SPLIT.shares.items():
        assert abs(found.count(split) / len(places) - share) < 4 * np.sqrt(share * (1 - share) / len(places))
    assert found == [SPLIT.of(place) for place in places]
    assert found != [Split(SPLIT.shares, seed=1).of(place) for place in places]
    assert {Split({"a": 0.0, "b": 1.0}).of(place) for place in places} == {"b"}


def test_a_split_without_frames_gives_a_warning(tmp_path):
    at = [{"position": [x, 0, 1.5]} for x in (0, 0.3)]
    lines = []
    job = {"source": "scene://four-wall", "poses": at, "face_size": 16, "out": str(tmp_path / "out")}
    lens = {"model": "equirectangular", "width": 16, "height": 8}
    make(load({**job, "cameras": {"c": lens}, "split": {"train": 0.5, "val": 0.5}}), warn=lines.append)
    got = "train 2 frames, 100% (50% asked), val 0 frames, 0% (50% asked): they are of 1 places"
    (line,) = lines
    assert line.startswith(f"split: {got}")
    assert line.endswith("give a smaller split.distance_m")


def test_wrong_splits_are_one_line():
    for shares, says in (
        ({"train": 0.5, "val": 0.4}, "expected shares whose sum is 1"),
        ({"train": -0.5, "val": 1.5}, "split.train: expected a finite number >= 0"),
        ({}, "expected shares whose sum is 1"),
    ):
        with pytest.raises(ArgumentError, match=says):
            read_split("split", shares)


LINE = {"source": "scene://four-wall", "face_size": 16, "split": {"train": 0.8, "val": 0.2}}


def made_at(tmp_path, count, **split):
    """The splits of frames of a dataset at places along a line."""
    lens = {"model": "equirectangular", "width": 16, "height": 8}
    poses = [{"position": [0.6 * i - 2, 0, 1.5]} for i in range(count)]
    keys = {"poses": poses, "cameras": {"c": lens}, "out": str(tmp_path / "out"), "modes": ["lit"]}
    make(load({**LINE, **keys, "split": {**LINE["split"], **split}}))
    return [frame.split for frame in dataset.open(tmp_path / "out")]


def test_a_dataset_that_was_begun_by_another_rule_keeps_it(tmp_path):
    first = made_at(tmp_path, 5, rule="hash")
    assert first == [Split(LINE["split"]).of(f"{0.6 * i - 2:.3f},0.000,1.500") for i in range(5)]
    assert "rule" not in manifest.read(tmp_path / "out").settings["splits"]
    more = made_at(tmp_path, 7)
    assert more[:5] == first
    assert len(more) == 7
    assert dataset.check(tmp_path / "out") == []


def test_new_places_move_no_frames(tmp_path):
    first = made_at(tmp_path, 5)
    assert first.count("val") == 1
    assert made_at(tmp_path, 7)[:5] == first
    assert manifest.read(tmp_path / "out").settings["splits"]["rule"] == "quota"


def test_a_limited_dataset_gives_no_advice_on_its_splits(tmp_path):
    lens = {"model": "equirectangular", "width": 16, "height": 8}
    poses = [{"position": [0.6 * i - 2, 0, 1.5]} for i in range(6)]
    keys = {"poses": poses, "cameras": {"c": lens}, "out": str(tmp_path / "out"), "modes": ["lit"]}
    lines = []
    make(load({**LINE, **keys}), limit=1, warn=lines.append)
    assert lines == []
