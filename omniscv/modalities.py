"""The table of modalities and of the layers derived from them, for sources, composition and files."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from omniscv import plugins
from omniscv.arguments import did_you_mean
from omniscv.errors import ArgumentError

Interpolation = Literal["blended", "nearest", "surface", "direction", "plane"]
"""How values between pixels are interpolated: ``blended``, by the user's filter; ``nearest``, never blended;
``surface``, planar depth along one surface; ``direction``, blended on one surface and normalised; ``plane``,
the normal of the plane through depth."""

Transfer = Literal["srgb", "linear", "film", "unknown"]
"""What 8-bit colours say of light: see :mod:`omniscv.light`."""

TRANSFERS: tuple[str, ...] = get_args(Transfer)

FileForm = Literal["picture", "png", "exr", "bound"]
"""How a layer is written: ``picture`` in the user's format (EXR for floats), PNG, EXR; ``bound``: EXR of half
floats that are rounded up."""


@dataclass(frozen=True)
class Modality:
    """One row of the table; a modality and its layer have the same name.

    Attributes:
        name: of the mode and of the layer.
        dtypes: of its pixels; the first is the usual one.
        channels: of a pixel; 0 for arrays (H, W).
        interpolation: how composition samples it.
        file: how the layer is written.
        channel_names: of an EXR file.
        attributes: of a file: unit, kind and frame of its values, or their colour space.
        outside: its value outside the field of view.
        wire_bytes: bytes of a pixel on the wire, for estimates: PNG of furnished rooms, raw floats.
        captured: whether sources deliver it; else it is derived from captures.
        derives: the layers derived from it.
        captured_as: the modality that is captured for it; itself if empty.
        marked_by: the layer that bounds its errors, or marks where they may be.
        aliases: other names, on the command line and in files.
        doc: the meaning of its values.
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
    def mark(self) -> bool:
        """Whether its pixels are marked or not."""
        return self.dtypes == ("bool",)

    @property
    def truth(self) -> bool:
        """Whether it is ground truth (not blended), which may be captured finer than colours."""
        return self.interpolation != "blended"

    def fits(self, pixels: NDArray[np.generic]) -> bool:
        """Return whether an array (H, W) or (H, W, channels) can hold it."""
        channels = pixels.shape[2:] == ((self.channels,) if self.channels else ())
        return channels and pixels.ndim >= 2 and pixels.dtype.name in self.dtypes


_TABLE: dict[str, Modality] = {}


def register(modality: Modality) -> None:
    """Add a modality to the table, or replace the one of its name."""
    _TABLE[modality.name] = modality


def get(name: str) -> Modality:
    """Return the row of a modality or derived layer, by its name or an alias.

    Raises:
        ArgumentError: no row has that name.
    """
    if name in _TABLE:
        return _TABLE[name]
    plugins.load()
    for row in _TABLE.values():
        if name == row.name or name in row.aliases:
            return row
    words: list[str] = []
    for row in _TABLE.values():
        words += [row.name, *row.aliases]
    near = did_you_mean(name, words)
    raise ArgumentError(f"mode: expected one of {', '.join(names())}; got {name!r}{near}")


def names() -> tuple[str, ...]:
    """Return the names of all modalities that sources can deliver."""
    plugins.load()
    return tuple(row.name for row in _TABLE.values() if row.captured)


def layers() -> tuple[Modality, ...]:
    """Return all rows, derived layers included, in the order of registration."""
    return tuple(_TABLE.values())


def chosen(modes: Iterable[str]) -> tuple[str, ...]:
    """Return the names of modalities, with aliases resolved.

    Raises:
        ArgumentError: no mode, an unknown or derived one, a duplicate, or a text in place of a sequence.
    """
    wanted = f"modes: expected a sequence of some of {', '.join(names())}, each once"
    if isinstance(modes, str):
        raise ArgumentError(f"{wanted}; got the text {modes!r}, write ({modes!r},)")
    listed = list(modes)
    rows = [get(mode) for mode in listed if isinstance(mode, str)]
    chosen = tuple(row.name for row in rows if row.captured)
    if not chosen or len(set(chosen)) != len(listed):
        raise ArgumentError(f"{wanted}; got {listed!r}")
    return chosen


SRGB = {"oiio:ColorSpace": "sRGB"}
"""Attributes of the file of 8-bit colours that are sRGB."""

_CAMERA_FRAME = "camera: x right, y down, z forward"
_DISTANCE = {
    "unit": "metre",
    "kind": "distance along the ray of the pixel, from its origin",
    "frame": _CAMERA_FRAME,
}

for _row in (
    Modality("lit", ("uint8", "float32"), 3, "blended", "picture", ("R", "G", "B"), wire_bytes=1.5,
             aliases=("rgb",), doc="RGB as captured"),
    Modality("raw", ("uint16",), 0, "nearest", "png", captured=False, doc="codes of a sensor with a mosaic"),
    Modality("sensor", ("uint8",), 3, "blended", "picture", ("R", "G", "B"), SRGB, captured=False,
             doc="RGB of a sensor, sRGB"),
    Modality("object_mask", ("uint8",), 3, "nearest", "png", wire_bytes=0.1, derives=("labels",),
             marked_by="label_edge", aliases=("mask",), doc="RGB colour of the object"),
    Modality("depth", ("float32",), 0, "surface", "exr", ("Y",), _DISTANCE, marked_by="depth_error",
             doc="metres; planar in captures, along the ray in images; +inf no surface"),
    Modality("normals", ("float32",), 3, "direction", "exr", ("R", "G", "B"),
             {"unit": "1", "kind": "unit normal of the surface", "frame": _CAMERA_FRAME}, wire_bytes=1.0,
             aliases=("normal",), doc="unit vectors; world frame in captures, camera frame in images"),
    Modality("labels", ("uint16",), 0, "nearest", "png", captured=False,
             doc="1 + rank of the object's name; 0 nothing known"),
    Modality("classes", ("uint16",), 0, "nearest", "png", captured=False,
             doc="id of the object's class; 0 background, or no class"),
    Modality("normals_from_depth", ("float32",), 3, "plane", captured=False, captured_as="depth",
             doc="in place of normals, for sources whose normals have 8 bits"),
    Modality("depth_error", ("float32",), 0, "surface", "bound", ("Y",),
             {**_DISTANCE, "kind": "how far the distance along the ray may be off"}, captured=False,
             doc="metres that depth may be off; +inf where nothing bounds it"),
    Modality("label_edge", ("bool",), 0, "nearest", "png", captured=False,
             doc="within a capture's pixel of a label boundary"),
    Modality("occluded", ("bool",), 0, "nearest", "png", captured=False,
             doc="the optical centre is not visible from the camera's position"),
    Modality("relit", ("bool",), 0, "nearest", "png", captured=False,
             doc="colours changed so that faces agree at their edges"),
    Modality("light", ("uint8",), 0, "nearest", "png", captured=False,
             doc="bits: 1 dome, 2 translucent, 4 mismatch, 8 view-dependent, 16 clipped, 32 relit"),
    Modality("unsure", ("bool",), 0, "nearest", "png", captured=False,
             doc="not verified by any capture"),
    Modality("doubt", ("bool",), 0, "nearest", "png", captured=False,
             doc="the label or depth may be wrong: label_edge, unsure, or depth_error above 1 %"),
    Modality("unseen", ("bool",), 0, "nearest", "png", captured=False,
             doc="within the field of view, but seen by no recorded view: as if outside"),
):  # fmt: skip
    register(_row)
