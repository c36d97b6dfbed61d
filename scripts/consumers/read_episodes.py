"""Read episodes by LeRobotDataset, and a dataset card by mlcroissant; compare both with the truth."""

import json
import sys
from pathlib import Path

import mlcroissant
import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset

FOLDER = Path(sys.argv[1])
MOST_LEVELS = 6  # of the mean of a picture: the loss of H.264 with chroma of 2 x 2 px
failed = []


def judge(name, value, most, unit):
    """Print a figure, and remember whether it is within its bound."""
    print(f"{name}: {value:.3g} {unit} (at most {most:g})")
    if not value <= most:
        failed.append(name)


def episodes():
    """Frames, states, depth and labels of LeRobotDataset."""
    truth = np.load(FOLDER / "truth.npz")
    root = FOLDER / "robot/exports/lerobot"
    read = LeRobotDataset("local/robot", root=root, video_backend="pyav")
    judge("lerobot: frames that are missing", abs(len(read) - truth["steps"].sum()), 0, "")
    off = {name: [] for name in ("states", "wrist", "room", "labels", "depth")}
    tasks = set()
    for index in range(len(read)):
        item = read[index]
        tasks.add(item["task"])
        off["states"].append(np.abs(item["observation.state"].numpy() - truth["states"][index]).max())
        for name in ("wrist", "room"):
            picture = 255 * item[f"observation.images.{name}"].numpy().transpose(1, 2, 0)
            off[name].append(np.abs(picture - truth[f"{name}_lit"][index]).mean())
            labels = item[f"observation.images.{name}_labels"].numpy().squeeze()
            off["labels"].append((labels != truth[f"{name}_labels"][index]).mean())
            depth = truth[f"{name}_depth"][index]
            seen = np.isfinite(depth) & (depth > 0)
            millimetres = item[f"observation.images.{name}_depth"].numpy().squeeze()
            off["depth"].append(np.abs(millimetres - 1000 * depth)[seen].max())
    judge("lerobot: states", max(off["states"]), 0, "")
    judge("lerobot: colours of the fisheye", max(off["wrist"]), MOST_LEVELS, "levels")
    judge("lerobot: colours of the panorama", max(off["room"]), MOST_LEVELS, "levels")
    judge("lerobot: labels", max(off["labels"]), 0, "")
    judge("lerobot: depth", max(off["depth"]), 0.501, "mm")
    judge("lerobot: other tasks", len(tasks ^ {"look around"}), 0, "")
    shifted = read[truth["steps"][0]]
    judge("lerobot: first index of the second episode", abs(int(shifted["episode_index"]) - 1), 0, "")


def card():
    """The records of the description in Croissant."""
    described = mlcroissant.Dataset(str(FOLDER / "robot/croissant.json"))
    (records,) = [records.id for records in described.metadata.record_sets]
    keys = []
    for record in described.records(records):
        keys.append(next(value for name, value in record.items() if name.endswith("key")))
    listed = [json.loads(line) for line in (FOLDER / "robot/frames.jsonl").read_text().splitlines()]
    names = {str(line.get("key", line.get("stem", ""))) for line in listed}
    found = {key.decode() if isinstance(key, bytes) else str(key) for key in keys}
    judge("croissant: records that are no frames", len(found ^ names), 0, "")


episodes()
card()
if failed:
    sys.exit(f"read_episodes.py: {', '.join(failed)}")
