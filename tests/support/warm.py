"""Loads what documents use, on import: processes that are forked afterwards need not load it again.

Nothing here leaves a thread behind, because threads do not survive a fork.
"""

import sys

import omniscv
from omniscv import cli, make, parallel
from omniscv.diagnostics import doctor
from omniscv.sources.unreal import source

LOADED = (cli, doctor, make, source)
POSE = omniscv.Pose.from_angles((0, 0, 1.5))
MODES = ("lit", "object_mask", "depth", "normals")

parallel.limit(1)
with omniscv.open_source("scene://four-wall") as scene:
    for name, strategy in (("equirectangular", "auto"), ("noncentral-panorama", "auto")):
        camera = omniscv.cameras.model(name).example(16)
        omniscv.render(camera, POSE, scene, MODES, strategy=strategy, face_size=16)
parallel.limit(sys.maxsize)
