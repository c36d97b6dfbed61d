"""The closed Dev build, as far as it is documented: each command may be missing from a real one.

Its panoramas are documented by neither angles nor depth, so the setting ``panorama`` chooses a convention:
``fork`` is that of a public fork, ``centred`` differs from it in everything.
"""

import json
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from mock_server import pixels
from mock_server.dialects.common import Reply, Row, with_target
from mock_server.dialects.v1_1 import Plugin11
from mock_server.objects import MIRROR, SceneObject, axes
from mock_server.world import Camera

_MOST_PIXELS = 1 << 22


class PluginDev(Plugin11):
    """The commands of plugin 1.1.0, with stable ids of cameras, and some of its own."""

    version = "2.0.0"

    def rows(self) -> list[Row]:
        rows = [
            (template.replace("/camera/[uint]", "/camera/[camera_id]"), *rest)
            for template, *rest in super().rows()
        ]
        camera, cam, intensity = self.with_camera, "vget /camera/[camera_id]", "/light/directional/intensity"
        own: list[Row] = [
            ("vget /unrealcv/list_cmd", "Templates of all commands", self._list),
            ("vget /cameras/ids", "Index and stable id of each camera", self._ids),
            ("vset /world/pause_all_except_pawn", "Pauses all but the pawn", lambda: self._freeze(True)),
            ("vset /world/resume_all", "Goes on", lambda: self._freeze(False)),
            ("vset /annotation/object/[str]", "Annotates it", self.with_object(_annotate)),
            (f"vget {intensity}", "Intensity of the sun", lambda: "3.14"),
            (f"vset {intensity} [float]", "Sets it", "Set DirectionalLight intensity to {:.2f}".format),
            (f"{cam}/panoramic [str] [uint] [uint]", "A panorama", camera(self._panorama)),
        ]
        if self.settings.shared_memory == "serving":
            depth = camera(self._panoramic_depth)
            own.append((f"{cam}/panoramic/depth_shared [uint] [uint]", "Its depth", depth))
        return [*rows, *own]  # type: ignore[list-item]

    def with_camera(self, act: Callable[..., Reply], missing: str | None = None) -> Callable[..., Reply]:
        """As for other dialects; a camera has a number and a stable id."""
        return with_target(self._cameras, act, missing or self.no_camera)

    def _cameras(self) -> Mapping[str, Camera]:
        numbers = {str(number): camera for number, camera in enumerate(self.world.cameras)}
        return numbers | {_stable_id(camera): camera for camera in self.world.cameras}

    def _ids(self) -> str:
        return json.dumps([{"index": i, "id": _stable_id(c)} for i, c in enumerate(self.world.cameras)])

    def _freeze(self, paused: bool) -> str:
        self.world.paused = paused
        return "World paused except pawn" if paused else "World resumed"

    def _panorama(self, camera: Camera, form: str, width: int, height: int) -> Reply:
        if form != "bmp" or not 0 < width * height <= _MOST_PIXELS:
            return f"error Invalid filename type, filename {form}"
        hits = self._trace(camera, width, height)[0]
        lit = np.round(255 * np.clip(hits.color, 0, 1)).astype(np.uint8)
        data = pixels.bmp(lit)
        return data[:54] + data[58:]

    def _panoramic_depth(self, camera: Camera, width: int, height: int) -> Reply:
        if not 0 < width * height <= _MOST_PIXELS:
            return f"error Invalid size {width} x {height}"
        hits, rays = self._trace(camera, width, height)
        depth = hits.distance
        if self.settings.panorama == "fork":  # planar in the faces of a cube, cm
            depth = 100 * depth * np.abs(rays).max(axis=-1)
        depth = np.minimum(depth, pixels.LARGEST_HALF).astype(np.float32)
        return self.region(camera, "panoramic_depth", depth)

    def _trace(self, camera: Camera, width: int, height: int) -> tuple[Any, Any]:
        """Return hits (height, width), and rays in the frame of the faces."""
        fork = self.settings.panorama == "fork"
        x, y = np.meshgrid(np.arange(float(width)), np.arange(float(height)))
        if not fork:
            x, y = x + 0.5, y + 0.5
        yaw, pitch = 2 * np.pi * x / width - (0 if fork else np.pi), np.pi * (0.5 - y / height)
        if not fork:
            yaw = -yaw
        own = np.stack([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)], axis=-1)
        turn = np.eye(3) if fork else axes((0.0, camera.rotation[1], 0.0))
        rays = own @ turn.T @ MIRROR
        return self.world.placed().trace(MIRROR @ camera.location / 100.0, rays), own


def _annotate(actor: SceneObject) -> None:
    actor.annotated = True


def _stable_id(camera: Camera) -> str:
    return f"CID-{camera.actor or camera.name}-00"
