"""CFL's folder: ``RGB/STEM.jpg``, ``EM_gt/STEM_EM.jpg`` of edges, ``CM_gt/STEM_CM.jpg`` of corners.

CFL pairs the files by their order. Options:

``image_format``  ``jpg`` (default: CFL looks for no other) or ``png``, which is exact
``recipe``        ``exact`` (default) or ``original``
``visibility``    of the exact maps: ``room`` (default: behind furniture, too), ``full`` (only what the image
                  shows) or ``all`` (behind walls, too)
``edge_sigma``, ``corner_sigma``  of the exact maps, in parts of the panorama's width

See :mod:`omniscv.truth.layout_maps`. Source: cfernandezlab/CFL, test_CFL.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from omniscv.arguments import Reader, fields, number, one_of, within
from omniscv.cameras import Camera
from omniscv.dataset.frames import Frame
from omniscv.dataset.pictures import color, write_pixels
from omniscv.errors import ArgumentError
from omniscv.truth.layout_maps import VISIBILITIES, exact_maps, original_maps

name = "cfl"

_READERS: dict[str, Reader] = {
    "image_format": lambda key, value: one_of(key, value, ("jpg", "png")),
    "visibility": lambda key, value: one_of(key, value, VISIBILITIES),
    "recipe": lambda key, value: one_of(key, value, ("exact", "original")),
    "edge_sigma": partial(number, above=0, most=1),
    "corner_sigma": partial(number, above=0, most=1),
}


def write(frames: Sequence[Frame], out: Path, options: Mapping[str, Any]) -> list[Path]:
    """Write frames below a folder; see the module.

    Raises:
        ArgumentError: an unknown option, one of the exact maps for the original recipe, a frame without a
            layout or colours, or one of which the original recipe makes no maps.
    """
    chosen = fields(name, options, _READERS)
    suffix, recipe = chosen.pop("image_format", "jpg"), chosen.pop("recipe", "exact")
    if recipe == "original" and chosen:
        wanted = "the original recipe, which has its own numbers, without others"
        raise ArgumentError(f"cfl: expected {wanted}; got {', '.join(chosen)}")
    written = []
    for frame in frames:
        with within(f"{frame.key}: {name}"):
            if recipe == "original":
                edges, corners = original_maps(frame.layout, frame.camera, frame.pose)
            else:
                edges, corners = exact_maps(frame.layout, frame.camera, **chosen)
        for folder, ending, picture in (
            ("RGB", "", color(frame)),
            ("EM_gt", "_EM", edges),
            ("CM_gt", "_CM", corners),
        ):
            written.append(write_pixels(out / folder / f"{frame.key}{ending}.{suffix}", picture))
    return written


def refuses(camera: Camera) -> str | None:
    """Return None: maps can be drawn in the images of every camera."""
    return None
