"""What the tests of composition share: a server that sets nothing, a room's surfaces, the demo's cameras."""

import numpy as np

from mock_server.kernel import BOX, CYLINDER, RECTANGLE, SPHERE
from omniscv.cameras import create
from omniscv.captures.source import Capabilities
from omniscv.demo import _EVERY_MODEL

FIXED = Capabilities(can_set_size=False, can_set_fov=False, image_size=(512, 512), fov_deg=90.0)


def distance_to_surfaces(scene, points):
    """(N,) metres from world points to the nearest surface, by each solid's closed form."""
    nearest = np.full(len(points), np.inf)
    for row in scene._solids:
        kind, center, axes, half = int(row[0]), row[2:5], row[5:14].reshape(3, 3), row[14:17]
        p = (points - center) @ axes.T
        if kind == SPHERE:
            away = np.abs(np.linalg.norm(p, axis=1) - half[0])
        elif kind == CYLINDER:
            away = _of_box(np.stack([np.hypot(p[:, 0], p[:, 1]), np.abs(p[:, 2])], axis=1), half[[0, 2]])
        elif kind == BOX:
            away = _of_box(np.abs(p), half)
        else:
            assert kind == RECTANGLE
            beyond = np.maximum(np.abs(p) - [half[0], half[1], 0.0], 0)
            away = np.linalg.norm(beyond, axis=1)
        nearest = np.minimum(nearest, away)
    return nearest


def _of_box(p, half):
    q = p - half
    outside = np.linalg.norm(np.maximum(q, 0), axis=1)
    return np.abs(outside + np.minimum(q.max(axis=1), 0))


def cameras_at(width):
    """The demo's camera of every model, scaled to a width."""
    scaled = {}
    for name, parameters in _EVERY_MODEL.items():
        kw = dict(parameters)
        s = width / kw["width"]
        for key in ("fx", "fy", "cx", "cy", "focal"):
            if key in kw:
                kw[key] *= s
        if "coefficients" in kw:  # px = polynomial in px
            kw["coefficients"] = [c * s ** (1 - i) for i, c in enumerate(kw["coefficients"])]
        kw |= {"width": width, "height": round(kw["height"] * s)}
        scaled[name] = create(name, **kw)
    return scaled
