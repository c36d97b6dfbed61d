"""Pictures of the four-wall room as other programs have them, traced; imports of them, and their judge."""

from functools import cache

import numpy as np
from PIL import Image

import omniscv
from mock_server import load_scene
from omniscv import cli
from omniscv.chart import traced
from omniscv.geometry import Pose
from omniscv.sources import View

SCENE = load_scene("four-wall")
AT = (0.3, -0.2, 1.45)
THERE = (-0.4, 0.5, 1.2)
FACES = {
    "front": (0, 0), "right": (-90, 0), "back": (180, 0), "left": (90, 0), "up": (0, 90), "down": (0, -90)
}  # fmt: skip
"""Yaw and pitch of a cube's faces by their words."""
WIDE = omniscv.cameras.create("equirectangular", 256, 128)
SMALL = omniscv.cameras.create("equirectangular", 96, 48)


@cache
def seen(view):
    """Colours, planar depth and labels of a view, traced."""
    pixels = np.stack(np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5), axis=-1)
    fx, fy, cx, cy = view.projection
    rays = np.concatenate([(pixels - (cx, cy)) / (fx, fy), np.ones((*pixels.shape[:2], 1))], axis=-1)
    hits = SCENE.trace(view.pose.position, rays @ view.pose.R_w_c.T)
    planar = hits.distance / np.linalg.norm(rays, axis=-1)
    return np.uint8(255 * hits.color + 0.5), planar.astype(np.float32), hits.label


def panorama(pose):
    """Colours, distances and labels of a panorama, traced."""
    hits = traced(SCENE, WIDE, pose)
    return np.uint8(255 * hits.color + 0.5), hits.distance, hits.label


def face(pose, word, edge):
    """The view of a face of the cube that a pose looks along."""
    level, turned = (Pose.from_angles((0, 0, 0), *FACES[name]).R_w_c for name in ("front", word))
    return View(Pose(pose.position, pose.R_w_c @ level.T @ turned), 90, edge, edge)


def put(path, pixels, **options):
    """Write a picture, and the folders above it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(path, **options)


def run(*words):
    """``omniscv recording import``."""
    return cli.run(["recording", "import", *map(str, words)])


def judge(path, pose, modes, least=0.97):
    """Compare an image of a recording with what its rays meet."""
    with omniscv.open_source(path) as source:
        image = omniscv.render(SMALL, pose, source, modes, filter="nearest")
        names = source.objects().names()
    truth = traced(SCENE, SMALL, pose)
    if "lit" in modes:
        assert np.abs(image.lit - 255 * truth.color)[2:-2].mean() < 6  # 50 where two faces are exchanged
    if "depth" in modes:
        off = np.abs(image.depth - truth.distance)
        bound = image.depth_error
        assert np.isfinite(bound).mean() > 0.6
        assert (off <= bound)[np.isfinite(bound)].mean() > 0.995  # the truth of 1 in 200 lies beside an edge
    if "object_mask" in modes:
        objects = sorted(SCENE.objects)
        label = np.array([0, *(1 + objects.index(name) if name in objects else 0 for name in names)])
        assert (label[image.labels] == truth.label).mean() > least
