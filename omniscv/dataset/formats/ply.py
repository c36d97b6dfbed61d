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
        """Write the clouds of ``frames`` into ``out``: of each, of all, or both, as ``options`` say."""
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
    """Write a ``cloud`` to ``path``, whole or not at all, and return the path.

    ``comments`` are lines of the header.
    """
    is_far = len(cloud) and np.abs(cloud.positions_w).max() > FAR_M
    dtype, written_type = ("<f8", "double") if is_far else ("<f4", "float")
    dtypes: list[tuple[str, str]] = []
    properties = []
    columns: list[NDArray[Any]] = []

    def add(names: Sequence[str], dtype: str, written_type: str, values: NDArray[Any]) -> None:
        """Add ``values`` (N, len(names)): of ``dtype`` in memory, of ``written_type`` in the header."""
        for index, name in enumerate(names):
            dtypes.append((name, dtype))
            properties.append(f"property {written_type} {name}")
            columns.append(values[:, index])

    add("xyz", dtype, written_type, cloud.positions_w)
    for layer, (names, dtype, written_type) in _COLUMNS.items():
        if layer in cloud.values:
            add(names, dtype, written_type, cloud.values[layer].reshape(len(cloud), len(names)))
    rows = np.empty(len(cloud), dtypes)
    for (name, _), column in zip(dtypes, columns, strict=True):
        rows[name] = column
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment metres; world frame: X forward, Y left, Z up",
        *(f"comment {comment}" for comment in comments),
        f"element vertex {len(cloud)}",
        *properties,
        "end_header",
    ]
    return write_bytes(path, "".join(f"{line}\n" for line in header).encode() + rows.tobytes())


def _comments(frames: Sequence[Frame]) -> list[str]:
    """Return a line for each label and each class, with its name."""
    labels: dict[int, str] = {}
    classes: dict[int, str] = {}
    for frame in frames:
        for name, instance in frame.instances.items():
            labels[instance] = name
        if frame.classes is not None:
            for category in frame.classes.classes.values():
                classes[category.id] = category.name
    lines = []
    for label, name in sorted(labels.items()):
        lines.append(f"label {label} {printable(name)}")
    for class_id, name in sorted(classes.items()):
        lines.append(f"class {class_id} {printable(name)}")
    return lines
