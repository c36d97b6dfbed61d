"""Write the jobs of scripts/test-consumers: the scanner, and one fisheye, of the example of SLAM."""

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
