"""Requests that the tests of sources share."""

from omniscv import modalities
from omniscv.geometry import Pose, cube_rotations
from omniscv.sources import Request, View

CENTER = (0.0, 0.0, 1.5)


def face_requests(size=32, modes=None, center=CENTER):
    """The six faces at a centre, mode by mode; all modalities if no modes are given."""
    views = [View(Pose(center, R_w_c), 90.0, size, size) for _, R_w_c in cube_rotations()]
    return [Request(view, mode) for mode in modes or modalities.names() for view in views]
