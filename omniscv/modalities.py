"""What an image can show: the one table of modalities and of the layers derived from them.

Sources, composition and files look a modality up here; none of them lists modalities of its own.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from omniscv import plugins
from omniscv.errors import ArgumentError

Interpolation = Literal["blended", "nearest", "surface", "direction", "plane"]
"""How values between pixels are found: ``blended`` by the filter that the user chose; ``nearest``, never
blended; ``surface``, planar depth along one surface; ``direction``, blended on one surface, and normalised;
``plane``, the normal of the plane through depth."""

FileForm = Literal["picture", "png", "exr"]
"""How a layer is written: ``picture`` in the user's format (EXR if it is of floats), PNG, or EXR."""


@dataclass(frozen=True)
class Modality:
    """One row of the table; a modality and the layer that shows it have one name.

    Attributes:
        name: of the mode and of the layer.
        dtypes: what its pixels may be; the first is the usual one.
        channels: of a pixel; 0 for arrays (H, W).
        interpolation: how composition samples it.
        file: how the layer is written.
        channel_names: of an EXR file.
        attributes: of an EXR file: unit, kind and frame of its values.
        outside: its value outside the field of view.
        wire_bytes: what a pixel takes on the wire, for estimates: PNG of furnished rooms, raw floats.
        captured: whether sources deliver it; else it is derived from captures.
        derives: the layers that come with it.
        captured_as: the modality that is captured for it; its own if empty.
        marked_by: the layer that says where, or by how much, its values may be off.
        aliases: other words for it, on the command line and in older recordings.
        doc: what its values mean.
    """

    name: str
    dtypes: tuple[str, ...]
    channels: int = 0
    interpolation: Interpolation = "blended"
    file: FileForm = "exr"
    channel_names: tuple[str, ...] = ()
    attributes: Mapping[str, str] = field(default_factory=dict)
    outside: float = 0
    wire_bytes: float = 4.0
    captured: bool = True
    derives: tuple[str, ...] = ()
    captured_as: str = ""
    marked_by: str = ""
    aliases: tuple[str, ...] = ()
    doc: str = ""

    @property
    def truth(self) -> bool:
        """Whether it is ground truth, which may be captured finer than colours: all that is not blended."""
        return self.interpolation != "blended"

    def fits(self, pixels: NDArray[np.generic]) -> bool:
        """Whether an array (H, W) or (H, W, channels) can hold it."""
        channels = pixels.shape[2:] == ((self.channels,) if self.channels else ())
        return channels and pixels.ndim >= 2 and pixels.dtype.name in self.dtypes


_TABLE: dict[str, Modality] = {}


def register(modality: Modality) -> None:
    """Add a modality to the table, or replace the one of its name."""
    _TABLE[modality.name] = modality


def get(name: str) -> Modality:
    """The row of a modality or derived layer, by its name or an alias.

    Raises:
        ArgumentError: no row has that name.
    """
    if name in _TABLE:
        return _TABLE[name]
    plugins.load()
    for row in _TABLE.values():
        if name == row.name or name in row.aliases:
            return row
    raise ArgumentError(f"mode: expected one of {', '.join(names())}; got {name!r}")


def names() -> tuple[str, ...]:
    """The names of all modalities that sources can deliver."""
    plugins.load()
    return tuple(row.name for row in _TABLE.values() if row.captured)


def layers() -> tuple[Modality, ...]:
    """All rows, derived layers included, in the order of registration."""
    return tuple(_TABLE.values())


def chosen(modes: Iterable[str]) -> tuple[str, ...]:
    """Names of modalities, aliases resolved, each once.

    Raises:
        ArgumentError: no mode, an unknown or derived one, one twice, or a text in place of a sequence.
    """
    given = modes if isinstance(modes, str) else list(modes)
    rows = [get(mode) for mode in given if isinstance(mode, str)] if isinstance(given, list) else []
    found = tuple(row.name for row in rows if row.captured)
    if found and len(set(found)) == len(given):
        return found
    got = f"{given!r}" if isinstance(given, list) else f"the text {given!r}, write ({given!r},)"
    raise ArgumentError(f"modes: expected a sequence of some of {', '.join(names())}, each once; got {got}")


_CAMERA_FRAME = "camera: x right, y down, z forward"
_DISTANCE = {
    "unit": "metre",
    "kind": "distance along the ray of the pixel, from its origin",
    "frame": _CAMERA_FRAME,
}

for _row in (
    Modality("lit", ("uint8", "float32"), 3, "blended", "picture", ("R", "G", "B"), wire_bytes=1.5,
             doc="RGB as captured"),
    Modality("object_mask", ("uint8",), 3, "nearest", "png", wire_bytes=0.1, derives=("labels",),
             marked_by="label_edge", aliases=("mask",), doc="RGB colour of the object"),
    Modality("depth", ("float32",), 0, "surface", "exr", ("Z",), _DISTANCE, marked_by="depth_error",
             doc="metres; planar in captures, along the ray in images; +inf no surface"),
    Modality("normals", ("float32",), 3, "direction", "exr", ("N.X", "N.Y", "N.Z"),
             {"unit": "1", "kind": "unit normal of the surface", "frame": _CAMERA_FRAME}, wire_bytes=1.0,
             aliases=("normal",), doc="unit vectors; world frame in captures, camera frame in images"),
    Modality("labels", ("uint16",), 0, "nearest", "png", captured=False,
             doc="1 + rank of the object's name; 0 nothing known"),
    Modality("classes", ("uint16",), 0, "nearest", "png", captured=False,
             doc="id of the object's class; 0 background, or no class"),
    Modality("normals_from_depth", ("float32",), 3, "plane", captured=False, captured_as="depth",
             doc="in place of normals, for sources whose normals have 8 bits"),
    Modality("depth_error", ("float32",), 0, "surface", "exr", ("Z",),
             {**_DISTANCE, "kind": "how far the distance along the ray may be off"}, captured=False,
             doc="metres that depth may be off; +inf where nothing bounds it"),
    Modality("label_edge", ("bool",), 0, "nearest", "png", captured=False,
             doc="within a capture's pixel of a label boundary"),
    Modality("occluded", ("bool",), 0, "nearest", "png", captured=False,
             doc="the optical centre is not visible from the camera's position"),
    Modality("unsure", ("bool",), 0, "nearest", "png", captured=False,
             doc="not verified by any capture"),
):  # fmt: skip
    register(_row)
