"""The source: captures of a scene that Blender renders."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path
from types import MappingProxyType
from typing import Any, NoReturn

import numpy as np

from omniscv.errors import ArgumentError, SourceError
from omniscv.geometry.scene_geometry import ObjectBox, SceneGeometry
from omniscv.sources.base import (
    Capabilities,
    Capture,
    ObjectTable,
    Request,
    SceneIdentity,
    Source,
    View,
    closed_error,
    known_objects,
    not_picklable,
)
from omniscv.sources.blender.pictures import Pixels, read_colors, read_data
from omniscv.sources.blender.server import Blender
from omniscv.sources.blender.settings import Settings

_DATA = ("object_mask", "depth", "normals")
"""Modalities that one render of a view gives together."""
_AHEAD = 24  # requests that are read ahead, to render a view once for all its data
_LEAST_PX, _MOST_PX = 4, 65_536  # of a side, as Blender has it
CAPABILITIES = Capabilities(frozenset(("lit", *_DATA)), min_size=_LEAST_PX, dialect="blender")
_TO_BLENDER = np.diag([1.0, -1.0, -1.0])
"""From the axes of Blender's cameras (x right, y up, z back) to ours (x right, y down, z forward)."""


class BlenderSource(Source):
    """Captures of one scene. Threads take turns, one picture at a time.

    Data (ids, depth, normals) have one sample at the centre of each pixel; colours have as many as the
    settings say, and a fixed seed: the same request gives the same pixels.

    Args:
        blender: with the scene; closed with this source.
        settings: with which it was opened.
    """

    def __init__(self, blender: Blender, settings: Settings) -> None:
        self._blender, self._settings = blender, settings
        self._lock, self._closed, self._process = threading.RLock(), False, os.getpid()
        self._objects = ObjectTable({}, ids=blender.scene["objects"])
        shown = f"{blender.scene['scene']}, frame {blender.scene['frame']}"
        self._identity = SceneIdentity(Path(settings.path).stem, shown, blender.digest)

    @property
    def capabilities(self) -> Capabilities:
        return CAPABILITIES

    @property
    def scene_identity(self) -> SceneIdentity:
        """The file's name, the scene in it and its frame, a digest of the file and of Blender's version."""
        return self._identity

    @property
    def blender(self) -> Blender:
        """What renders, and what it knows of the scene."""
        return self._blender

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        """As :meth:`Source.capture`; ArgumentError for a modality or size that Blender does not render."""
        return self.captured(requests, frozenset())

    def captured(self, requests: Iterable[Request], hidden: frozenset[str]) -> Iterator[Capture]:
        """As :meth:`capture`, without some of the objects."""
        coming = iter(requests)
        while batch := list(islice(coming, _AHEAD)):
            for request in batch:
                request.check_state(self.state, self._blender.name)
                _check(request)
            kept: dict[Request, Any] = {}
            for number, request in enumerate(batch):
                if request not in kept:
                    pixels = self._rendered(request, hidden)
                    later = (each for each in batch[number:] if each.view == request.view)
                    kept.update({each: pixels[each.mode] for each in later if each.mode in pixels})
                picture = kept[request] if request in batch[number + 1 :] else kept.pop(request)
                yield Capture(request, request.view, picture, self._provenance(request))

    def objects(self) -> ObjectTable:
        self._check_open()
        return self._objects

    def geometry(self) -> SceneGeometry:
        """The boxes of all objects that have a shape, around their vertices and in their own axes."""
        with self._lock:
            self._check_open()
            boxes = self._blender.ask("measure its objects", {"do": "boxes"}, lambda reply, _: reply["boxes"])
        found = {
            name: ObjectBox.of(np.array(center), np.array(axes), np.array(size), "vertices")
            for name, (center, axes, size) in sorted(boxes.items())
        }
        return SceneGeometry(MappingProxyType(found))

    def without(self, objects: Iterable[str]) -> Source:
        """As :meth:`Source.without`; both may be used at the same time."""
        self._check_open()
        hidden = frozenset(objects)
        known_objects(hidden, self._objects.ids, self._blender.name)
        return WithoutObjects(self, hidden)

    def close(self) -> None:
        if self._process != os.getpid():
            return  # a fork's: Blender belongs to the process that started it
        with self._lock:
            self._closed = True
            self._blender.close()

    def __reduce__(self) -> NoReturn:
        raise not_picklable(self._blender.name)

    def _rendered(self, request: Request, hidden: frozenset[str]) -> Pixels:
        """Render a view, and return its pixels, read-only, by the modalities that come together."""
        view, is_lit = request.view, request.mode == "lit"
        is_png = is_lit and self._settings.lit == "uint8"
        file = f"picture.{'png' if is_png else 'exr'}"

        def read(reply: dict[str, Any], folder: Path) -> Pixels:
            path = folder / file
            pixels = read_colors(path, view) if is_lit else read_data(path, view, reply["metres"])
            path.unlink()
            return pixels

        message = {
            "do": "render",
            "kind": "lit" if is_lit else "data",
            "file": file,
            "hidden": sorted(hidden),
            "R_w_b": (view.pose.rotation @ _TO_BLENDER).tolist(),
            "position": view.pose.position.tolist(),
            "tan_half_fov": float(np.tan(np.radians(view.fov_deg) / 2)),
            "size": [view.width, view.height],
        }
        with self._lock:
            self._check_open()
            pixels = self._blender.ask(f"render {view.width} x {view.height} px", message, read)
        for each in pixels.values():
            each.flags.writeable = False
        return pixels

    def _provenance(self, request: Request) -> dict[str, Any]:
        settings = self._settings
        look = {"samples": settings.samples, "seed": settings.seed, "denoiser": settings.denoiser}
        server = f"Blender {self._blender.version}"
        scene = {"server": server, "scene": self._identity.name, "dialect": CAPABILITIES.dialect}
        return {**scene, **look} if request.mode == "lit" else scene

    def _check_open(self) -> None:
        if self._closed:
            raise closed_error(self._blender.name)
        if self._process != os.getpid():
            wanted = "expected to be used by the process that opened it, got a fork of that process"
            raise SourceError(f"{self._blender.name}: {wanted}; open it again there")


