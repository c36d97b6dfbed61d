"""What the commands act on: cameras, objects and their mask colours, in Unreal's frame.

Unreal: left-handed, centimetres, X forward, Y right, Z up. The mirror into the scene's frame is made
here, from the axes of a rotator (protocol reference, section 4), and shared with nobody.
"""

from __future__ import annotations

import itertools
import math
import threading
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mock_server.render import ViewHits, render_view
from mock_server.scene import Scene

Triple = tuple[float, float, float]
Color = tuple[int, int, int]

_KEPT_VIEWS = 8
_START_CM: Triple = (0.0, 0.0, 150.0)


@dataclass
class Camera:
    """A capture camera: location in cm, rotator (pitch, yaw, roll) in degrees, field of view, size."""

    name: str
    location: Triple = _START_CM
    rotation: Triple = (0.0, 0.0, 0.0)
    fov: float = 90.0
    size: tuple[int, int] = (640, 480)

    def axes(self) -> NDArray[np.float64]:
        """(3, 3) camera (x right, y down, z forward) to the scene's world frame."""
        p, y, r = map(math.radians, self.rotation)
        sp, cp, sy, cy, sr, cr = math.sin(p), math.cos(p), math.sin(y), math.cos(y), math.sin(r), math.cos(r)
        forward = (cp * cy, cp * sy, sp)
        right = (sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, -sr * cp)
        up = (-(cr * sp * cy + sr * sy), cy * sr - cr * sp * sy, cr * cp)
        mirrored = np.array([right, up, forward]) * (1, -1, 1)
        return np.stack([mirrored[0], -mirrored[1], mirrored[2]], axis=1)


@dataclass
class SceneObject:
    """An object's state."""

    name: str
    color: Color
    hidden: bool = False
    location: Triple = (0.0, 0.0, 0.0)
    rotation: Triple = (0.0, 0.0, 0.0)


@dataclass
class World:
    """A scene in play."""

    scene: Scene
    cameras: list[Camera] = field(default_factory=lambda: [Camera("PawnSensor")])
    viewmode: str = "lit"
    paused: bool = False

    def __post_init__(self) -> None:
        colors = palette()
        self.objects = {name: SceneObject(name, next(colors)) for name in self.scene.objects}
        self._views: OrderedDict[object, ViewHits] = OrderedDict()
        self._lock = threading.Lock()

    def spawn(self) -> str:
        """A new camera; its actor's name."""
        self.cameras.append(Camera("FusionCameraSensor", self.cameras[0].location))
        return f"FusionCameraActor_{len(self.cameras) - 2}"

    def look(self, camera: Camera) -> ViewHits:
        """What a camera sees, in every mode: traced once, kept while it is asked for in other modes."""
        hidden = frozenset(o.name for o in self.objects.values() if o.hidden)
        key = (camera.location, camera.rotation, camera.fov, camera.size, hidden)
        with self._lock:
            if key in self._views:
                self._views.move_to_end(key)
                return self._views[key]
        x, y, z = camera.location
        t_w_c = np.array([x, -y, z]) / 100.0
        view = render_view(self.scene, camera.axes(), t_w_c, _horizontal_fov(camera), *camera.size, hidden)
        with self._lock:
            self._views[key] = view
            while len(self._views) > _KEPT_VIEWS:
                self._views.popitem(last=False)
        return view

    def mask(self, view: ViewHits) -> NDArray[np.uint8]:
        """(H, W, 3) each object's colour; black where there is none."""
        colors = [(0, 0, 0), *(self.objects[name].color for name in self.scene.objects)]
        return np.array(colors, dtype=np.uint8)[view.label]


def _horizontal_fov(camera: Camera) -> float:
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
