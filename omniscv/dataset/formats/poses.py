"""Trajectories of each camera: ``CAMERA.tum``, ``CAMERA.euroc``, ``CAMERA.kitti`` with ``CAMERA.times``.

The formats are those of :mod:`omniscv.geometry.trajectory_files`. Poses are in the order of their times, or
of the frames' keys if a frame has no time; then they are numbered from 0. TUM and EuRoC hold poses in the
world frame; KITTI's are relative to the first one. Of a camera that moves while its lines are read, the pose
is that of its time. ``CAMERA.keys`` names the frame of every line.
"""

from collections.abc import Sequence
from pathlib import Path

from omniscv.cameras import Camera, Lidar, PushBroom, RollingShutter
from omniscv.dataset.exporting import Format, register
from omniscv.dataset.sequences import by_camera, trajectory
from omniscv.frame import Frame
from omniscv.geometry.trajectory_files import write_euroc, write_kitti, write_kitti_times, write_tum
from omniscv.records import NoOptions
from omniscv.storage.local import write_text

_WRITERS = {"tum": write_tum, "kitti": write_kitti, "times": write_kitti_times, "euroc": write_euroc}
"""By the suffix of a file, the function that returns its text."""


@register
class Poses(Format):
    """See the module."""

    name = "poses"

    def refuses(self, camera: Camera) -> str | None:
        if camera.central or isinstance(camera, Lidar | PushBroom | RollingShutter):
            return None
        return f"expected a central camera, got {camera.name}, whose rays have several origins"

    def write(self, frames: Sequence[Frame], out: Path, options: NoOptions) -> list[Path]:
        """Write the trajectories; ArgumentError for two frames of a camera at one time."""
        written = []
        for camera_name, mine in by_camera(frames).items():
            poses = trajectory(mine)
            contents = {suffix: to_text(poses) for suffix, to_text in _WRITERS.items()}
            contents["keys"] = "".join(f"{frame.key}\n" for frame in mine)
            for suffix, content in contents.items():
                written.append(write_text(out / f"{camera_name}.{suffix}", content))
        return written
