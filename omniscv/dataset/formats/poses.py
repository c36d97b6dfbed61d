"""Trajectories of each camera: ``CAMERA.tum``, ``CAMERA.euroc``, ``CAMERA.kitti`` with ``CAMERA.times``.

The formats are those of :mod:`omniscv.geometry.trajectory`. Poses are in the order of their times, or of the
frames' keys if a frame has no time; then they are numbered from 0. TUM and EuRoC hold poses in the world
frame; KITTI's are relative to the first one. ``CAMERA.keys`` names the frame of every line.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

from omniscv.arguments import one_of, texts
from omniscv.cameras import Camera
from omniscv.dataset.exporting import Format, register
from omniscv.dataset.sequences import by_camera, trajectory
from omniscv.frame import Frame
from omniscv.geometry.trajectory import Trajectory, write_euroc, write_kitti, write_kitti_times, write_tum
from omniscv.records import checked, record
from omniscv.storage.local import write_text

_WRITERS: dict[str, dict[str, Callable[[Trajectory], str]]] = {
    "tum": {"tum": write_tum},
    "kitti": {"kitti": write_kitti, "times": write_kitti_times},
    "euroc": {"euroc": write_euroc},
}
"""By format: the suffixes of its files, and the function that returns their text."""


def _formats(name: str, value: object) -> tuple[str, ...]:
    return tuple(one_of(name, word, _WRITERS) for word in texts(name, value))


@record
class PosesOptions:
    """Options of the format."""

    formats: tuple[str, ...] = checked(
        _formats, default=tuple(_WRITERS), key="as", help="some of tum, kitti, euroc; default: all"
    )


class Poses(Format):
    """See the module."""

    name = "poses"
    options = PosesOptions

    def refuses(self, camera: Camera) -> str | None:
        if camera.central:
            return None
        return f"expected a central camera, got {camera.name}, whose rays have several origins"

    def write(self, frames: Sequence[Frame], out: Path, options: PosesOptions) -> list[Path]:
        """Write the trajectories; ArgumentError for two frames of a camera at one time."""
        written = []
        for camera_name, mine in by_camera(frames).items():
            poses = trajectory(mine)
            writers = [
                (suffix, to_text) for name in options.formats for suffix, to_text in _WRITERS[name].items()
            ]
            contents = {suffix: to_text(poses) for suffix, to_text in writers}
            contents["keys"] = "".join(f"{frame.key}\n" for frame in mine)
            for suffix, content in contents.items():
                written.append(write_text(out / f"{camera_name}.{suffix}", content))
        return written


register(Poses())
