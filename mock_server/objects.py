"""The objects of a running scene, as commands and the clock have moved them, and Unreal's rotators.

Unreal: left-handed, centimetres, X forward, Y right, Z up; a rotator is pitch, yaw, roll in degrees. Written
from the protocol reference, section 4, and independent of ``omniscv``, which is tested against it.
"""

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mock_server.scene import Scene

Array = NDArray[np.float64]
Triple = tuple[float, float, float]
Color = tuple[int, int, int]
Pose = tuple[Triple, Triple]

MIRROR = np.diag([1.0, -1.0, 1.0])
"""Unreal's axes to the scene's, and back."""

_POLE_HALF_SINE = 0.4999995
"""Half the sine of the pitch from which the engine reads it as 90 degrees; that pitch is 89.92."""

_ORIGIN: Triple = (0.0, 0.0, 0.0)
_WHOLE: Triple = (1.0, 1.0, 1.0)
_MOST_SPAWNED = 1000
_CUBE: Mapping[str, object] = {"solids": [{"box": [1.0, 1.0, 1.0], "at": [0.0, 0.0, 0.0]}]}
_LAST = "\U0010ffff"  # sorts behind every name, so that new objects leave the labels of the others

_CHANNEL = (0, 255, 127, 63, 191, 31, 95, 159, 223, 15, 47, 79, 111, 143, 175, 207,
            239, 7, 23, 39, 55, 71, 87, 103, 119, 135, 151, 167, 183, 199, 215, 231)  # fmt: skip
_FIXED = ((False, False, True), (False, True, False), (False, True, True), (True, False, False),
          (True, False, True), (True, True, False), (True, True, True))  # fmt: skip


def axes(rotation: Triple) -> Array:
    """Return (3, 3) columns forward, right, up in Unreal's axes."""
    pitch, yaw, roll = map(math.radians, rotation)
    sp = math.sin(pitch)
    cp = math.cos(pitch)
    sy = math.sin(yaw)
    cy = math.cos(yaw)
    sr = math.sin(roll)
    cr = math.cos(roll)
    forward = (cp * cy, cp * sy, sp)
    right = (sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, -sr * cp)
    up = (-(cr * sp * cy + sr * sy), cy * sr - cr * sp * sy, cr * cp)
    return np.stack([forward, right, up], axis=1)


def camera_to_world(rotation: Triple) -> Array:
    """Return (3, 3) camera (x right, y down, z forward) to the scene's world frame."""
    forward, right, up = (MIRROR @ axes(rotation)).T
    return np.stack([right, -up, forward], axis=1)


