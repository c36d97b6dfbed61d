"""``scene://NAME-or-PATH``: a scene of the mock server, traced in this process, without server and wire."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from omniscv.errors import ArgumentError
from omniscv.sources.base import (
    Capabilities,
    Capture,
    ObjectTable,
    Request,
    SceneIdentity,
    Source,
    View,
    closed_error,
)
from omniscv.sources.registry import split_address

if TYPE_CHECKING:
    from mock_server import Scene

Lit = Literal["uint8", "float32"]
Masks = Literal["colors", "ids"]

_CAPABILITIES = Capabilities(frozenset(("lit", "object_mask", "depth", "normals")), dialect="scene")


class SceneSource(Source):
    """Captures by exact tracing. A view is traced once for all modes.

    Args:
        scene: what to trace.
        capabilities: what the source declares; all that it can do if not given.
        lit: dtype of colours: uint8, or float32 0..1.
        masks: object masks as colours, or as uint16 instance ids, which are the labels.
        cached_views: how many views are kept, those used last, of 22 to 31 bytes a pixel.

    Attributes:
        made: how many views were traced.

    Raises:
        ArgumentError: another ``lit`` or ``masks``.
    """

    def __init__(
        self,
        scene: Scene,
        capabilities: Capabilities | None = None,
        lit: Lit = "uint8",
        masks: Masks = "colors",
        cached_views: int = 32,
    ) -> None:
        for name, value, kind in (("lit", lit, Lit), ("masks", masks, Masks)):
            if value not in get_args(kind):
                raise ArgumentError(f"{name}: expected one of {', '.join(get_args(kind))}; got {value!r}")
        self.scene, self.made = scene, 0
        self._capabilities, self._lit, self._closed = capabilities or _CAPABILITIES, lit, False
        self._identity = SceneIdentity(scene.name, content=scene.digest())
        ids = {name: scene.label(name) for name in scene.objects}
        colors = ObjectTable({}, ids=ids).colors
        self._objects = ObjectTable(colors, ids=ids if masks == "ids" else {})
        palette = np.array([(0, 0, 0), *(colors[name] for name in scene.objects)], np.uint8)
        self._shown = np.arange(len(palette), dtype=np.uint16) if masks == "ids" else palette
        self._traced = lru_cache(cached_views)(self._trace)
        self._made_of = scene, capabilities, lit, masks, cached_views

    @property
    def capabilities(self) -> Capabilities:
        return self._capabilities

    @property
    def scene_identity(self) -> SceneIdentity:
        return self._identity

    def objects(self) -> ObjectTable:
        self._check_open()
        return self._objects

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        """As :meth:`Source.capture`; ArgumentError for a modality that scenes do not have."""
        provenance = {"server": "in-process", "scene": self.scene.name, "dialect": "scene"}
        for request in requests:
            self._check_open()
            if request.mode not in _CAPABILITIES.modes:
                known = ", ".join(sorted(_CAPABILITIES.modes))
                raise ArgumentError(f"mode: expected one of {known} of a scene, got {request.mode!r}")
            yield Capture(request, request.view, self._traced(request.view)[request.mode], provenance)

    def close(self) -> None:
        self._closed = True
        self._traced.cache_clear()

    def __reduce__(self) -> tuple[Any, ...]:
        return SceneSource, self._made_of

    def _check_open(self) -> None:
        if self._closed:
            raise closed_error(f"scene {self.scene.name}")

    def _trace(self, view: View) -> dict[str, NDArray[Any]]:
        from mock_server.render import pinhole_rays

        rays, lengths = pinhole_rays(view.pose.R_w_c, view.fov_deg, view.width, view.height)
        hits = self.scene.trace(view.pose.position, rays)
        self.made += 1
        lit = hits.color if self._lit == "float32" else np.round(255 * np.clip(hits.color, 0, 1))
        pixels: dict[str, NDArray[Any]] = {
            "lit": lit.astype(self._lit),
            "object_mask": self._shown[hits.label],
            "depth": (hits.distance / lengths).astype(np.float32),
            "normals": hits.normal.astype(np.float32),
        }
        for array in pixels.values():
            array.flags.writeable = False
        return pixels


def open_scene(address: str) -> SceneSource:
    """Open ``scene://NAME-or-PATH?lit=float32&masks=ids``; both options may be left out."""
    import mock_server

    name, options = split_address(address, {"lit": str, "masks": str})
    try:
        return SceneSource(mock_server.load_scene(name), **options)
    except ValueError as wrong:
        raise ArgumentError(f"source: {address!r}: {wrong}") from wrong


open_scene.capabilities = lambda address: _CAPABILITIES  # type: ignore[attr-defined]  # for the registry
