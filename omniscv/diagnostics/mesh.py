"""The doctor of meshes: what was left out, holes, and what a position sees."""

import time

import numpy as np

from omniscv.diagnostics import Finding
from omniscv.geometry import Array, Pose, cube_rotations
from omniscv.sources.base import Request, View
from omniscv.sources.mesh import MeshSource, open_mesh

_EDGE_PX = 256
_NEAR_M = 0.02
_LARGEST_M = 1000.0


def examine_mesh(address: str, position: Array | None = None) -> list[Finding]:
    """Examine a mesh by its triangles and six views.

    Args:
        address: ``mesh://ROOM.glb``, with its options.
        position: (3,) world frame, metres; None: the middle of the mesh.

    Raises:
        ArgumentError: a wrong address, or a file that is no mesh.
        SourceError: a package that reads it is not installed.
    """
    with open_mesh(address) as source:
        model = source.model
        low = model.vertices.min(axis=0)
        high = model.vertices.max(axis=0)
        size = high - low
        extent = " x ".join(f"{length:.4g}" for length in size)
        counts = [f"{count} {what}" for what, count in sorted(model.notes.items())]
        left_out = ", ".join(counts) or "nothing"
        holes = str(source.holes)
        colours = model.colorless or "yes"
        center = (low + high) / 2 if position is None else position
        unit = "give its unit: ?unit=cm, mm, in or ft"
        return [
            Finding("mesh", f"{len(model.faces)} triangles, {len(model.names)} objects"),
            Finding.unless(size.max() < _LARGEST_M, "size", f"{extent} m", "warning", unit),
            Finding.unless(not counts, "left out", left_out, "warning", "repair it"),
            Finding.unless(source.holes == 0, "open edges", holes, "warning", "through holes is sky"),
            Finding.unless(not model.colorless, "colours", colours, "warning", "labels and depth are whole"),
            *_seen(source, center),
        ]


def _seen(source: MeshSource, center: Array) -> list[Finding]:
    """Measure what a position sees, and how long a view takes."""
    requests = []
    for _, R_w_c in cube_rotations():
        requests.append(Request(View(Pose(center, R_w_c), 90.0, _EDGE_PX, _EDGE_PX), "depth"))
    list(source.capture(requests[:1]))  # the first one makes the tree
    started = time.perf_counter()
    depth = np.stack([capture.pixels for capture in source.capture(requests)])
    seconds = (time.perf_counter() - started) / len(requests)
    sky = float(np.isinf(depth).mean())
    nearest = float(depth.min())
    place = ", ".join(f"{coordinate:.4g}" for coordinate in center)
    seen = f"{100 * sky:.1f} % from {place}"
    away = f"{nearest:.3g} m"
    return [
        Finding.unless(sky < 1, "sky", seen, "warning", "give --position inside"),
        Finding.unless(nearest > _NEAR_M, "nearest surface", away, "warning", "move away from it"),
        Finding("a view of depth", f"{1000 * seconds:.0f} ms, {_EDGE_PX} px"),
    ]
