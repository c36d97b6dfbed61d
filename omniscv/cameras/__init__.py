"""Camera models by name. To add one, see the recipe at the top of ``base.py``."""

from __future__ import annotations

from typing import Any

from omniscv.cameras.base import Camera, Rays, Viewpoints
from omniscv.cameras.fisheyes import (
    FisheyeEquidistant,
    FisheyeEquisolid,
    FisheyeOrthographic,
    FisheyeStereographic,
)
from omniscv.cameras.kannala_brandt import KannalaBrandt
from omniscv.cameras.mirrors import CatadioptricHyperbolic, CatadioptricParabolic, CatadioptricPlanar
from omniscv.cameras.noncentral_conical_mirror import NoncentralConicalMirror
from omniscv.cameras.noncentral_panorama import NoncentralPanorama
from omniscv.cameras.noncentral_spherical_mirror import NoncentralSphericalMirror
from omniscv.cameras.panoramas import Cylindrical, Equirectangular
from omniscv.cameras.pinhole import Pinhole
from omniscv.cameras.scaramuzza import Scaramuzza
from omniscv.errors import ArgumentError

__all__ = ["Camera", "Rays", "Viewpoints", "create", "from_dict", "model", "names"]

_MODELS: tuple[type[Camera], ...] = (
    Equirectangular,
    Cylindrical,
    FisheyeEquidistant,
    FisheyeStereographic,
    FisheyeOrthographic,
    FisheyeEquisolid,
    CatadioptricParabolic,
    CatadioptricHyperbolic,
    CatadioptricPlanar,
    Scaramuzza,
    KannalaBrandt,
    NoncentralPanorama,
    NoncentralSphericalMirror,
    NoncentralConicalMirror,
    Pinhole,
)
_BY_NAME = {cls.name: cls for cls in _MODELS}


def names() -> list[str]:
    """The names of all models, in the order of the documentation."""
    return list(_BY_NAME)


def model(name: str) -> type[Camera]:
    """The class of a model.

    Raises:
        ArgumentError: no model has that name.
    """
    if name not in _BY_NAME:
        raise ArgumentError(f"camera: expected one of {', '.join(names())}; got {name!r}")
    return _BY_NAME[name]


def create(name: str, **parameters: Any) -> Camera:
    """A camera by its model's name and constructor arguments.

    Raises:
        ArgumentError: an unknown name, or an argument that the model does not take or refuses.
    """
    cls = model(name)
    try:
        return cls(**parameters)
    except TypeError as cause:
        raise ArgumentError(
            f"camera {name}: {str(cause).replace(cls.__name__ + '.__init__()', 'it')}"
        ) from cause


def from_dict(data: dict[str, Any]) -> Camera:
    """The camera that ``camera.to_dict()`` described.

    Raises:
        ArgumentError: no ``model`` in it, or as :func:`create`.
    """
    if not isinstance(data, dict) or "model" not in data:
        raise ArgumentError(f"camera: expected a mapping with 'model' in it, got {data!r}")
    return create(data["model"], **{key: value for key, value in data.items() if key != "model"})
