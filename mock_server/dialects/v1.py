"""Dialect 1.x as plugin 1.0.1 speaks it (columns N1 of the protocol reference)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from mock_server import encode
from mock_server.protocol import command
from mock_server.world import Camera, SceneObject, World

Reply = str | bytes

VERSION = "1.0.1"
NO_SENSOR = "error Invalid sensor id"
BAD_ARGUMENT = "error Argument Invalid"
NO_OBJECT = "error Can not find object"
FARTHEST_CM = 65504.0
"""The largest half float: what the depth of the sky is."""

_VIEWMODES = frozenset(
    [
        "lit",
        "unlit",
        "depth",
        "normal",
        "object_mask",
        "base_color",
        "debug",
        "wireframe",
        "vertex_color",
        "no_transparency",
    ]
)


def unknown(text: str) -> str:
    """The reply to a command that no template fits."""
    return f"error Can not find a handler for URI '{text}'"


def three(values: tuple[float, float, float]) -> str:
    """Three numbers as ``%.3f``."""
    return "{:.3f} {:.3f} {:.3f}".format(*values)


class Commands:
    """The command set over a world.

    Args:
        world: what the commands act on.
        port: printed by the status.
        half_depth: whether depth goes through half floats, as in the engine.
    """

    def __init__(self, world: World, port: int, half_depth: bool) -> None:
        self.world, self.port, self.half_depth = world, port, half_depth
        self.commands = [command(template, text, handler) for template, text, handler in self._table()]

    def answer(self, text: str) -> Reply:
        """The reply to a command's text."""
        for each in reversed(self.commands):  # templates registered later win
            arguments = each.match(text)
            if arguments is not None:
                reply = each.handler(*arguments)
                return reply if reply else "ok"
        return unknown(text)

    def _table(self) -> list[tuple[str, str, Callable[..., Reply]]]:
        camera, obj = self._with_camera, self._with_object
        return [
            ("vrun [str]", "Run a console command", lambda *_: "ok"),
            ("vget /objects", "List the objects", lambda: "".join(n + " " for n in self.world.objects)),
            ("vget /object/[str]/location", "", obj(lambda o: three(o.location))),
            ("vget /object/[str]/rotation", "", obj(lambda o: three(o.rotation))),
            ("vget /object/[str]/color", "", obj(lambda o: "(R={},G={},B={},A=255)".format(*o.color))),
            ("vset /object/[str]/color [uint] [uint] [uint]", "", obj(self._paint)),
            ("vget /object/[str]/mobility", "", obj(lambda o: "Static")),
            ("vset /object/[str]/show", "", obj(lambda o: self._hide(o, False))),
            ("vset /object/[str]/hide", "", obj(lambda o: self._hide(o, True))),
            ("vget /object/[str]/uclass_name", "", obj(lambda o: "Actor")),
            ("vget /unrealcv/status", "Get the status", self._status),
            ("vget /unrealcv/help", "List all commands", self._help),
            ("vget /unrealcv/echo [str]", "Echo", lambda word: word),
            ("vget /unrealcv/version", "The plugin's version", lambda: VERSION),
            ("vget /scene/name", "", lambda: self.world.scene.name),
            ("vget /level/name", "", lambda: self.world.scene.name),
            ("vset /action/game/pause", "", lambda: self._pause(True)),
            ("vset /action/game/resume", "", lambda: self._pause(False)),
            ("vget /action/game/is_paused", "", lambda: "true" if self.world.paused else "false"),
            ("vset /action/input/enable", "", lambda: "ok"),
            ("vset /action/input/disable", "", lambda: "ok"),
            ("vset /action/eyes_distance [float]", "", lambda _: "error Not Implemented"),
            ("vget /cameras", "List the cameras", lambda: "".join(c.name + " " for c in self.world.cameras)),
            ("vset /cameras/spawn", "Spawn a camera", self.world.spawn),
            ("vget /camera/[uint]/location", "", camera(lambda c: three(c.location))),
            ("vset /camera/[uint]/location [float] [float] [float]", "", camera(self._move)),
            ("vget /camera/[uint]/rotation", "", camera(lambda c: three(c.rotation))),
            ("vset /camera/[uint]/rotation [float] [float] [float]", "", camera(self._turn)),
            ("vget /camera/[uint]/lit [str]", "", camera(lambda c, f: self._picture(c, "lit", f))),
            ("vget /camera/[uint]/depth [str]", "", camera(self._depth)),
            ("vget /camera/[uint]/normal [str]", "", camera(lambda c, f: self._picture(c, "normal", f))),
            ("vget /camera/[uint]/object_mask [str]", "", camera(self._mask)),
            ("vget /camera/[uint]/seg [str]", "", camera(self._mask)),
            ("vset /viewmode [str]", "", self._set_viewmode),
            ("vget /viewmode", "", lambda: self.world.viewmode),
            ("vget /camera/[uint]/fov", "", camera(lambda c: f"{c.fov:f}", BAD_ARGUMENT)),
            ("vset /camera/[uint]/fov [float]", "", camera(self._set_fov, BAD_ARGUMENT)),
            ("vget /camera/[uint]/size", "", camera(lambda c: "{} {}".format(*c.size), BAD_ARGUMENT)),
            ("vset /camera/[uint]/size [uint] [uint]", "", camera(self._set_size, BAD_ARGUMENT)),
        ]  # fmt: skip

    def _with_camera(self, act: Callable[..., Reply], missing: str = NO_SENSOR) -> Callable[..., Reply]:
        def handler(index: int, *arguments: Any) -> Reply:
            if index >= len(self.world.cameras):
                return missing
            return act(self.world.cameras[index], *arguments)

        return handler

    def _with_object(self, act: Callable[..., Reply]) -> Callable[..., Reply]:
        def handler(name: str, *arguments: Any) -> Reply:
            if name not in self.world.objects:
                return NO_OBJECT
            return act(self.world.objects[name], *arguments)

        return handler

    def _status(self) -> str:
        return (
            f"Is Listening\nClient Connected\n{self.port}\nConfiguration\nConfig file: /unrealcv.ini\n"
            f"Port: {self.port}\nWidth: 640\nHeight: 480\nFOV: 90.000000\nEnableInput: true\n"
            "EnableRightEye: false\n"
        )

    def _help(self) -> str:
        return "".join(f"{c.template}\n{c.description}\n" for c in self.commands)

    def _pause(self, paused: bool) -> str:
        self.world.paused = paused
        return "ok"

    def _set_viewmode(self, mode: str) -> str:
        if mode.lower() not in _VIEWMODES:
            return f"error Can not set ViewMode to {mode.lower()}"
        self.world.viewmode = mode.lower()
        return "ok"

    @staticmethod
    def _hide(o: SceneObject, hidden: bool) -> str:
        o.hidden = hidden
        return "ok"

    @staticmethod
    def _paint(o: SceneObject, r: int, g: int, b: int) -> str:
        o.color = (r % 256, g % 256, b % 256)
        return "ok"

    @staticmethod
    def _move(camera: Camera, x: float, y: float, z: float) -> str:
        camera.location = (x, y, z)
        return "ok"

    @staticmethod
    def _turn(camera: Camera, pitch: float, yaw: float, roll: float) -> str:
        camera.rotation = (pitch, yaw, roll)
        return "ok"

    @staticmethod
    def _set_fov(camera: Camera, fov: float) -> str:
        camera.fov = fov
        return "ok"

    @staticmethod
    def _set_size(camera: Camera, width: int, height: int) -> str:
        camera.size = (width, height)
        return "ok"

    def _mask(self, camera: Camera, form: str) -> Reply:
        return self._picture(camera, "object_mask", form)

    def _picture(self, camera: Camera, mode: str, form: str) -> Reply:
        encoder = {"png": encode.png, "bmp": encode.bmp}.get(form.lower())
        if encoder is None:
            return f"error Invalid filename type, filename {form}"
        if 0 in camera.size:
            return "error Captured data is empty"
        view = self.world.look(camera)
        if mode == "lit":
            return encoder(view.color)
        if mode == "object_mask":
            return encoder(self.world.mask(view))
        normal_ue = view.normal * (1, -1, 1)
        return encoder(np.round(255 * (0.5 + 0.5 * normal_ue)).astype(np.uint8))

    def _depth(self, camera: Camera, form: str) -> Reply:
        if form.lower() != "npy":
            return f"error Invalid filename type, filename {form}"
        if 0 in camera.size:
            return "error Captured data is empty"
        depth_cm = np.minimum(100 * self.world.look(camera).depth, FARTHEST_CM)
        if self.half_depth:
            depth_cm = depth_cm.astype(np.float16)
        return encode.npy(depth_cm.astype(np.float32))
