"""What ``dataset make`` takes beside ``render``: 200 panoramas of 512 x 256 with all their truths.

Both make the same layers (lit, object_mask, depth, normals) at the same poses, in turns of 20 images, from
``scene://four-wall``, the source that hides least of what truths take. ``make`` adds classes, truths,
checksums and the manifest. Times are those of an image, files written, by the clock and of the processor.
"""

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import omniscv
from benches import Figure, Reference
from omniscv.geometry import Pose
from omniscv.job import Recipe
from omniscv.jobs import Job, make, run
from omniscv.truth.classes import ClassRules

MODES = ("lit", "object_mask", "depth", "normals")
RULES = [{"match": "Layout_*", "class": "room", "stuff": True}, {"match": "*", "class": "thing"}]
CLASSES = ClassRules.from_dict({"rules": RULES})
ALL = ("boxes", "bfov", "boxes3d", "layout", "poses")
TRUTHS = {
    "render": (),
    "checksums and manifest": (),
    "all truths of the image": ALL,
    "amodal, which renders again": (*ALL, "amodal"),
}


def measure(quick: bool) -> Iterator[Figure]:
    images, turn, width = (1, 1, 32) if quick else (200, 20, 512)
    spent = {what: np.zeros(2) for what in TRUTHS}
    with TemporaryDirectory() as folder:
        for number, first in enumerate((*([] if quick else [0]), *range(0, images, turn))):
            some = job(first, turn, width)
            for what, total in spent.items():
                recipe = Recipe(CLASSES, {name: {} for name in TRUTHS[what]})
                one = replace(some, out=Path(folder) / f"{what}-{number}", recipe=recipe)
                before = now()
                run(one) if what == "render" else make(one)
                total += (now() - before) * (quick or number > 0)  # the first turn compiles
    title = f"{images} panoramas of {width} x {width // 2}, an image"
    for i, clock in enumerate(("ms", "ms of the processor")):
        peer = Reference("render", 1e3 * spent["render"][i] / images)
        for what in list(TRUTHS)[1:]:
            yield Figure(title, what, clock, 1e3 * spent[what][i] / images, peer)


def job(first: int, count: int, width: int) -> Job:
    """Return some of the panoramas, each from a place of its own."""
    draw = np.random.default_rng(0).uniform((-1.2, -1, 1.2, -180), (1.2, 1, 1.8, 180), (first + count, 4))
    poses = tuple(Pose.from_angles(row[:3], yaw_deg=row[3]) for row in draw[first:])
    camera = omniscv.cameras.create("equirectangular", width=width, height=width // 2)
    return Job("scene://four-wall", {"pano": camera}, poses, Path(), MODES)


def now() -> np.ndarray:
    """Return the time and the processor's time of this process, s."""
    return np.array([time.perf_counter(), time.process_time()])
