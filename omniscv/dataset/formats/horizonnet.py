"""HorizonNet's folder, which its kin read, too: ``img/STEM.png`` and ``label_cor/STEM.txt``.

Upright equirectangular panoramas in a room of upright walls; see :mod:`omniscv.truth.cor_id`. Option
``image_format``: ``png`` (default) or ``jpg``.
Source: sunset1995/HorizonNet, README_PREPARE_DATASET.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from omniscv.arguments import Reader, fields, one_of, within
from omniscv.cameras import Camera
from omniscv.dataset.pictures import write_color
from omniscv.frame import Frame
from omniscv.truth.cor_id import cor_id
from omniscv.truth.cor_id import refuses as cor_id_refuses
from omniscv.truth.layout_record import room_of

name = "horizonnet"
refuses = cor_id_refuses
needs = ("layout", "lit")


_READERS: dict[str, Reader] = {"image_format": lambda key, value: one_of(key, value, ("png", "jpg"))}


def check_options(options: Mapping[str, Any], cameras: Mapping[str, Camera]) -> None:
    """Refuse options that the format does not have; see the module."""
    fields("", options, _READERS)


def write(frames: Sequence[Frame], out: Path, options: Mapping[str, Any]) -> list[Path]:
    """Write frames below a folder; see the module.

    Raises:
        ArgumentError: an unknown option, a frame without a layout or colours, a camera that is not an upright
            panorama within the room, or a room that is no prism.
    """
    suffix = fields("", options, _READERS).get("image_format", "png")
    texts = {frame.key: corner_lines(frame) for frame in frames}  # refused before anything is written
    written = []
    for frame in frames:
        written.append(write_color(out / "img" / f"{frame.key}.{suffix}", frame))
        path = out / "label_cor" / f"{frame.key}.txt"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(texts[frame.key], encoding="ascii")
        written.append(path)
    return written


def corner_lines(frame: Frame) -> str:
    """Return the lines ``x y`` of a frame's corners, px.

    Raises:
        ArgumentError: as :func:`write`.
    """
    with within(frame.key):
        corners = cor_id(room_of(frame.layout), frame.camera, frame.pose)
        return "".join(f"{x:.3f} {y:.3f}\n" for x, y in corners.tolist())
