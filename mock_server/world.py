"""What the commands act on: cameras, objects and their mask colours, in Unreal's frame.

Unreal: left-handed, centimetres, X forward, Y right, Z up.
"""

from __future__ import annotations

import itertools
import math
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mock_server.player import Player
from mock_server.render import ViewHits, render_view
from mock_server.rotator import MIRROR, Triple, axes, camera_to_world
from mock_server.scene import Scene

Color = tuple[int, int, int]

_KEPT_VIEWS = 8
_MOST_PIXELS = 1 << 24
_START_CM: Triple = (0.0, 0.0, 150.0)


@dataclass
class Camera:
    """A capture camera: location in cm, rotator (pitch, yaw, roll) in degrees, field of view, size, and the
    actor that carries it, if it was spawned."""

    name: str
    location: Triple
    rotation: Triple = (0.0, 0.0, 0.0)
    fov: float = 90.0
    size: tuple[int, int] = (640, 480)
    actor: str = ""

    def can_see(self) -> bool:
        """Whether a capture has pixels: not of size 0, beyond memory, or of an impossible field of view."""
        return 0 < self.size[0] * self.size[1] <= _MOST_PIXELS and 0 < self.fov < 180


@dataclass
class SceneObject:
    """An object's state. The pivot is the middle of its box; turns and moves are about it."""

    name: str
    color: Color
    pivot: Triple
    location: Triple
    rotation: Triple = (0.0, 0.0, 0.0)
    hidden: bool = False


class World:
    """A scene in play: a player, cameras (the first is the player's), and objects by name.

    Args:
        scene: what is there at the start.
        size: width and height of new cameras, px.
        fov_deg: their horizontal field of view.
    """

    def __init__(self, scene: Scene, size: tuple[int, int] = (640, 480), fov_deg: float = 90.0) -> None:
        self.scene, self._size, self._fov_deg = scene, size, fov_deg
        self.player = Player(_START_CM)
        self._spawned = 0
        self.cameras = [Camera("PawnSensor", _START_CM, fov=fov_deg, size=size)]
        self.viewmode = "lit"
        self.paused = False
        colors = palette()
        self._actors = [self._actor(name, next(colors)) for name in self.scene.objects]
        self.objects = {actor.name: actor for actor in self._actors}
        self._views: OrderedDict[object, ViewHits] = OrderedDict()

    def _actor(self, name: str, color: Color) -> SceneObject:
        middle = self._box_cm(self.scene, name).mean(axis=0)
        at = (float(middle[0]), float(middle[1]), float(middle[2]))
        return SceneObject(name, color, at, at)

    def spawn(self) -> str:
        """A new camera; its actor's name."""
        here, actor = self.cameras[0].location, f"FusionCameraActor_{self._spawned}"
        self.cameras.append(
            Camera("FusionCameraSensor", here, fov=self._fov_deg, size=self._size, actor=actor)
        )
        self._spawned += 1
        return actor

    def destroy_camera(self, actor: str) -> bool:
        """Takes a spawned camera out of the world; whether there was one of that name."""
        found = [camera for camera in self.cameras if actor and camera.actor == actor]
        for camera in found:
            self.cameras.remove(camera)
        return bool(found)

    def rename(self, actor: SceneObject, name: str) -> None:
        """Gives an object another name, in the same place of the list."""
        self.objects = {name if each is actor else each.name: each for each in self.objects.values()}
        actor.name = name

    def destroy(self, actor: SceneObject) -> None:
        """Takes an object out of the world."""
        actor.hidden = True
        del self.objects[actor.name]

    def bounds(self, actor: SceneObject) -> NDArray[np.float64]:
        """(2, 3) least and greatest corner of an object's box, cm, Unreal's axes."""
        return self._box_cm(self.placed(), self.scene.objects[self._actors.index(actor)])

    def look(self, camera: Camera) -> ViewHits:
        """What a camera sees, in every mode: traced once, kept while it is asked for in other modes."""
        names = self.scene.objects
        hidden = frozenset(n for n, actor in zip(names, self._actors, strict=True) if actor.hidden)
        key = (camera.location, camera.rotation, camera.fov, camera.size, hidden, self._places())
        if key not in self._views:
            t_w_c = MIRROR @ camera.location / 100.0
            fov_deg = horizontal_fov(camera)
            R_w_c = camera_to_world(camera.rotation)
            self._views[key] = render_view(self.placed(), R_w_c, t_w_c, fov_deg, *camera.size, hidden)
        self._views.move_to_end(key)
        while len(self._views) > 1 and not self._fit():
            self._views.popitem(last=False)
        return self._views[key]

    def hear(self, text: str) -> None:
        """A command came, and is about to be answered."""

    def lit(self, view: ViewHits) -> NDArray[np.uint8]:
        """(H, W, 3) the picture in colour."""
        return view.color

    def mask(self, view: ViewHits) -> NDArray[np.uint8]:
        """(H, W, 3) each object's colour; black where there is none."""
        colors = [(0, 0, 0), *(actor.color for actor in self._actors)]
        return np.array(colors, dtype=np.uint8)[view.label]

    def _fit(self) -> bool:
        """Whether the views that are kept are few enough, and small enough for memory."""
        pixels = sum(view.label.size for view in self._views.values())
        return len(self._views) <= _KEPT_VIEWS and pixels <= _MOST_PIXELS

    def _places(self) -> tuple[tuple[Triple, Triple], ...]:
        return tuple((actor.location, actor.rotation) for actor in self._actors)

    def placed(self) -> Scene:
        """The scene with its objects where commands have put them."""
        moves = {}
        for name, actor in zip(self.scene.objects, self._actors, strict=True):
            if actor.location != actor.pivot or actor.rotation != (0.0, 0.0, 0.0):
                R = MIRROR @ axes(actor.rotation) @ MIRROR
                pivot, place = (MIRROR @ at / 100.0 for at in (actor.pivot, actor.location))
                moves[name] = (R, pivot, place)
        return self.scene.moved(moves) if moves else self.scene

    @staticmethod
    def _box_cm(scene: Scene, name: str) -> NDArray[np.float64]:
        return np.sort(100.0 * np.array(scene.bounds(name)) @ MIRROR, axis=0)


def horizontal_fov(camera: Camera) -> float:
    """The field of view across: the engine applies it to the longer side."""
    width, height = camera.size
    if width >= height:
        return camera.fov
    return math.degrees(2 * math.atan(math.tan(math.radians(camera.fov) / 2) * width / height))


_CHANNEL = (0, 255, 127, 63, 191, 31, 95, 159, 223, 15, 47, 79, 111, 143, 175, 207,
            239, 7, 23, 39, 55, 71, 87, 103, 119, 135, 151, 167, 183, 199, 215, 231)  # fmt: skip
_FIXED = ((False, False, True), (False, True, False), (False, True, True), (True, False, False),
          (True, False, True), (True, True, False), (True, True, True))  # fmt: skip


def palette() -> Iterator[Color]:
    """The plugin's default mask colours, in order (protocol reference, section 5.1)."""
    for m, value in enumerate(_CHANNEL):
        for fixed in _FIXED:
            choices = [(value,) if is_fixed else _CHANNEL[:m] for is_fixed in fixed]
            yield from itertools.product(*choices)
