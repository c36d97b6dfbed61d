"""Rooms for tests, and frames of datasets that show their layouts."""

import json

import numpy as np
import yaml

import mock_server
from mock_server.settings import SCENES
from omniscv.compose.files import write_layers
from omniscv.dataset import Frame
from omniscv.geometry.scene_geometry import Room
from omniscv.truth import project_layout

L_SHAPE = [[-3, -2.5], [4, -2.5], [4, 0.9], [1.6, 0.9], [1.6, 3.5], [-3, 3.5]]
T_SHAPE = [[-1, -3], [1, -3], [1, 0], [4, 0], [4, 2], [-4, 2], [-4, 0], [-1, 0]]
U_SHAPE = [[-3, -2], [3, -2], [3, 3], [1, 3], [1, 0], [-1, 0], [-1, 3], [-3, 3]]
PLAIN = [[-2, -3], [2, -3], [2, 3], [-2, 3]]

FAMILIES = (
    "equirectangular", "cube-map", "pinhole", "kannala-brandt", "fisheye-equisolid", "orthographic",
    "catadioptric-hyperbolic", "rolling-shutter", "push-broom", "noncentral-panorama",
    "noncentral-conical-mirror", "noncentral-spherical-mirror",
)  # fmt: skip
"""A camera model of each kind: panoramas, lenses, mirrors, lines, of one optical centre or many."""


def room_of_plan(plan, height=2.8):
    """A room as the mock server names its parts."""
    walls = tuple(f"Layout_Wall_{i + 1}" for i in range(len(plan)))
    return Room(np.array(plan, float), 0.0, height, walls, "Layout_Floor", "Layout_Ceiling")


def scene_of_plan(plan, height=2.8):
    return mock_server.Scene("plan", {"room": {"floor": plan, "height": height}})


def room_of_scene(name):
    """The room of one of the mock server's scenes, from its file."""
    path = SCENES / f"{name}.yaml"
    data = yaml.safe_load(path.read_text())["room"]
    return room_of_plan(data["floor"], data["height"])


def frame(folder, key, camera, pose, record, layers=None, instances=None, classes=None):
    """A frame of a dataset with a layout, as files; its colours are black if none are given."""
    layers = {"lit": np.zeros((camera.height, camera.width, 3), np.uint8), **(layers or {})}
    files = dict(write_layers(layers, folder, key))
    files["layout"] = folder / f"{key}.layout.json"
    files["layout"].write_text(json.dumps(record, allow_nan=False))
    return Frame(key, "camera", camera, pose, files, instances or {}, classes)


def plain_frame(folder, key, camera, pose, plan=PLAIN):
    return frame(folder, key, camera, pose, project_layout(room_of_plan(plan), camera, pose))