def through_quaternion(rotation: Triple) -> Triple:
    """Return a rotation as it reads after the engine stored it as a quaternion, in single precision.

    Pitch comes back in [-90, 90], yaw and roll in (-180, 180]; near the poles yaw and roll are split
    arbitrarily.
    """
    pitch, yaw, roll = rotation
    sp, cp = _half_sine_cosine(pitch)
    sy, cy = _half_sine_cosine(yaw)
    sr, cr = _half_sine_cosine(roll)
    x = cr * sp * sy - sr * cp * cy
    y = -cr * sp * cy - sr * cp * sy
    z = cr * cp * sy - sr * sp * cy
    w = cr * cp * cy + sr * sp * sy
    sine_half = z * x - w * y
    yaw = math.degrees(math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
    turn = math.degrees(2 * math.atan2(x, w))
    if abs(sine_half) > _POLE_HALF_SINE:
        side = math.copysign(1.0, sine_half)
        roll = math.remainder(side * yaw - turn, 360.0)
        return side * 90.0, yaw, 180.0 if roll == -180.0 else roll
    roll = math.degrees(math.atan2(-2 * (w * x + y * z), 1 - 2 * (x * x + y * y)))
    return math.degrees(math.asin(2 * sine_half)), yaw, roll


def _half_sine_cosine(angle_deg: float) -> tuple[np.float32, np.float32]:
    """Return sine and cosine of half an angle, in single precision."""
    half = np.float32(math.radians(math.remainder(angle_deg, 360.0)) / 2)
    return np.sin(half), np.cos(half)


@dataclass
class SceneObject:
    """An object's state. Its location is the centre of its box; rotations and scales are about it.

    ``key`` is its name in the scene, ``uncommanded`` its pose without commands. An object that is not
    ``annotated`` is missing in masks and depth. Commands do not move one whose ``mobility`` is ``Static``.
    """

    name: str
    color: Color
    key: str
    location: Triple
    rotation: Triple = _ORIGIN
    uncommanded: Pose = (_ORIGIN, _ORIGIN)
    scale: Triple = _WHOLE
    hidden: bool = False
    annotated: bool = True
    mobility: str = "Movable"
    class_name: str = "StaticMeshActor"


@dataclass(frozen=True)
class Moment:
    """The visible state of the objects at one time.

    Attributes:
        scene: the objects as described.
        time_s: on the scene's clock.
        placed: keys, locations and rotations of the objects that commands have moved.
        hidden: keys of hidden objects.
        missing: keys of objects that are not annotated.
    """

    scene: Scene
    time_s: float
    placed: tuple[tuple[str, Triple, Triple], ...]
    hidden: frozenset[str]
    missing: frozenset[str]

    @cached_property
    def shown(self) -> Scene:
        """The scene at this moment."""
        poses = {}
        for key, location, rotation in self.placed:
            poses[key] = (MIRROR @ axes(rotation) @ MIRROR, MIRROR @ location / 100.0)
        return self.scene.at(self.time_s, poses)


class Objects:
    """The objects of a scene, and those that commands add.

    Attributes:
        by_name: in the order of the reply to ``vget /objects``.
        scene: the objects as described, spawned ones included.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = self._unscaled = scene
        self._palette = palette()
        self._time_s = scene.time
        self._late = False
        self._actors: list[SceneObject] = []
        known = getattr(scene, "colors", {})  # of a recorded scene
        for key, color in zip(scene.objects, self._palette, strict=False):
            location, rotation = _in_unreal(scene.pose(key))
            actor = SceneObject(key, known.get(key, color), key, location, rotation, (location, rotation))
            actor.mobility = "Static" if key in scene.static else "Movable"
            self._actors.append(actor)
        self.by_name = {actor.name: actor for actor in self._actors}
        self._spawned = 0

    def set_time(self, time_s: float) -> None:
        """Set the time of moving objects, also of those that commands have moved; see :meth:`follow`."""
        self._time_s = time_s
        self._late = bool(self.scene.moving)

    def follow(self) -> None:
        """Update the poses of moving objects to the time that was set last."""
        if not self._late:
            return
        self._late = False
        scene = self.scene.at(self._time_s)
        for actor in self._actors:
            if actor.key in scene.moving:
                actor.uncommanded = _in_unreal(scene.pose(actor.key))
                actor.location, actor.rotation = actor.uncommanded

    def moment(self) -> Moment:
        """Return the visible state now."""
        overdue = frozenset(self.scene.moving) if self._late else frozenset()
        placed = []
        hidden = set()
        missing = set()
        for actor in self._actors:
            if (actor.location, actor.rotation) != actor.uncommanded and actor.key not in overdue:
                placed.append((actor.key, actor.location, actor.rotation))
            if actor.hidden:
                hidden.add(actor.key)
            elif not actor.annotated:
                missing.add(actor.key)
        time_s = self._time_s if self.scene.moving else 0.0
        return Moment(self.scene, time_s, tuple(placed), frozenset(hidden), frozenset(missing))

    def colors(self) -> list[Color]:
        """Return the mask colours, in the order of the labels from 1."""
        return [actor.color for actor in self._actors]

    def rename(self, actor: SceneObject, name: str) -> None:
        """Set the ``name`` of the object ``actor``, which keeps its position in the list."""
        renamed = {}
        for key, other in self.by_name.items():
            renamed[name if other is actor else key] = other
        self.by_name = renamed
        actor.name = name

    def spawn_cube(self, name: str = "", location: Triple = _ORIGIN) -> SceneObject | None:
        """Add a cube of one metre, which is annotated once it has a colour.

        Args:
            name: empty for one that is made up.
            location: of its centre, cm, Unreal's axes.

        Returns:
            The cube; None if there are too many.
        """
        if self._spawned == _MOST_SPAWNED:
            return None
        key = f"{_LAST}{self._spawned:06}"
        self._unscaled = self._unscaled.joined(key, _CUBE)
        cube = SceneObject(name or f"CubeActor_{self._spawned}", next(self._palette), key, location)
        cube.annotated = False
        cube.class_name = "CubeActor"
        self._spawned += 1
        self._actors.append(cube)
        self.by_name[cube.name] = cube
        self._describe()
        return cube

    def set_scale(self, actor: SceneObject, *factors: float) -> None:
        """Scale an object along its axes, by three factors."""
        x, y, z = factors
        actor.scale = (x, y, z)
        self._describe()

    def _describe(self) -> None:
        self.scene = self._unscaled
        for actor in self._actors:
            if actor.scale != _WHOLE:
                self.scene = self.scene.scaled(actor.key, actor.scale)


def palette() -> Iterator[Color]:
    """Yield the plugin's default mask colours in order (protocol reference, section 5.1)."""
    for index, value in enumerate(_CHANNEL):
        for fixed in _FIXED:
            choices = []
            for is_fixed in fixed:
                choices.append((value,) if is_fixed else _CHANNEL[:index])
            yield from itertools.product(*choices)


def _in_unreal(pose: tuple[Array, Array]) -> Pose:
    """Return location and rotation of an object that is turned about the vertical."""
    R_w_o, center = pose
    x, y, z = (100.0 * center @ MIRROR).tolist()
    return (x, y, z), (0.0, -math.degrees(math.atan2(R_w_o[1, 0], R_w_o[0, 0])) + 0.0, 0.0)
