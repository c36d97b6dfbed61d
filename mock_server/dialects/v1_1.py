"""Plugin 1.1.0, dialect N3: it lists its commands, and has cine cameras and shared memory on Windows.

The closed Dev build adds to it, as far as it is documented: each command may be missing from a real one. Its
panoramas are documented by neither angles nor depth, so the setting ``panorama`` chooses a convention:
``fork`` is that of a public fork, ``centred`` differs from it in everything.
"""

import json
import os
from collections import Counter
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import cv2
import numpy as np

from mock_server import cine as cine_model
from mock_server import pixels
from mock_server.dialects.common import THREE, OutputFolder, Reply, Row, sets, with_target
from mock_server.dialects.v1 import BAD_ARGUMENT, MODES, Branch52
from mock_server.objects import MIRROR, SceneObject, axes
from mock_server.settings import Settings
from mock_server.world import Camera, World

_SHARED = {mode: mode for mode in MODES} | {"seg": "object_mask"}
"""What regions show, by the word of the command; both words for masks share one."""
_NO_WINDOWS = "error Windows shared memory transport is only available on Windows"
_LIFETIME = "until the game exits; the next capture of this camera and modality overwrites it"

_BONES = (" [str]", " [str] [str]")
_MOST_PIXELS = 1 << 22


class Plugin11(Branch52):
    """Plugin 1.1.0: the commands of branch 5.2, and those that the reference calls new since N2."""

    version = "1.1.0"

    def __init__(self, world: World, settings: Settings, port: int, files: OutputFolder) -> None:
        self.regions: dict[str, bytearray] = {}
        self._versions: Counter[str] = Counter()
        self._captures: Counter[str] = Counter()
        super().__init__(world, settings, port, files)

    def rows(self) -> list[Row]:
        camera, cam = self.with_camera, "/camera/[uint]"
        strict, bones = partial(camera, missing=BAD_ARGUMENT), self.with_object(_bones)
        cine = f"{cam}/cine"
        spawn, cube = "vset /objects/spawn", partial(self._spawn, "CubeActor")
        rows: list[Row] = [
            *super().rows()[1:],
            ("vrun [str]", "Runs a console command", self.console),
            ("vget /unrealcv/commands", "Templates of all commands, one a line", self._list),
            (f"vset {cam}/fov [float]", "Sets it, within 1 to 179", strict(_set_fov)),
            (f"{spawn} [str] {THREE}", "Adds an object at a place", lambda c, *at: self._spawn(c, "", at)),
            (f"{spawn} [str] [str] {THREE}", "With a name", lambda c, n, *at: self._spawn(c, n, at)),
            (f"{spawn}_cube {THREE}", "Adds a cube at a place", lambda *at: cube("", at)),
            (f"{spawn}_cube [str] {THREE}", "With a name", lambda name, *at: cube(name, at)),
            *((f"vget /object/[str]/bones{words}", "Poses of bones", bones) for words in ("", *_BONES)),
            *self.console_rows("vreflect", 2, 12, self.run_function),
            (f"vget {cine}", "The cine camera", strict(lambda c: c.cine.model(*c.size))),
            (f"vget {cine}/enabled", "Whether it is on", strict(lambda c: str(int(c.cine.enabled)))),
            (f"vget {cine}/intrinsics", "Its projection", strict(lambda c: c.cine.intrinsics(*c.size))),
            (f"vset {cine}/enabled [uint]", "On", strict(lambda c, on: setattr(c.cine, "enabled", on > 0))),
            *(
                (f"vset {cine}/{form}", "Switches it on", strict(lambda c, *v, n=name: c.cine.set(n, *v)))
                for name, form in cine_model.TEMPLATES.items()
            ),
        ]
        if self.settings.shared_memory != "unlisted":
            for word, mode in _SHARED.items():
                share = camera(partial(self._share, mode))
                rows.append((f"vget {cam}/{word}_shared", f"{word} in shared memory", share))
        return rows

    def _list(self) -> str:
        return "\n".join(sorted({command.template for command in self.commands}))

    def _share(self, mode: str, camera: Camera) -> Reply:
        """Capture into a region, which is replaced by a larger one where the image does not fit."""
        if self.settings.shared_memory == "refusing":
            return _NO_WINDOWS
        if not camera.has_pixels():
            width, height = camera.size
            return f"error Invalid {mode} dimensions or data size: {width}x{height}, samples=0"
        view = self.world.capture(camera, mode=mode)
        if mode == "depth":
            depth = 100 * self.world.depth(view, along_ray=False)
            image: np.ndarray = pixels.stored(depth, self.settings.depth == "half")
        else:
            image = cv2.cvtColor(self.world.image(view, mode, camera), cv2.COLOR_RGB2BGRA)
        return self.region(camera, mode, image)

    def region(self, camera: Camera, mode: str, image: np.ndarray) -> str:
        """Write an image into a camera's region for a mode, and return the reply that describes it."""
        data, number = image.tobytes(), next(i for i, c in enumerate(self.world.cameras) if c is camera)
        tail = f"{mode}_float32" if image.ndim == 2 else f"{mode}_bgra8"
        stem = f"UnrealCV_{os.getpid()}_camera_{number}_{tail}"
        if len(self.regions.get(f"{stem}_v{self._versions[stem]}", b"")) < len(data):
            self.regions.pop(f"{stem}_v{self._versions[stem]}", None)
            self._versions[stem] += 1
            self.regions[f"{stem}_v{self._versions[stem]}"] = bytearray(len(data))
        name = f"{stem}_v{self._versions[stem]}"
        self.regions[name][: len(data)] = data
        self._captures[mode] += 1
        order = {} if image.ndim == 2 else {"channel_order": "BGRA"}
        return json.dumps({
            "transport": "windows_shared_memory", "modality": mode, "name": name, "num_bytes": len(data),
            "version": self._versions[stem], "offset_bytes": 0, "shape": image.shape,
            "dtype": image.dtype.name, "layout": "HWC" if order else "HW", **order,
            "width": image.shape[1], "height": image.shape[0],
            "frame": self._captures[mode], "lifetime": _LIFETIME,
        }, indent="\t")  # fmt: skip


