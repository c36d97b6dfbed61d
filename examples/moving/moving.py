"""Ten instants of a world in which a cabinet slides: panoramas, their truth and their flow."""

from itertools import pairwise

import numpy as np

import omniscv
from omniscv import Instant, Motion, Pose, object_pose, truth

camera = omniscv.cameras.create("equirectangular", width=512, height=256)
pose, times = Pose.from_angles((0, 0, 1.2)), np.linspace(0, 2, 10)
slide = Motion.through({0: object_pose((-2, -0.6, 0.85)), 2: object_pose((-1.2, 0.8, 0.85), yaw_deg=60)})

images = []
with omniscv.open_source("mock://workshop") as live, omniscv.record(live, "moving.sqlite") as source:
    for time in times:
        with source.at(Instant({"Cabinet": slide.at(time)}, time=time)) as world:
            images.append(omniscv.render(camera, pose, world, ("lit", "object_mask", "depth")))

label = images[0].objects.label("Cabinet")
for i, (one, two) in enumerate(pairwise(images)):
    moved = {label: truth.motion(slide.at(times[i]), slide.at(times[i + 1]))}
    flow = truth.flow(one.depth, camera.unproject(), pose, camera, pose, two.depth, one.labels, moved)
    one.save("moving", stem=f"pano-{i}")
    np.save(f"moving/pano-{i}.flow.npy", flow.pixels)
print(f"moving/: {len(images) - 1} panoramas with flow; a second run replays moving.sqlite")
