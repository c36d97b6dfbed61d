"""What the tests of composition share: traced sources, a room's surfaces, an example of every model."""

import numpy as np
import pytest

from mock_server.scene import Scene
from mock_server.solids import BOX, CYLINDER, SPHERE
from omniscv import cameras
from omniscv.sources import Capabilities
from omniscv.sources.scene import SceneSource

FIXED = Capabilities(can_set_size=False, can_set_fov=False, image_size=(512, 512), fov_deg=90.0)


_ALIKE = {
    "fisheye-stereographic", "fisheye-orthographic", "fisheye-equisolid", "catadioptric-parabolic",
    "catadioptric-planar", "kannala-brandt", "fisheye624", "ftheta", "double-sphere", "extended-unified",
    "division", "field-of-view", "equiangular-cube", "vr180",
}  # fmt: skip
"""To composition, which knows nothing of models but their rays, others stand for these."""


def by_rays(names, dear=()):
    """Parameters of a test for every model: those whose rays are like another one's, and those that are dear,
    only with ``--soak``."""
    return [pytest.param(name, marks=[pytest.mark.soak] * (name in {*_ALIKE, *dear})) for name in names]


def plain_room(objects):
    """A white room of 6 m x 6 m with objects."""
    white = {"kind": "plain", "colors": [[0.9, 0.9, 0.9]]}
    room = {"floor": [[-3, -3], [3, -3], [3, 3], [-3, 3]], "height": 3, "walls": [white] * 4}
    room |= {"floor_texture": white, "ceiling_texture": white}
    return Scene("plain", {"room": room, "objects": objects})


def float_source(scene, capabilities=None):
    return SceneSource(scene, capabilities, lit="float32")


def cameras_at(width):
    return {name: cameras.model(name).example(width) for name in cameras.names()}


def distance_to_surfaces(scene, points):
    """(N,) metres from world points to the nearest surface, by each solid's closed form."""
    nearest = np.full(len(points), np.inf)
    for row in scene.solids:
        kind = int(row[0])
        center = row[2:5]
        axes = row[5:14].reshape(3, 3)
        half = row[14:17]
        p = (points - center) @ axes.T
        if kind == SPHERE:
            away = np.abs(np.linalg.norm(p, axis=1) - half[0])
        elif kind == CYLINDER:
            away = _of_box(np.stack([np.hypot(p[:, 0], p[:, 1]), np.abs(p[:, 2])], axis=1), half[[0, 2]])
        else:  # a rectangle is a box without height
            away = _of_box(np.abs(p), half * (1, 1, kind == BOX))
        nearest = np.minimum(nearest, away)
    return nearest


def _of_box(p, half):
    q = p - half
    outside = np.linalg.norm(np.maximum(q, 0), axis=1)
    return np.abs(outside + np.minimum(q.max(axis=1), 0))
