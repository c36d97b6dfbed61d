"""Lenses drawn at random, and the part of their images that OpenCV's fisheye module can compute."""

import numpy as np
from hypothesis import strategies as st

from omniscv import cameras

SIZE = {"width": 64, "height": 48}

lenses = st.builds(
    lambda fx, fy, cx, cy, k: cameras.create("kannala-brandt", **SIZE, fx=fx, fy=fy, cx=cx, cy=cy, k=k),
    st.floats(10, 1000),
    st.floats(10, 1000),
    st.floats(-20, 100),
    st.floats(-20, 100),
    st.lists(st.floats(-0.1, 0.1), min_size=4, max_size=4),
)


def seen_in_front(camera: cameras.Camera) -> tuple[np.ndarray, np.ndarray]:
    """Valid pixels whose rays lie within 80 degrees of the axis, and the rays: cv2 works on x / z."""
    rays = camera.unproject()
    seen = rays.valid & (rays.directions[..., 2] > np.cos(np.radians(80)))
    return camera.pixels()[seen], rays.directions[seen]
