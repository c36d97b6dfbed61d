"""PLY point clouds: ``STEM.ply`` of each frame, and ``cloud.ply`` of all.

Binary, little-endian; one element ``vertex`` with ``float x y z`` (metres, world frame: Z up) and, where the
frames have them, ``float nx ny nz``, ``uchar red green blue``, ``ushort label`` (the instance id) and
``ushort class``. Comments name the numbers: ``comment label 3 Chair``. Pixels without a surface, outside the
field of view, or unsure have no point. A point lies on its pixel's own ray.

Options: ``voxel``, the edge in metres (default 0.02) of the cubes of which ``cloud.ply`` keeps one point, the
one seen from nearest; ``max_error``, metres, leaves out the points whose depth may be off by more, by the
frames' layer ``depth_error``; ``frames`` and ``cloud``, whether to write the files of each frame (default)
and of all (default).
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv import truth
from omniscv.arguments import Reader, fields, flag, number
from omniscv.cameras import Camera, Rays
from omniscv.errors import printable
from omniscv.frame import Frame
from omniscv.planning.densities import unproject
from omniscv.storage.local import whole_file
from omniscv.truth import Points
from omniscv.truth.point_cloud import points_of

name = "ply"
needs = ("depth",)

_OPTIONS: dict[str, Reader] = {
    **dict.fromkeys(("voxel", "max_error"), partial(number, above=0)),
    **dict.fromkeys(("frames", "cloud"), flag),
}
_VOXEL_M = 0.02
_COLUMNS = {
    "normals": (("nx", "ny", "nz"), "<f4", "float"),
    "lit": (("red", "green", "blue"), "u1", "uchar"),
    "labels": (("label",), "<u2", "ushort"),
    "classes": (("class",), "<u2", "ushort"),
}


def refuses(camera: Camera) -> str | None:
    """Return None: every camera that has depth sees points."""
    return None


def check_options(options: Mapping[str, Any], cameras: Mapping[str, Camera]) -> None:
    """Raise ArgumentError for a wrong option."""
    fields("", options, _OPTIONS)


def write(frames: Sequence[Frame], out: Path, options: Mapping[str, Any]) -> list[Path]:
    """Write the clouds of frames with depth.

    Raises:
        ArgumentError: a frame without depth, or a wrong option.
    """
    given = {"voxel": _VOXEL_M, "frames": True, "cloud": True} | fields("", options, _OPTIONS)
    out.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []
    comments = _comments(frames)

    def clouds() -> Iterator[Points]:
        rays: dict[Camera, Rays] = {}
        for frame in frames:
            if frame.camera not in rays:
                rays = {
                    frame.camera: unproject(frame.camera, frame.camera.pixels())
                }  # one at a time: rays are large
            cloud = points_of(frame, rays[frame.camera], given.get("max_error"))
            if given["frames"]:
                written.append(write_ply(out / f"{frame.key}.ply", cloud, comments))
            yield cloud

    if given["cloud"] and frames:
        whole = truth.merged(clouds(), given["voxel"])
        written.append(write_ply(out / "cloud.ply", whole, comments))
    else:
        for _ in clouds():
            pass
    return written


def write_ply(path: Path, cloud: Points, comments: Sequence[str] = ()) -> Path:
    """Write points as a file, whole or not at all, and return its path."""
    columns: list[tuple[str, str, str, NDArray[Any]]] = [
        (axis, "<f4", "float", values) for axis, values in zip("xyz", cloud.positions_w.T, strict=True)
    ]
    for layer, (names, kind, written) in _COLUMNS.items():
        if layer in cloud.values:
            values = cloud.values[layer].reshape(len(cloud), len(names)).T
            columns += [(each, kind, written, column) for each, column in zip(names, values, strict=True)]
    rows = np.empty(len(cloud), [(each, kind) for each, kind, _, _ in columns])
    for each, _, _, values in columns:
        rows[each] = values
    header = [
        "ply", "format binary_little_endian 1.0", "comment metres; world frame: X forward, Y left, Z up",
        *(f"comment {each}" for each in comments),
        f"element vertex {len(cloud)}",
        *(f"property {written} {each}" for each, _, written, _ in columns),
        "end_header",
    ]  # fmt: skip
    with whole_file(path) as part, part.open("wb") as file:
        file.write(("\n".join(header) + "\n").encode())
        file.write(rows.tobytes())
    return path


def _comments(frames: Sequence[Frame]) -> list[str]:
    """What the numbers of labels and classes stand for."""
    labels = {instance: each for frame in frames for each, instance in frame.instances.items()}
    tables = [frame.classes for frame in frames if frame.classes is not None]
    classes = {each.id: each.name for table in tables for each in table.classes.values()}
    named = [("label", labels), ("class", classes)]
    return [f"{what} {number} {printable(ids[number])}" for what, ids in named for number in sorted(ids)]
