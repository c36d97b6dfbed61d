"""Truth for the tests of composition: a source that traces in this process, and the surfaces of a room."""

import numpy as np

from mock_server.kernel import BOX, CYLINDER, RECTANGLE, SPHERE
from mock_server.render import pinhole_rays
from omniscv.cameras import create
from omniscv.captures.source import Capabilities, ObjectTable, Source
from omniscv.captures.view import Capture
from omniscv.demo import _EVERY_MODEL

FIXED = Capabilities(can_set_size=False, can_set_fov=False, image_size=(512, 512), fov_deg=90.0)


def mask_color(label):
    """(..., 3) uint8, a colour of its own for each label; the sky is black."""
    label = np.asarray(label, dtype=np.uint32)
    return np.stack([label * 37 % 256, label * 101 % 256, label % 256], axis=-1).astype(np.uint8)


class ExactSource(Source):
    """Captures by exact tracing: lit and depth float32, masks uint8, normals float32. Keeps what it made."""

    def __init__(self, scene, capabilities=None, lit=np.float32):
        self.scene, self._lit, self.made, self._kept = scene, lit, 0, {}
        self._capabilities = capabilities or Capabilities()

    @property
    def capabilities(self):
        return self._capabilities

    def objects(self):
        return ObjectTable({n: tuple(mask_color(self.scene.label(n)).tolist()) for n in self.scene.objects})

    def capture(self, requests):
        for request in requests:
            if request.view not in self._kept:
                self._kept[request.view] = self._trace(request.view)
                self.made += 1
            yield Capture(request, request.view, self._kept[request.view][request.mode], b"", "npy")

    def _trace(self, view):
        rays, length = pinhole_rays(view.pose.R_w_c, view.fov_deg, view.width, view.height)
        hits = self.scene.trace(view.pose.t_w_c, rays)
        lit = hits.color if self._lit == np.float32 else np.round(255 * np.clip(hits.color, 0, 1))
        return {
            "lit": lit.astype(self._lit),
            "object_mask": mask_color(hits.label),
            "depth": (hits.distance / length).astype(np.float32),
            "normal": hits.normal.astype(np.float32),
        }


def traced(scene, camera, pose):
    """What each pixel's own ray meets: Hits of shape (H, W); NaN rays meet nothing."""
    rays = camera.unproject()
    return scene.trace(pose.to_world(rays.origins), rays.directions @ pose.R_w_c.T)


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
