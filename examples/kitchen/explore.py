"""Print the contents of a dataset: python examples/kitchen/explore.py examples/kitchen/out"""

import sys
from collections import Counter

import numpy as np

from omniscv import dataset

frames = dataset.open(sys.argv[1])
print(f"{len(frames)} frames; splits {dict(Counter(frame.split for frame in frames))}")

pixels: Counter[str] = Counter()
for frame in frames:
    ids, counts = np.unique(frame.layer("classes")[frame.valid], return_counts=True)
    names = {each.id: each.name for each in frame.classes.classes.values()} | {0: "background"}
    pixels.update({names[i]: int(n) for i, n in zip(ids, counts, strict=True)})
for name, count in pixels.most_common(5):
    print(f"{name:12} {count / pixels.total():6.1%} of the pixels")

frame = next(frame for frame in frames if frame.camera_name == "panorama")
depth = frame.layer("depth")
print(f"{frame.key}: at {frame.pose.position.round(2)}, {depth[np.isfinite(depth)].max():.2f} m deep")
for box in sorted(frame.truth["boxes"], key=lambda box: box["distance"])[:5]:
    print(f"  {box['name']:12} {box['class'] or '-':10} {box['distance']:5.2f} m away, box {box['bbox']}")
floor = [corner for corner in frame.layout["corners"] if corner["kind"] == "floor"]
print(f"  floor corners at {[np.round(corner['pixel'], 1).tolist() for corner in floor]}")
