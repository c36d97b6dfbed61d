"""Other programs that compose a panorama from six faces: installed libraries, and the paper's algorithm.

Each peer is a function that returns an equirectangular image, (H, W, 3) uint8. Faces are those of
:func:`omniscv.geometry.cube_rotations`, upright, 90 degrees wide.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from importlib.util import find_spec
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import Camera
from omniscv.geometry import R_LEVEL, cube_rotations

Image = NDArray[np.uint8]
Peer = Callable[[], Image]

PAPER = "the paper's algorithm"


def peers(faces: Mapping[str, Image], camera: Camera) -> dict[str, Peer]:
    """Return the installed peers by name; the paper's algorithm is always among them."""
    in_order = [faces[name] for name, _ in cube_rotations()]
    installed: dict[str, Peer] = {PAPER: lambda: paper(in_order, camera)}
    if find_spec("py360convert"):
        installed["py360convert"] = _py360convert(in_order, camera)
    if find_spec("av"):
        installed["ffmpeg v360"] = _v360(in_order, camera)
    return installed


def paper(faces: Sequence[Image], camera: Camera) -> Image:
    """Compose as OmniSCV (2020): the colour of each pixel is that of the face's pixel that its ray meets.

    Nothing is kept from image to image.
    """
    rays = camera.unproject().directions @ R_LEVEL.T
    R_w_f = np.array([rotation for _, rotation in cube_rotations()])
    face = (rays @ R_w_f[:, :, 2].T).argmax(axis=-1)
    p_f = np.einsum("hwi,hwij->hwj", rays, R_w_f[face])
    edge = len(faces[0])
    at = (edge / 2 * (1 + p_f[..., :2] / p_f[..., 2:])).astype(np.int64).clip(0, edge - 1)
    image: Image = np.stack(faces)[face, at[..., 1], at[..., 0]]
    return image


def remap_limit(camera: Camera, faces: Sequence[Image]) -> Peer:
    """Return the limit of sampling with OpenCV on a CPU: one remap with a map that is ready."""
    import cv2

    atlas = np.ascontiguousarray(np.concatenate(faces, axis=1))
    rng = np.linspace(1, len(faces[0]) - 2, camera.width, dtype=np.float32)
    x = np.tile(rng, (camera.height, 1)) + np.float32(0.37)
    y = np.repeat(rng[: camera.height, None], camera.width, axis=1) + np.float32(0.21)
    return lambda: np.asarray(cv2.remap(atlas, x, y, cv2.INTER_LINEAR), np.uint8)


def _py360convert(faces: Sequence[Image], camera: Camera) -> Peer:
    import py360convert

    size = camera.height, camera.width
    return lambda: np.asarray(
        py360convert.c2e(list(faces), *size, mode="bilinear", cube_format="list"), np.uint8
    )


def _v360(faces: Sequence[Image], camera: Camera) -> Peer:
    """Return ffmpeg's filter, which keeps its map from frame to frame."""
    import av

    picture = np.concatenate([np.concatenate(faces[i : i + 3], axis=1) for i in (0, 3)])
    time_base, graph, frames = Fraction(1, 25), av.filter.Graph(), count()
    start = graph.add_buffer(
        width=picture.shape[1],
        height=picture.shape[0],
        format=av.VideoFormat("rgb24"),
        time_base=time_base,
    )
    options = f"input=c3x2:output=e:in_forder=frblud:w={camera.width}:h={camera.height}:interp=linear"
    way, end = graph.add("v360", options), graph.add("buffersink")
    start.link_to(way)
    way.link_to(end)
    graph.configure()

    def compose() -> Image:
        frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
        frame.time_base, frame.pts = time_base, next(frames)
        graph.push(frame)
        composed: Any = graph.pull()
        return np.asarray(composed.to_ndarray(format="rgb24"), np.uint8)

    return compose
