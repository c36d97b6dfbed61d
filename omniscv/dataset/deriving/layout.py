"""The truth ``layout``: the room's corners and edges, as STEM.layout.json holds them.

Options: ``source`` (``scene``, or ``fitted`` to the image; if not given, fitted where the scene's room is not
known) and ``tolerance`` (``abs_m``, ``rel``).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from omniscv.arguments import fields, number, one_of
from omniscv.cameras import create
from omniscv.compose.image import OmniImage
from omniscv.dataset.truths import Observation, Truth, register
from omniscv.errors import ArgumentError
from omniscv.geometry.scene_geometry import SceneGeometry
from omniscv.truth.layout_record import project_layout
from omniscv.truth.layout_visibility import Tolerance
from omniscv.truth.room_fit import Picture, is_room
from omniscv.truth.room_layout import RoomLayout, layout

_PANORAMA = "equirectangular", 1024, 512
_FIT_MODES = ("object_mask", "depth", "normals")


def derive(observation: Observation, options: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the record of the room's layout in an image; see :mod:`omniscv.truth.layout_record`.

    A room that the source does not know is fitted to the image, or, where that does not show every wall, to a
    panorama from the same place without furniture, if the source can hide objects.

    Raises:
        ArgumentError: an unknown option, or no room that is known or fits.
    """
    chosen = _options(options)
    image = observation.image
    found = _room(observation, chosen.get("source"))
    return project_layout(found, image.camera, image.pose, image.depth, tolerance=chosen.get("tolerance"))


def _options(options: Mapping[str, Any]) -> dict[str, Any]:
    shared = fields("layout", options.get("layout", {}), {"source": _source, "maps": lambda _, maps: maps})
    own = {key: value for key, value in options.items() if key != "layout"}
    return {**shared, **fields("layout", own, {"source": _source, "tolerance": _tolerance})}


def _source(name: str, value: object) -> str:
    return str(one_of(name, value, ("scene", "fitted")))


def _tolerance(name: str, value: object) -> Tolerance:
    return Tolerance(**fields(name, value, {"abs_m": number, "rel": number}))


def _room(observation: Observation, source: str | None) -> RoomLayout:
    if source != "fitted" and (source == "scene" or observation.geometry.room is not None):
        return layout(observation.geometry)
    image = observation.image
    try:
        shown = Picture(image.camera, image.pose, image.layers, observation.instances)
        return layout([shown], observation.classes)
    except ArgumentError as hidden:
        empty = _panorama_without_furniture(observation)
        if empty is None:
            raise hidden from None
        return layout([empty], observation.classes)


def _panorama_without_furniture(observation: Observation) -> OmniImage | None:
    """A panorama from the image's place with only the room in it; None if the source cannot hide objects."""
    if observation.renderer is None:
        return None
    source = observation.renderer.source
    furniture = [name for name in source.objects().names() if not is_room(name, observation.classes)]
    try:
        empty = source.without(furniture)
    except ArgumentError:
        return None
    with empty:
        return observation.renderer.of(empty).render(create(*_PANORAMA), observation.image.pose, _FIT_MODES)


def _captures(geometry: SceneGeometry, options: Mapping[str, Any]) -> bool:
    return geometry.room is None or _options(options).get("source") == "fitted"


register(
    Truth(
        "layout",
        derive,
        needs=("depth",),
        file="layout.json",
        keys=("layout", "tolerance"),
        captures=_captures,
        check_options=_options,
    )
)
