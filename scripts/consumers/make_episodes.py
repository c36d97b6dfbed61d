"""Make episodes, their export as LeRobotDataset and a dataset card, and what a reader must find in them."""

import sys
from pathlib import Path

import numpy as np

import omniscv
from omniscv import cameras, dataset
from omniscv.cli import run
from omniscv.geometry import Pose

FOLDER = Path(sys.argv[1])
FPS = 10
STEPS = (4, 3)
LENSES = {
    "wrist": cameras.create("fisheye-equidistant", 128, 128, fov_deg=190),
    "room": cameras.create("equirectangular", 256, 128),
}
POINTS_C = np.random.default_rng(1).normal(size=(500, 3))


def main():
    """Write ``robot``, a dataset of two episodes, and ``truth.npz``."""
    states = []
    with (
        omniscv.open_source("scene://four-wall") as source,
        dataset.episodes(FOLDER / "robot", LENSES, fps=FPS, task="look around") as episodes,
    ):
        for episode, steps in enumerate(STEPS):
            for step in range(steps):
                pose = Pose.from_angles((0.1 * episode, 0.05 * step, 1.4), 12 * step, 5 * episode)
                states.append(np.float32([episode, step / 3, np.sin(step)]))
                episodes.add(source, dict.fromkeys(LENSES, pose), state=states[-1], action=[float(step)])
            episodes.end()
    dataset.export(FOLDER / "robot", "lerobot")
    if run(["dataset", "card", str(FOLDER / "robot"), "--license", "CC-BY-4.0"]):
        sys.exit("make_episodes.py: expected a dataset card")
    truth = {"states": np.array(states), "steps": STEPS, "points_c": POINTS_C}
    frames = sorted(dataset.open(FOLDER / "robot"), key=lambda frame: frame.key)
    for name, camera in LENSES.items():
        of_camera = [frame for frame in frames if frame.camera_name == name]
        truth[f"{name}_lit"] = np.array([frame.layer("lit") for frame in of_camera])
        truth[f"{name}_depth"] = np.array([frame.layer("depth") for frame in of_camera])
        truth[f"{name}_labels"] = np.array([frame.layer("labels") for frame in of_camera])
        truth[f"{name}_pixels"], truth[f"{name}_valid"] = camera.project(POINTS_C)
    np.savez(FOLDER / "truth.npz", **truth)


if __name__ == "__main__":
    main()
