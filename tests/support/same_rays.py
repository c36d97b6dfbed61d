"""When two cameras are the same to whoever uses them."""

import numpy as np

from omniscv import Rig
from omniscv.cameras import Camera

# A principal point loses up to half a unit in its last place when 0.5 is taken away and added again:
# 6e-14 px of 1000, seen under a focal length of 10 px or more; a few roundings come on top.
DIRECTION_TOLERANCE = 1e-13


def assert_same_rays(one: Camera, other: Camera) -> None:
    """Both have the same rays at every pixel, and at the image's corners."""
    assert (one.width, one.height) == (other.width, other.height)
    corners = np.array([[0, 0], [one.width, 0], [0, one.height], [one.width, one.height]])
    for pixels in (None, corners):
        a = one.unproject(pixels)
        b = other.unproject(pixels)
        # A pixel on the very edge of the image circle may fall to either side.
        assert np.count_nonzero(a.valid != b.valid) <= 4
        both = a.valid & b.valid
        np.testing.assert_allclose(a.directions[both], b.directions[both], rtol=0, atol=DIRECTION_TOLERANCE)


def assert_same_rig(one: Rig, other: Rig) -> None:
    """Both have the same cameras, of the same names and times, at the same poses."""
    assert list(one.cameras) == list(other.cameras)
    for name, mounted in other.cameras.items():
        assert_same_rays(one.cameras[name].camera, mounted.camera)
        assert one.cameras[name].time_offset == mounted.time_offset
        np.testing.assert_allclose(one.cameras[name].pose.position, mounted.pose.position, atol=1e-12)
        np.testing.assert_allclose(one.cameras[name].pose.rotation, mounted.pose.rotation, atol=1e-12)