class WithoutObjects(Source):
    """A scene some of whose objects are hidden; closing it leaves the scene open."""

    def __init__(self, source: BlenderSource, hidden: frozenset[str]) -> None:
        self._source, self._hidden, self._closed = source, hidden, False

    @property
    def capabilities(self) -> Capabilities:
        return self._source.capabilities

    @property
    def scene_identity(self) -> SceneIdentity:
        return self._source.scene_identity

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        self._check_open()
        return self._source.captured(requests, self._hidden)

    def objects(self) -> ObjectTable:
        self._check_open()
        return self._source.objects()

    def geometry(self) -> SceneGeometry:
        self._check_open()
        return self._source.geometry()

    def without(self, objects: Iterable[str]) -> Source:
        self._check_open()
        return self._source.without(self._hidden.union(objects))

    def close(self) -> None:
        self._closed = True

    def _check_open(self) -> None:
        if self._closed:
            raise closed_error("scene without objects")


def _check(request: Request) -> None:
    """Raise ArgumentError for what Blender does not render."""
    if request.mode not in CAPABILITIES.modes:
        known = ", ".join(sorted(CAPABILITIES.modes))
        raise ArgumentError(f"mode: expected one of {known} of Blender, got {request.mode!r}")
    view: View = request.view
    if not _LEAST_PX <= min(view.width, view.height) <= max(view.width, view.height) <= _MOST_PX:
        wanted = f"expected sides of {_LEAST_PX} to {_MOST_PX} px"
        raise ArgumentError(f"size: {wanted}, got {view.width} x {view.height}")
