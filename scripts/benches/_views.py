"""Views for live servers to capture."""

from collections.abc import Iterator

from omniscv.geometry import Pose, cube_rotations
from omniscv.sources import Request, View

MODES = ("lit", "object_mask", "depth")


def requests(size: int) -> Iterator[Request]:
    """Yield the faces of viewpoints on a path without end, all modes of a view together."""
    viewpoint = 0
    while True:
        center = (-1 + 0.01 * (viewpoint % 200), 0.1, 1.5)
        for _, R_w_c in cube_rotations():
            view = View(Pose(center, R_w_c), 90.0, size, size)
            for mode in MODES:
                yield Request(view, mode)
        viewpoint += 1
