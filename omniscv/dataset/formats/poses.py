"""Trajectories of each camera: ``CAMERA.tum``, ``CAMERA.euroc``, ``CAMERA.kitti`` with ``CAMERA.times``.

The formats are those of :mod:`omniscv.geometry.trajectory`. Poses are in the order of their times, or of the
frames' keys where a frame has no time; they are numbered from 0 in place of times then. The option ``as``
lists some of ``tum``, ``kitti`` and ``euroc`` (default: all). TUM and EuRoC hold poses in the world frame;
KITTI's are relative to the first one. ``CAMERA.keys`` names the frame of every line.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from omniscv.arguments import Reader, fields, one_of, texts
from omniscv.cameras import Camera
from omniscv.dataset.sequences import by_camera, trajectory
from omniscv.frame import Frame
from omniscv.geometry.trajectory import Trajectory, write_euroc, write_kitti, write_kitti_times, write_tum
from omniscv.storage.local import whole_file

name = "poses"

_WRITERS: dict[str, dict[str, Callable[[Trajectory], str]]] = {
    "tum": {"tum": write_tum},
    "kitti": {"kitti": write_kitti, "times": write_kitti_times},
    "euroc": {"euroc": write_euroc},
}
"""By format: the suffixes of its files, and what writes them."""


def _chosen(name: str, value: object) -> list[str]:
    return [one_of(name, each, _WRITERS) for each in texts(name, value)]


_OPTIONS: dict[str, Reader] = {"as": _chosen}


def refuses(camera: Camera) -> str | None:
    """Return why the poses do not describe a camera; None where they do."""
    if camera.central:
        return None
    return f"poses: expected a central camera, got {camera.name}, whose rays start at places of their own"


def check_options(options: Mapping[str, Any], cameras: Mapping[str, Camera]) -> None:
    """Raise ArgumentError for a wrong option."""
    fields("", options, _OPTIONS)


def write(frames: Sequence[Frame], out: Path, options: Mapping[str, Any]) -> list[Path]:
    """Write the trajectories.

    Raises:
        ArgumentError: two frames of a camera at one time, or a wrong option.
    """
    chosen = fields("", options, _OPTIONS).get("as", _WRITERS)
    out.mkdir(parents=True, exist_ok=True)
    written = []
    for camera_name, mine in by_camera(frames).items():
        poses = trajectory(mine)
        found = {suffix: make(poses) for each in chosen for suffix, make in _WRITERS[each].items()}
        found["keys"] = "".join(f"{frame.key}\n" for frame in mine)
        for suffix, text in found.items():
            with whole_file(path := out / f"{camera_name}.{suffix}") as part:
                part.write_text(text, encoding="utf-8")
            written.append(path)
    return written
