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
from typing import Any, get_args

from omniscv.arguments import Reader, fields, number, one_of, within
from omniscv.cameras import Camera
from omniscv.dataset.pictures import write_color, write_pixels
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.truth.layout_maps import exact_maps, original_maps
from omniscv.truth.layout_record import Visibility

name = "cfl"
needs = ("layout", "lit")
keys = ("layout",)

_MAPS: dict[str, Reader] = {
    "edge_sigma": partial(number, above=0, most=1),
    "corner_sigma": partial(number, above=0, most=1),
    "visibility": lambda key, value: one_of(key, value, get_args(Visibility)),
}
_READERS: dict[str, Reader] = {
    "image_format": lambda key, value: one_of(key, value, ("jpg", "png")),
    "recipe": lambda key, value: one_of(key, value, ("exact", "original")),
    "layout": lambda key, value: fields(key, value, {"source": _any, "maps": _maps}).get("maps", {}),
    **_MAPS,
}


def _any(key: str, value: Any) -> Any:
    return value


def _maps(key: str, value: Any) -> Any:
    return fields(key, value, _MAPS)


def check_options(options: Mapping[str, Any], cameras: Mapping[str, Camera]) -> None:
    """Refuse options that the format does not have; see the module."""
    _chosen(options)


def refuses(camera: Camera) -> str | None:
    """Return None: maps can be drawn in the images of every camera."""
    return None


def _chosen(options: Mapping[str, Any]) -> tuple[str, str, dict[str, Any]]:
    """Suffix, recipe, and the options of exact maps."""
    chosen = fields("", options, _READERS)
    maps = {**chosen.get("layout", {}), **{key: chosen[key] for key in _MAPS if key in chosen}}
    recipe = chosen.get("recipe", "exact")
    if recipe == "original" and maps:
        wanted = "the original recipe, which has its own numbers, without others"
        raise ArgumentError(f"recipe: expected {wanted}; got {', '.join(maps)}")
    return chosen.get("image_format", "jpg"), recipe, maps


def write(frames: Sequence[Frame], out: Path, options: Mapping[str, Any]) -> list[Path]:
    """Write frames below a folder; see the module.

    Raises:
        ArgumentError: an unknown option, one of the exact maps for the original recipe, a frame without a
            layout or colours, or one of which the original recipe makes no maps.
    """
    suffix, recipe, maps = _chosen(options)
    written = []
    for frame in frames:
        with within(frame.key):
            if recipe == "original":
                edges, corners = original_maps(frame.layout, frame.camera, frame.pose)
            else:
                edges, corners = exact_maps(frame.layout, frame.camera, **maps)
        written.append(write_color(out / "RGB" / f"{frame.key}.{suffix}", frame))
        written.append(write_pixels(out / "EM_gt" / f"{frame.key}_EM.{suffix}", edges))
        written.append(write_pixels(out / "CM_gt" / f"{frame.key}_CM.{suffix}", corners))
    return written
