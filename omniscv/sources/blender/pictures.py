"""The files that Blender writes, as pixels of captures."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.errors import BadReplyError
from omniscv.sources.base import View
from omniscv.sources.codecs import check_depth, decode_png
from omniscv.storage.bounded import library_error, read_bytes

_SKY = 0.99e10
"""Blender's depth where there is no surface is 1e10, in units of the scene."""

_MOST_ID = 0xFFFF
_MOST_HEADER = 1 << 16  # bytes of a PNG besides its pixels
_MOST_PARTS, _MOST_CHANNELS = 16, 16  # of an EXR file

Pixels = dict[str, NDArray[Any]]
"""Pixels by modality."""


def read_colors(path: Path, view: View) -> Pixels:
    """Return ``lit``, (H, W, 3) RGB: uint8 of a PNG, float32 of an EXR.

    Raises:
        BadReplyError: the file is no such picture, or not of the view's size.
    """
    _check_regular(path)
    if path.suffix == ".exr":
        return {"lit": _pass(_passes(path, view), "Combined.RGB", path)}
    most = 8 * view.width * view.height + _MOST_HEADER
    return {"lit": decode_png(read_bytes(path, most), view)}


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
    _check_regular(path)
    passes = _passes(path, view)
    ids, z, normals = (_pass(passes, name, path) for name in ("Object Index.X", "Depth.Z", "Normal.XYZ"))
    check_depth(z)
    if not ((ids >= 0) & (ids <= _MOST_ID)).all() or not np.isfinite(normals).all():
        raise BadReplyError(f"{path.name}: expected ids up to {_MOST_ID} and finite normals, got others")
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        unit = np.where((length > 0) & (z < _SKY)[..., None], normals / length, 0)
    return {
        "object_mask": np.rint(ids).astype(np.uint16),
        "depth": np.where(z < _SKY, z * np.float32(metres), np.inf).astype(np.float32),
        "normals": unit.astype(np.float32),
    }


def _check_regular(path: Path) -> None:
    """Raise BadReplyError for no picture, and for a link, a FIFO or a device, which may have no end."""
    if path.is_symlink() or not path.is_file():
        raise BadReplyError(f"{path.name}: expected a picture, got none, or no regular file")


def _passes(path: Path, view: View) -> Pixels:
    """Return passes by name and channels: ``Depth.Z`` (H, W), ``Normal.XYZ``, ``Combined.RGB`` (H, W, 3)."""
    import OpenImageIO

    passes: Pixels = {}
    file = OpenImageIO.ImageInput.open(str(path))
    if file is None:
        raise BadReplyError(f"expected an EXR file of Blender, got: {library_error(OpenImageIO)}")
    try:
        part = 0
        while part < _MOST_PARTS and file.seek_subimage(part, 0):
            spec = file.spec()
            if (spec.width, spec.height) != (view.width, view.height) or spec.nchannels > _MOST_CHANNELS:
                expected = f"{path.name}: expected a picture of {view.width} x {view.height} px"
                raise BadReplyError(f"{expected}, got {spec.width} x {spec.height} px")
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


def _pass(passes: Pixels, name: str, path: Path) -> NDArray[Any]:
    if name not in passes:
        raise BadReplyError(f"{path.name}: expected the pass {name}, got none")
    return passes[name]