def _bones(_: SceneObject, names: str = "", space: str = "component") -> Reply:
    if space not in ("component", "world"):
        return "error Bone space must be component or world"
    return "error No skeletal or poseable mesh component found"


def _set_fov(camera: Camera, fov: float) -> None:
    camera.fov = min(max(fov, 1.0), 179.0)


class PluginDev(Plugin11):
    """The commands of plugin 1.1.0, with stable ids of cameras, and some of its own."""

    version = "2.0.0"

    def rows(self) -> list[Row]:
        rows = [
            (template.replace("/camera/[uint]", "/camera/[camera_id]"), *rest)
            for template, *rest in super().rows()
        ]
        camera, cam, intensity = self.with_camera, "/camera/[camera_id]", "/light/directional/intensity"
        own: list[Row] = [
            ("vget /unrealcv/list_cmd", "Templates of all commands", self._list),
            ("vget /cameras/ids", "Index and stable id of each camera", self._ids),
            ("vset /world/pause_all_except_pawn", "Pauses all but the pawn", lambda: self._freeze(True)),
            ("vset /world/resume_all", "Goes on", lambda: self._freeze(False)),
            ("vset /annotation/object/[str]", "Annotates it", self.with_object(sets("annotated", True))),
            ("vset /annotation/world", "Annotates all objects", lambda: self._annotate(True)),
            ("vset /annotation/world/clear", "Annotates none", lambda: self._annotate(False)),
            (f"vget {cam}/use_fast_capture", "Whether files come late", camera(lambda c: f"{c.is_fast:d}")),
            (f"vset {cam}/use_fast_capture [uint]", "Sets it", camera(sets("is_fast"))),
            (f"vget {intensity}", "Intensity of the sun", lambda: "3.14"),
            (f"vset {intensity} [float]", "Sets it", "Set DirectionalLight intensity to {:.2f}".format),
            (f"vget {cam}/panoramic [str] [uint] [uint]", "A panorama", camera(self._panorama)),
        ]
        if self.settings.shared_memory == "serving":
            depth = camera(self._panoramic_depth)
            own.append((f"vget {cam}/panoramic/depth_shared [uint] [uint]", "Its depth", depth))
        return [*rows, *own]  # type: ignore[list-item]

    def with_camera(self, act: Callable[..., Reply], missing: str | None = None) -> Callable[..., Reply]:
        """As for other dialects; a camera has a number and a stable id."""
        return with_target(self._cameras, act, missing or self.no_camera)

    def _cameras(self) -> Mapping[str, Camera]:
        numbers = {str(number): camera for number, camera in enumerate(self.world.cameras)}
        return numbers | {_stable_id(camera): camera for camera in self.world.cameras}

    def _ids(self) -> str:
        return json.dumps([{"index": i, "id": _stable_id(c)} for i, c in enumerate(self.world.cameras)])

    def _annotate(self, annotated: bool) -> None:
        for actor in self.world.objects.values():
            actor.annotated = annotated

    def _freeze(self, paused: bool) -> str:
        self.world.paused = paused
        return "World paused except pawn" if paused else "World resumed"

    def _panorama(self, camera: Camera, form: str, width: int, height: int) -> Reply:
        if form != "bmp" or not 0 < width * height <= _MOST_PIXELS:
            return f"error Invalid filename type, filename {form}"
        color = self._trace(camera, width, height)[0].color
        data = pixels.bmp(np.round(255 * np.clip(color, 0, 1)).astype(np.uint8))
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
        x, y = np.meshgrid(np.arange(width) + 0.5 * (not fork), np.arange(height) + 0.5 * (not fork))
        yaw, pitch = 2 * np.pi * (x / width if fork else 0.5 - x / width), np.pi * (0.5 - y / height)
        own = np.stack([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)], axis=-1)
        turn = np.eye(3) if fork else axes((0.0, camera.rotation[1], 0.0))
        rays = own @ turn.T @ MIRROR
        return self.world.placed().trace(camera.center_m(), rays), own


def _stable_id(camera: Camera) -> str:
    return f"CID-{camera.actor or camera.name}-00"
