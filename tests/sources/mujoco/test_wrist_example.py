"""The example of episodes of an arm, whose joints are the state that MuJoCo had."""

import json
import runpy

import numpy as np
import pytest
from pyarrow import parquet
from support.command_line import ROOT

from omniscv import dataset

EPISODES = 2
STEPS = 3


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """The example's module, and its dataset with the export."""
    module = runpy.run_path(str(ROOT / "examples/wrist/wrist.py"))
    folder = tmp_path_factory.mktemp("arm") / "out"
    module["main"](folder, EPISODES, STEPS, 32)
    dataset.export(folder, "lerobot")
    return module, folder


def test_the_action_of_a_step_is_the_state_of_the_next(arm):
    _, folder = arm
    for episode in range(EPISODES):
        rows = parquet.read_table(folder / f"exports/lerobot/data/chunk-000/file-{episode:03d}.parquet")
        states = np.array(rows["observation.state"].to_pylist())
        actions = np.array(rows["action"].to_pylist())
        assert states.shape == (STEPS, 4)
        np.testing.assert_array_equal(actions[:-1], states[1:])


def test_the_hand_moves_and_the_table_does_not(arm):
    _, folder = arm
    rows = parquet.read_table(folder / "exports/lerobot/data/chunk-000/file-000.parquet")
    hand = np.array(rows["observation.pose.wrist"].to_pylist())
    table = np.array(rows["observation.pose.table"].to_pylist())
    assert np.ptp(hand, axis=0).max() > 0.05
    assert np.ptp(table, axis=0).max() == 0


def test_the_panorama_sees_the_arm_and_the_fisheye_the_boxes(arm):
    _, folder = arm
    info = json.loads((folder / "exports/lerobot/meta/info.json").read_text())
    ids = info["features"]["observation.images.table_labels"]["info"]["instances"]
    seen = {name: set() for name in ("wrist", "table")}
    for frame in dataset.open(folder):
        seen[frame.camera_name] |= set(np.unique(frame.layer("labels")).tolist())
    assert {ids["upper"], ids["hand"]} <= seen["table"]
    assert {ids["red"], ids["blue"]} <= seen["wrist"]
