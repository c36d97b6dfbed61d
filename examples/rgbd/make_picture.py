"""Writes a picture with its depth, as a depth camera would: rgb.png, depth.png in mm, and a lens file."""

import json
from pathlib import Path

import numpy as np
from PIL import Image

import omniscv

OUT = Path(__file__).parent / "rgbd"
camera = omniscv.cameras.create("pinhole", width=320, height=240, fx=260, fy=260)
with omniscv.open_source("scene://four-wall") as source:
    image = omniscv.render(camera, omniscv.Pose.from_angles((-1.5, 0, 1.5)), source, ("lit", "depth"))
OUT.mkdir(exist_ok=True)
planar = image.depth * camera.unproject().directions[..., 2]  # along the axis, as depth cameras say it
Image.fromarray(image.lit).save(OUT / "rgb.png")
Image.fromarray(np.round(1000 * planar).astype(np.uint16)).save(OUT / "depth.png")
size = {"width": 320, "height": 240}
(OUT / "intrinsics.json").write_text(json.dumps({"fx": 260, "fy": 260, "cx": 159.5, "cy": 119.5, **size}))
