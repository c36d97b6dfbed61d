"""What can be derived of an image while its dataset is made, by name: boxes, layout, ..."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv import plugins
from omniscv.arguments import shown
from omniscv.compose.image import OmniImage
from omniscv.compose.renderer import Renderer
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.scene_geometry import SceneGeometry
from omniscv.truth.classes import ClassTable


@dataclass(frozen=True, eq=False)
class Observation:
    """One image in memory, and what is known of its scene.

    Attributes:
        key: start of its file names.
        image: with the camera, the pose, the layers.
        labels: (H, W) uint16 instance ids of the dataset; None without.
        instances: object name to instance id.
        classes: of the dataset; None without.
        geometry: what the source knows of shapes.
        renderer: of the source, to capture more; None offline.
        object_poses: by name, of objects whose poses are known.
        time: seconds; None where poses have none.
    """

    key: str
    image: OmniImage
    labels: NDArray[np.uint16] | None
    instances: Mapping[str, int]
    classes: ClassTable | None
    geometry: SceneGeometry
    renderer: Renderer | None = None
    object_poses: Mapping[str, Pose] = field(default_factory=dict)
    time: float | None = None

    def seen(self) -> NDArray[np.uint16]:
        """Return the labels.

        Raises:
            ArgumentError: there are none.
        """
        if self.labels is None:
            raise ArgumentError("expected an image with labels, got none; render with object_mask")
        return self.labels


@dataclass(frozen=True)
class Truth:
    """A truth that a job's ``truth:`` may name.

    Attributes:
        name: the key under ``truth:``, and of the record in the file.
        derive: from an observation and the options under that key to a record of plain JSON values.
        needs: the modalities that the image must have.
        file: the suffix of the file that holds the record; several may share ``truth.json``, each under its
            name; in a file of its own a record is the whole file.
        keys: those of a job that it takes among its options: ``tolerance``, ``seam``, ``layout``.
        captures: whether it uses the renderer, and so must not run beside the next image; or a function of
            what the source knows of shapes, and of the options, that returns that.
        check_options: raises ArgumentError for a wrong option, before anything is captured.
    """

    name: str
    derive: Callable[[Observation, Mapping[str, Any]], Mapping[str, Any] | list[Any]]
    needs: tuple[str, ...] = ()
    file: str = "truth.json"
    keys: tuple[str, ...] = ()
    captures: bool | Callable[[SceneGeometry, Mapping[str, Any]], bool] = False
    check_options: Callable[[Mapping[str, Any]], object] | None = None

    def may_capture(self, geometry: SceneGeometry, options: Mapping[str, Any]) -> bool:
        """Return whether it may use the renderer, given what the source knows of shapes."""
        return self.captures(geometry, options) if callable(self.captures) else self.captures


def no_options(options: Mapping[str, Any]) -> None:
    """Raise ArgumentError if there is an option."""
    if options:
        raise ArgumentError(f"expected no options, got {shown(dict(options))}")


_MODULES: dict[str, str] = {
    "poses": "poses",
    "layout": "layout",
    "boxes": "boxes",
    "bfov": "bfov",
    "boxes3d": "boxes3d",
    "amodal": "amodal",
}
"""The truths of this package, and the modules of :mod:`omniscv.dataset.deriving` that register them."""

_TRUTHS: dict[str, Truth] = {}


def register(truth: Truth) -> None:
    """Add a truth, or replace the one of its name."""
    _TRUTHS[truth.name] = truth


def names() -> tuple[str, ...]:
    """Return the names of all truths."""
    plugins.load()
    return tuple(dict.fromkeys((*_MODULES, *_TRUTHS)))


def get(name: str) -> Truth:
    """Return a truth by its name.

    Raises:
        ArgumentError: no truth has that name.
    """
    if name not in names():
        raise ArgumentError(f"truth: expected some of {', '.join(names())}; got {name!r}")
    if name not in _TRUTHS:
        import_module(f"omniscv.dataset.deriving.{_MODULES[name]}")
    return _TRUTHS[name]
