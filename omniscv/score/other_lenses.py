"""Lenses that a picture may have been taken for, of the same field of view or of another one."""

from collections.abc import Iterator
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from omniscv.cameras import Camera, create

_MODELS = ("pinhole", "fisheye-equidistant", "fisheye-stereographic", "fisheye-orthographic",
           "fisheye-equisolid")  # fmt: skip
_OF_FIELD = (0.7, 0.8, 0.9, 1.1, 1.25, 1.4)
"""Fields of view of the same lens, relative to the camera's."""
_WIDEST_DEG = {"pinhole": 150.0, "fisheye-orthographic": 180.0, "fisheye-stereographic": 320.0}
_WIDEST = 350.0  # degrees, of other models
_KEPT = 4  # cameras whose other lenses are kept


class Lens(NamedTuple):
    """A lens.

    Attributes:
        name: for people, such as ``fisheye-equisolid of 185 degrees``.
        camera: of the same size as the picture.
    """

    name: str
    camera: Camera


@lru_cache(_KEPT)
def other_lenses(camera: Camera) -> tuple[Lens, ...]:
    """Return the lenses that a picture by ``camera`` is tried with; none for panoramas and mirrors, which do
    not look along +z."""
    field_deg = _field_deg(camera)
    if field_deg is None:
        return ()
    return tuple(_lenses(camera, field_deg))


def _lenses(camera: Camera, field_deg: float) -> Iterator[Lens]:
    """Yield other models of the camera's field of view, and its own one of others."""
    for model in _MODELS:
        fields = [field_deg * factor for factor in _OF_FIELD] if model == camera.name else [field_deg]
        for degrees in fields:
            if degrees <= _WIDEST_DEG.get(model, _WIDEST):
                yield Lens(f"{model} of {degrees:.0f} degrees", _lens(camera, model, degrees))


def _lens(camera: Camera, model: str, field_deg: float) -> Camera:
    """Return a lens with a field of view across the smaller side of a camera's picture."""
    size = {"width": camera.width, "height": camera.height}
    if model == "pinhole":
        focal = min(camera.width, camera.height) / 2 / np.tan(np.radians(field_deg / 2))
        field_deg = float(2 * np.degrees(np.arctan(camera.width / 2 / focal)))
    return create(model, **size, center=camera.center, fov_deg=field_deg)


def _field_deg(camera: Camera) -> float | None:
    """Return the field of view across the smaller side of a picture; None where its middle does not look
    along +z, or its borders see nothing."""
    if camera.wraps:
        return None
    reach = min(camera.width, camera.height) / 2 - 1e-3
    u, v = camera.center
    rays = camera.unproject([[u, v], [u - reach, v], [u + reach, v]])
    if not rays.valid.all() or rays.directions[0, 2] < np.cos(np.radians(5)):
        return None
    angles = np.degrees(np.arccos(np.clip(rays.directions[1:, 2], -1, 1)))
    return float(angles.sum())
