"""PLY point clouds: ``STEM.ply`` of each frame, and ``cloud.ply`` of all.

Binary, little-endian; one element ``vertex`` with ``float x y z`` (metres, world frame: Z up; ``double`` if a
point is farther than 1,000 m from the origin, as in UTM) and, if the frames have them, ``float nx ny nz``,
``uchar red green blue``, ``ushort label`` (the instance id) and ``ushort class``; ``uchar doubt`` is 1 where
the label may be another one. Comments name the numbers: ``comment label 3 Chair``. Pixels without a surface,
outside the field of view, unsure or inexact have no point. A point lies on its pixel's own ray.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import flag, number
from omniscv.cameras import Camera, Rays
from omniscv.dataset.exporting import Format, PointOptions, register
from omniscv.dataset.sequences import FAR_M
from omniscv.errors import printable
from omniscv.frame import Frame
from omniscv.planning.densities import unproject
from omniscv.records import checked, record
from omniscv.storage.local import write_bytes
from omniscv.truth.point_cloud import Points, merged, points_of

_COLUMNS = {
    "normals": (("nx", "ny", "nz"), "<f4", "float"),
    "lit": (("red", "green", "blue"), "u1", "uchar"),
    "labels": (("label",), "<u2", "ushort"),
    "classes": (("class",), "<u2", "ushort"),
    "doubt": (("doubt",), "u1", "uchar"),
}
"""By layer: the names of its properties, their type in memory and in the header."""


@record
class PlyOptions(PointOptions):
    """Options of the format."""

    voxel: float = checked(
        number,
        above=0,
        default=0.02,
        help="edge in metres of the cubes of which cloud.ply has one point, the nearest",
    )
    frames: bool = checked(flag, default=True, help="write a file for each frame")
    cloud: bool = checked(flag, default=True, help="write cloud.ply")


@register
class Ply(Format):
    """See the module."""

    name = "ply"
    needs = ("depth",)
    options = PlyOptions

    def write(self, frames: Sequence[Frame], out: Path, options: PlyOptions) -> list[Path]:
        written: list[Path] = []
        comments = _comments(frames)

        def clouds() -> Iterator[Points]:
            rays: dict[Camera, Rays] = {}
            for frame in frames:
                if frame.camera not in rays:  # rays are large: only those of one camera are in memory
                    rays = {frame.camera: unproject(frame.camera, frame.camera.pixels())}
                cloud = points_of(frame, rays[frame.camera], options.max_relative_error)
                if options.frames:
                    written.append(write_ply(out / f"{frame.key}.ply", cloud, comments))
                yield cloud

        if options.cloud and frames:
            whole = merged(clouds(), options.voxel)
            written.append(write_ply(out / "cloud.ply", whole, comments))
        else:
            for _ in clouds():
                pass
        return written


def write_ply(path: Path, cloud: Points, comments: Sequence[str] = ()) -> Path:
    """Write points as a file, whole or not at all, and return its path."""
    far = len(cloud) and np.abs(cloud.positions_w).max() > FAR_M
    types = ("<f8", "double") if far else ("<f4", "float")
    columns: list[tuple[str, str, str, NDArray[Any]]] = [
        (axis, *types, values) for axis, values in zip("xyz", cloud.positions_w.T, strict=True)
    ]
    for layer, (names, dtype, written_type) in _COLUMNS.items():
        if layer in cloud.values:
            values = cloud.values[layer].reshape(len(cloud), len(names)).T
            columns += [(name, dtype, written_type, of) for name, of in zip(names, values, strict=True)]
    rows = np.empty(len(cloud), [(name, dtype) for name, dtype, _, _ in columns])
    for name, _, _, column in columns:
        rows[name] = column
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment metres; world frame: X forward, Y left, Z up",
        *(f"comment {comment}" for comment in comments),
        f"element vertex {len(cloud)}",
        *(f"property {written_type} {name}" for name, _, written_type, _ in columns),
        "end_header",
    ]
    return write_bytes(path, "".join(f"{line}\n" for line in header).encode() + rows.tobytes())


def _comments(frames: Sequence[Frame]) -> list[str]:
    """The names of labels and classes."""
    labels = {instance: name for frame in frames for name, instance in frame.instances.items()}
    tables = [frame.classes for frame in frames if frame.classes is not None]
    classes = {of_object.id: of_object.name for table in tables for of_object in table.classes.values()}
    named = [("label", labels), ("class", classes)]
    return [
        f"{word} {number} {printable(names[number])}" for word, names in named for number in sorted(names)
    ]
