"""Write the jobs of scripts/test-consumers: a scanner, and a fisheye, of the example of SLAM; the kitchen."""

import sys
from pathlib import Path

import yaml

folder = Path(sys.argv[1])
job = yaml.safe_load(Path("examples/slam/slam.yaml").read_text(encoding="utf-8"))
cameras = job["rig"]["cameras"]
del job["classes"], job["imu"]["gyroscope"], job["imu"]["accelerometer"]  # an IMU without errors
ONE = {
    "scan": {
        "rig": {"cameras": {"lidar": cameras["lidar"]}},
        "times": {"rate": 10, "count": 100},
        "modes": ["depth"],
        "export": ["kitti_lidar", "rosbag2"],
    },
    "eyes": {
        "rig": {"cameras": {"left": cameras["left"]}},
        "times": {"rate": 2.5},
        "modes": ["lit"],
        "export": ["euroc", "colmap", "poses"],
    },
}
for name, keys in ONE.items():
    (folder / f"{name}.yaml").write_text(yaml.safe_dump({**job, **keys, "out": name}))
kitchen = yaml.safe_load(Path("examples/kitchen/kitchen.yaml").read_text(encoding="utf-8"))
del kitchen["record"], kitchen["truth"], kitchen["cameras"]["ball"]
yolo = [
    {"format": "yolo", "cameras": ["fisheye"], "task": task, "out": task} for task in ("detect", "segment")
]
classes = str(Path("examples/kitchen/classes.yaml").absolute())
kitchen |= {
    "source": "scene://four-wall",
    "modes": ["lit", "object_mask"],
    "classes": classes,
    "out": "things",
}
(folder / "things.yaml").write_text(yaml.safe_dump({**kitchen, "export": ["coco", *yolo]}))
