"""PCD 0.7 of the Point Cloud Library: ``KEY.pcd`` of each frame, binary and organised as the image is.

Points are in the sensor's axes (X ahead, Y left, Z up), NaN where a pixel has none; ``VIEWPOINT`` is the
sensor's pose in the world. Fields: ``x y z``, and as the frames have them ``intensity``, ``ring``, ``time``,
``label``, ``class``: see :func:`omniscv.truth.point_cloud.sweep`.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from omniscv.dataset.exporting import Format, register
from omniscv.dataset.formats.kitti_lidar import LidarOptions, write_bytes
from omniscv.frame import Frame
from omniscv.geometry import R_LEVEL, Pose
from omniscv.truth.point_cloud import sweep


@register
class Pcd(Format):
    """See the module."""

    name = "pcd"
    needs = ("depth",)
    options = LidarOptions

    def write(self, frames: Sequence[Frame], out: Path, options: LidarOptions) -> list[Path]:
        written = []
        for frame in frames:
            points = sweep(frame, options.max_relative_error, options.intensity)
            height, width = points.shape
            x, y, z, w = Pose(frame.pose.position, frame.pose.rotation @ R_LEVEL.T).quaternion()
            names = points.dtype.names or ()
            types = [points.dtype[name] for name in names]
            header: dict[str, Sequence[Any]] = {
                "VERSION": [0.7],
                "FIELDS": names,
                "SIZE": [type.itemsize for type in types],
                "TYPE": [type.kind.upper() for type in types],
                "COUNT": [1] * len(types),
                "WIDTH": [width],
                "HEIGHT": [height],
                "VIEWPOINT": [*frame.pose.position.tolist(), w, x, y, z],
                "POINTS": [width * height],
                "DATA": ["binary"],
            }
            text = "".join(f"{name} {' '.join(map(str, values))}\n" for name, values in header.items())
            written.append(write_bytes(out / f"{frame.key}.pcd", text.encode(), points.tobytes()))
        return written
