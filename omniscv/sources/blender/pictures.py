"""The files that Blender writes, as pixels of captures."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.errors import BadReplyError
from omniscv.sources.base import View

_SKY = 0.99e10
"""Blender's depth where there is no surface is 1e10, in units of the scene."""

Pixels = dict[str, NDArray[Any]]
"""Pixels by modality."""


def read_colors(path: Path, view: View) -> Pixels:
    """Return ``lit``, (H, W, 3) RGB: uint8 of a PNG, float32 of an EXR.

    Raises:
        BadReplyError: the file is no such picture, or not of the view's size.
    """
    import cv2

    if path.suffix == ".exr":
        return {"lit": _checked(_passes(path).get("Combined.RGB"), view, path)}
    bgr = cv2.imread(str(path), cv2.IMREAD_COLOR)
    return {"lit": _checked(None if bgr is None else np.ascontiguousarray(bgr[..., ::-1]), view, path)}


def read_data(path: Path, view: View, metres: float) -> Pixels:
    """Return object masks, depth and normals.

    ``object_mask`` is uint16 ids (H, W); ``depth`` planar metres (H, W), +inf where there is no surface;
    ``normals`` (H, W, 3) unit vectors in world axes, 0 where there is no surface.

    Args:
        path: a multi-part EXR file of Blender's passes.
        view: what was rendered.
        metres: of a unit of the scene.

    Raises:
        BadReplyError: the file has no such passes, or not of the view's size.
    """
    passes = _passes(path)
    ids = _checked(passes.get("Object Index.X"), view, path)
    z = _checked(passes.get("Depth.Z"), view, path)
    normals = _checked(passes.get("Normal.XYZ"), view, path)
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        unit = np.where((length > 0) & (z < _SKY)[..., None], normals / length, 0)
    return {
        "object_mask": np.rint(ids).astype(np.uint16),
        "depth": np.where(z < _SKY, z * np.float32(metres), np.inf).astype(np.float32),
        "normals": unit.astype(np.float32),
    }


def _passes(path: Path) -> Pixels:
    """Return passes by name and channels: ``Depth.Z`` (H, W), ``Normal.XYZ``, ``Combined.RGB`` (H, W, 3)."""
    import OpenImageIO

    passes: Pixels = {}
    file = OpenImageIO.ImageInput.open(str(path))
    if file is None:
        raise BadReplyError(f"expected an EXR file of Blender, got: {OpenImageIO.geterror()}")
    try:
        part = 0
        while file.seek_subimage(part, 0):
            spec = file.spec()
            pixels = file.read_image(part, 0, 0, spec.nchannels, "float")
            channels = [channel.rsplit(".", 1) for channel in spec.channelnames]  # ViewLayer.Normal.X
            for start, (name, _) in enumerate(channels):
                same = [i for i, channel in enumerate(channels) if channel[0] == name][:3]
                if pixels is not None and same[0] == start:
                    letters = "".join(channels[i][1] for i in same)
                    picture = pixels[..., same if len(same) > 1 else start]
                    passes[f"{name.rpartition('.')[2]}.{letters}"] = picture
            part += 1
    finally:
        file.close()
    return passes


def _checked(pixels: NDArray[Any] | None, view: View, path: Path) -> NDArray[Any]:
    if pixels is None or pixels.shape[:2] != (view.height, view.width):
        got = "none" if pixels is None else f"{pixels.shape[1]} x {pixels.shape[0]} px"
        raise BadReplyError(f"{path.name}: expected a picture of {view.width} x {view.height} px, got {got}")
    return pixels
