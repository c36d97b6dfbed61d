"""Requests that the tests of captures share."""

from omniscv.captures.view import MODES, Request, View
from omniscv.geometry import Pose, cube_rotations

CENTER = (0.0, 0.0, 1.5)


def face_requests(size=32, modes=MODES, center=CENTER):
    """The six faces at a centre, mode by mode."""
    views = [View(Pose(center, R_w_c), 90.0, size, size) for _, R_w_c in cube_rotations()]
    return [Request(view, mode) for mode in modes for view in views]
