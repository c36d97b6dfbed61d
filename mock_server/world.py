"""The state that commands read and set: clock, player, cameras and objects, in Unreal's frame.

Faults of images are injected here.
"""

import dataclasses
import itertools
import math
import re
from collections import OrderedDict, deque
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mock_server import flaws, pixels
from mock_server.cine import Cine
from mock_server.faults import Faults
from mock_server.flaws import Film
from mock_server.objects import MIRROR, Moment, Objects, Pose, SceneObject, Triple, camera_to_world
from mock_server.pixels import pinhole_rays
from mock_server.scene import LATEST_S, Scene, ViewHits
from mock_server.settings import Settings

Array = NDArray[np.float64]

_KEPT_VIEWS = 8
_KEPT_PIXELS = 1 << 23  # of 80 bytes
_MOST_PIXELS = 1 << 24
_KEPT_MOMENTS = 64
_SLOMO = re.compile(r"vrun slomo ([-+]?(?:\d*\.)?\d+)\s*", re.ASCII)
_SETRES = re.compile(r"vrun (?:r\.)?setres (\d{1,5})x(\d{1,5})[wf]*\s*", re.ASCII | re.IGNORECASE)
# of the engine's slow motion
_SLOWEST = 1e-4
_FASTEST = 20.0
_STEEPEST_DEG = 89.9
"""The largest pitch and roll that the engine's controller accepts, degrees."""
_ORIGIN: Triple = (0.0, 0.0, 0.0)
_START_CM: Triple = (0.0, 0.0, 150.0)
_PULL_BACK_CM = 0.125
"""How far before a surface a sweep ends, so that the next one meets it again, too."""


class Player:
    """The pawn: location (cm) and control rotation (degrees).

    Commands run before a frame's tick. The tick limits the rotation and publishes the pose; cameras follow
    some ticks later (protocol reference, sections 2.2, 4 and 7.2).
    """

    def __init__(self, location: Triple) -> None:
        self.location = location
        self.rotation = _ORIGIN
        self._poses: deque[Pose] = deque([(location, _ORIGIN)] * 4, maxlen=4)

    def limit(self) -> None:
        """Limit the rotation, as the controller does in each frame of a running game."""
        pitch, yaw, roll = self.rotation
        self.rotation = (_limited(pitch), yaw % 360.0, _limited(roll))

    def publish(self) -> None:
        """Store the pose at the end of a frame, for :meth:`delayed`."""
        self._poses.append((self.location, self.rotation))

    def delayed(self, location_frames: int, rotation_frames: int) -> Pose:
        """Return location and rotation of ``location_frames``, ``rotation_frames`` ticks before the last."""
        location = self._poses[-1 - location_frames][0]
        rotation = self._poses[-1 - rotation_frames][1]
        return location, rotation


def _limited(angle: float) -> float:
    """Clamp an angle to -89.9..89.9 degrees, and return it in [0, 360)."""
    signed = (angle + 180.0) % 360.0 - 180.0
    return max(-_STEEPEST_DEG, min(_STEEPEST_DEG, signed)) % 360.0


@dataclass
class Camera:
    """A capture camera; ``actor`` is the name of its actor if it was spawned.

    ``manual`` is whether its exposure is; ``bias`` is of its exposure, in stops.
    """

    name: str
    location: Triple  # cm
    rotation: Triple = _ORIGIN  # pitch, yaw, roll, degrees
    fov: float = 90.0  # along the longer side, degrees
    size: tuple[int, int] = (640, 480)  # width and height, px
    actor: str = ""
    manual: bool = False
    bias: float = 0.0
    cine: Cine = field(default_factory=Cine)

    def has_pixels(self) -> bool:
        """Return whether captures have pixels: size and field of view are possible and fit in memory."""
        return 0 < self.size[0] * self.size[1] <= _MOST_PIXELS and 0 < self.fov < 180

    def projection(self) -> tuple[float, float, float, float] | None:
        """Return fx, fy, cx, cy, px; None for square pixels around the middle."""
        return self.cine.projection(*self.size) if self.cine.enabled else None

    def center_m(self) -> Array:
        """Return the optical centre (3,) in the scene's frame, metres."""
        return MIRROR @ self.location / 100.0

    def rays(self) -> tuple[Array, Array]:
        """Return (H, W, 3) unit directions in the scene's frame, and (H, W) their lengths per depth."""
        R_w_c = camera_to_world(self.rotation)
        return pinhole_rays(R_w_c, self.fov_h_deg(), self.size, projection=self.projection())

    def fov_h_deg(self) -> float:
        """Return the horizontal field of view, degrees: the engine applies ``fov`` to the longer side."""
        width, height = self.size
        if width >= height:
            return self.fov
        return math.degrees(2 * math.atan(math.tan(math.radians(self.fov) / 2) * width / height))


class World:
    """A running scene: a player, cameras (the first is the player's), objects by name, and a clock.

    The clock advances in each frame, unless the game is paused, and moves the moving objects: a command that
    moves one of them lasts until the clock advances.

    Raises:
        ValueError: the object of a fault does not exist, or its tone.
    """

    def __init__(self, scene: Scene, settings: Settings, faults: Faults) -> None:
        self.scene = scene
        self.faults = faults
        self._size = settings.size
        self._fov_deg = settings.fov_deg

        self.player = Player(_START_CM)
        self.cameras = [Camera("PawnSensor", _START_CM, fov=self._fov_deg, size=self._size)]
        self._spawned = 0
        self.viewmode = "lit"
        self.window = settings.window or settings.size
        self.vertex_colors = settings.dialect in ("L", "0.3.10") or "mask-gamma" in faults

        self.paused = False
        self.time_s = scene.time
        self._step_s = settings.time_step_s
        self._slomo = 1.0  # factor of the clock's step

        self.placed_objects = Objects(scene)
        self._may_have_changed = True  # an object, since the last frame
        self._moments = deque([self.placed_objects.moment()] * _KEPT_MOMENTS, maxlen=_KEPT_MOMENTS)
        self._views: OrderedDict[tuple[Any, ...], ViewHits] = OrderedDict()
        self._begin_faults()

    def _begin_faults(self) -> None:
        """Set the attributes that faults of images need."""
        self._dome = SceneObject("SkyDome", (135, 206, 235), "", _ORIGIN)
        self._dome_radius = math.inf  # metres
        if dome := self.faults.get("sky-dome"):
            self._dome_radius = dome.amount()
            self.placed_objects.by_name[self._dome.name] = self._dome
        if missing := self._object_with("object-missing"):
            self.objects[missing].annotated = False
        self._glass = self._object_with("glass")
        self._gloss = self._object_with("gloss")
        self._film = Film(self.faults)
        self._depth_scale = 1.0

        self.vanished: list[tuple[tuple[float, ...], frozenset[str]]] = []
        """By place of the camera, one after the other, the objects that its images lack."""
        self._made_here: set[tuple[object, ...]] = set()
        self._history: dict[int, Array] = {}  # by camera, its last light
        self._shown: dict[int | str, Pose] = {}
        self._lag: dict[int | str, int] = {}

    @property
    def objects(self) -> dict[str, SceneObject]:
        """The objects by name, at their present poses; callers may change them."""
        self._may_have_changed = True
        self.placed_objects.follow()
        return self.placed_objects.by_name

    def _object_with(self, fault: str) -> str:
        """Return the key of a fault's object; an empty text without the fault."""
        if fault not in self.faults:
            return ""
        name = str(self.faults[fault].value or "".join(self.scene.objects[-1:]))
        if name not in self.scene.objects:
            known = ", ".join(self.scene.objects)
            raise ValueError(f"fault {fault}: expected one of {known}; got {name!r}")
        return name

    def placed(self) -> Scene:
        """Return the scene at this moment."""
        return self._present_moment().shown

    def swept(self, goal: Triple) -> Triple:
        """Return where the pawn ends, cm, on a straight line to ``goal``: just before the first surface."""
        start = np.array(self.player.location)
        end = np.array(goal)
        length = float(np.linalg.norm(end - start))
        if not length:
            return goal
        hits = self.placed().trace(MIRROR @ start / 100, MIRROR @ (end - start))
        free = max(0.0, 100 * float(hits.distance) - _PULL_BACK_CM)
        x, y, z = (start + min(1.0, free / length) * (end - start)).tolist()
        return x, y, z

    def spawn(self) -> str:
        """Add a camera, and return its actor's name."""
        location = self.cameras[0].location
        actor = f"FusionCameraActor_{self._spawned}"
        self._spawned += 1
        self.cameras.append(Camera("FusionCameraSensor", location, _ORIGIN, self._fov_deg, self._size, actor))
        return actor

    def destroy(self, name: str) -> bool:
        """Remove a spawned camera by its actor's name, or an object; return whether it existed."""
        for camera in self.cameras:
            if name and camera.actor == name:
                self.cameras.remove(camera)
                return True
        actor = self.objects.pop(name, None)
        if actor is not None:
            actor.hidden = True
        return actor is not None

    def bounds(self, actor: SceneObject) -> Array:
        """Return (2, 3) least and greatest corner of an object's box, cm, Unreal's axes."""
        if actor is self._dome:
            return 100.0 * self._dome_radius * np.array([[-1.0] * 3, [1.0] * 3])
        return np.sort(100.0 * np.array(self.placed().bounds(actor.key)) @ MIRROR, axis=0)

    def vertices(self, actor: SceneObject) -> Array:
        """Return (N, 3) points of an object's mesh, cm, Unreal's axes."""
        if actor is self._dome:
            return np.array(list(itertools.product(*self.bounds(actor).T)))
        return 100.0 * self.placed().vertices(actor.key) @ MIRROR

    def tick(self) -> bool:
        """End a frame; return whether the game runs."""
        runs = not self.paused or self.faults.strike("ignore-pause") is not None
        if runs:
            self._advance()
            if fault := self.faults.strike("falling"):
                x, y, z = self.player.location
                self.player.location = (x, y, z - fault.amount())
            self.player.limit()
        self._moments.append(self._present_moment())
        self._may_have_changed = False
        return runs

    def _advance(self) -> None:
        self.time_s = min(self.time_s + self._step_s * self._slomo, LATEST_S)
        self.placed_objects.set_time(self.time_s)
        self._may_have_changed |= bool(self.scene.moving)

    def _present_moment(self) -> Moment:
        """Return the present moment; the last frame's if nothing has changed since."""
        now = self.placed_objects.moment() if self._may_have_changed else self._moments[-1]
        return self._moments[-1] if now == self._moments[-1] else now

    def on_command(self, text: str) -> None:
        """Apply the effects of console commands: slow motion, the window's size, the end of faults."""
        self._film.on_command(text)
        if slomo := _SLOMO.fullmatch(text):
            self._slomo = min(max(float(slomo[1]), _SLOWEST), _FASTEST)
        if (setres := _SETRES.fullmatch(text)) and 0 < int(setres[1]) * int(setres[2]) <= _MOST_PIXELS:
            self.window = int(setres[1]), int(setres[2])

    def capture(self, camera: Camera, late: int = 0, mode: str = "") -> ViewHits:
        """Return the view of a ``camera``.

        Args:
            camera: where the view is from.
            late: of the objects so many frames before the last; 0 for the objects now.
            mode: for which an image is made of it; faults depend on it.
        """
        moment = self._captured_moment(late)
        location, rotation = self._pose_shown(camera)
        camera = dataclasses.replace(camera, location=location, rotation=rotation)
        if narrow := self.faults.strike("narrow-fov"):
            camera.fov = max(1.0, camera.fov - narrow.amount())
        self._misaim(camera)
        view = self._composed(camera, moment, moment.hidden | self._left_out(camera, mode))
        if self._gloss:
            rays = camera.rays()[0]
            center = camera.center_m()
            trace = partial(moment.shown.trace, hidden=moment.hidden)
            at = view.label == moment.shown.label(self._gloss)
            view = dataclasses.replace(view, paint=partial(flaws.mirrored, view, at, rays, center, trace))
        if self._dome_radius < math.inf and not self._dome.hidden:
            label = len(self.placed_objects.scene.objects) + 1
            view = flaws.domed(view, *camera.rays(), self._dome_radius, label)
        return view

    def _captured_moment(self, late: int) -> Moment:
        """Return the objects of so many frames before the last, or of now; faults make them later."""
        torn = None if self.paused else self.faults.strike("torn")
        for _ in range(int(torn.amount()) if torn else 0):
            self._advance()
            self._moments.append(self._present_moment())
        if fault := self.faults.strike("late-objects"):
            late += int(fault.amount())
        return self._moments[-1 - late] if late else self._present_moment()

    def _composed(self, camera: Camera, moment: Moment, hidden: frozenset[str]) -> ViewHits:
        """Return a view with glass in its colours only, and objects without annotation in no labels."""
        view = self._traced(camera, moment, hidden)
        if self._glass and self._glass not in hidden:
            hidden |= {self._glass}
            behind = self._traced(camera, moment, hidden)
            view = dataclasses.replace(behind, paint=partial(flaws.blended, view, behind))
        if moment.missing:
            annotated = self._traced(camera, moment, hidden | moment.missing)
            view = dataclasses.replace(annotated, paint=view.paint, normal=view.normal)
        return view

    def _left_out(self, camera: Camera, mode: str) -> frozenset[str]:
        """Return the objects that the fault ``vanishing`` leaves out of an image."""
        if "vanishing" not in self.faults:
            return frozenset()
        image = (mode, tuple(camera.rotation), camera.fov)
        place = tuple(camera.location)
        if not self.vanished or self.vanished[-1][0] != place or image in self._made_here:
            names = frozenset(name for name in self.objects if self.faults.strike("vanishing"))
            self.vanished.append((place, names))
            self._made_here.clear()
        self._made_here.add(image)
        return self.vanished[-1][1]

    def _misaim(self, camera: Camera) -> None:
        """Change the pose of one image by faults."""
        if fault := self.faults.strike("turned"):
            camera.rotation = flaws.turned(camera.rotation, fault.amount())
        if fault := self.faults.strike("roll"):
            camera.rotation = (*camera.rotation[:2], camera.rotation[2] + fault.amount())
        if fault := self.faults.strike("jitter"):
            degrees = fault.amount() * camera.fov / max(camera.size)
            camera.rotation = flaws.jittered(camera.rotation, degrees, self.faults.generators["jitter"])
        if fault := self.faults.strike("far-origin"):
            camera.location = flaws.rounded_far_away(camera.location, fault.amount())

    def image(self, view: ViewHits, mode: str, camera: Camera | None = None) -> pixels.Bytes:
        """Return (H, W, 3) a camera's view in a view mode; modes that the mock lacks look like ``lit``."""
        image = self._image(view, mode, camera)
        for name, only, change in flaws.IMAGES:
            if only in ("", mode) and (fault := self.faults.strike(name)):
                image = change(image, fault.amount(), self.faults.generators[name])
        return image

    def _image(self, view: ViewHits, mode: str, camera: Camera | None) -> pixels.Bytes:
        if mode == "object_mask":
            return self._mask(view)
        if mode == "normal" and not self.faults.strike("lit-normals"):
            return pixels.normals(view.normal)
        if mode == "depth":
            return pixels.gray_depth(view.depth)
        return self._lit(view, camera)

    def _mask(self, view: ViewHits) -> pixels.Bytes:
        if view.mask is not None:
            return view.mask
        colors = [(0, 0, 0), *self.placed_objects.colors(), self._dome.color]
        table = np.array(colors, dtype=np.uint8)
        if fault := self.faults.strike("near-colors"):
            table[2:-1:2] = table[1:-2:2] ^ (int(fault.amount()), 0, 0)
        if self.vertex_colors:
            table = pixels.through_vertex_colors(table)
        return table[view.label]

    def _lit(self, view: ViewHits, camera: Camera | None) -> pixels.Bytes:
        """Return a lit image, which the fault ``temporal`` mixes with the camera's one before."""
        if camera is None:
            lit = self._film.expose(view.codes)
        else:
            lit = self._film.expose(view.codes, camera.manual, camera.bias)
        ghost = self.faults.strike("temporal")
        if ghost is None:
            return lit
        key = id(camera)
        light = lit.astype(np.float64)
        if key in self._history and self._history[key].shape == light.shape:
            light += ghost.amount() * (self._history[key] - light)
        self._history[key] = light
        return np.round(light).astype(np.uint8)

    def depth(self, view: ViewHits, along_ray: bool) -> Array:
        """Return (H, W) depth of a ``view``, metres: along the rays if ``along_ray``, else along the axis."""
        depth = view.distance if along_ray else view.depth
        if not along_ray and self.faults.strike("ray-depth"):
            depth = view.distance / 100  # the dialects 1.x send centimetres
        if growth := self.faults.strike("moving-world"):
            depth = depth * self._depth_scale
            self._depth_scale += growth.amount()
        for name, change in flaws.DEPTHS:
            if fault := self.faults.strike(name):
                depth = change(depth, fault.amount(), view)
        return depth

    def _traced(self, camera: Camera, moment: Moment, hidden: frozenset[str]) -> ViewHits:
        """Return a view, cached for requests of other modes."""
        near = self.faults.strike("near-plane")
        near_m = near.amount() / 100 if near else 0.0
        view = (camera.location, camera.rotation, camera.fov_h_deg(), camera.projection())
        key = (camera.size, *view, moment.scene, moment.time_s, moment.placed, hidden, near_m)
        if key not in self._views:
            center = camera.center_m()
            rays = camera.rays()
            self._views[key] = moment.shown.view(center, *rays, hidden, near_m)
        self._views.move_to_end(key)
        while self._keeps_too_much():
            self._views.popitem(last=False)
        return self._views[key]

    def _keeps_too_much(self) -> bool:
        """Return whether the oldest view must go; the last one stays."""
        if len(self._views) <= 1:
            return False
        pixel_count = sum(math.prod(key[0]) for key in self._views)
        return len(self._views) > _KEPT_VIEWS or pixel_count > _KEPT_PIXELS

    def _pose_shown(self, camera: Camera) -> Pose:
        """Return the pose of an image: the camera's, or an earlier one by the fault ``stale``."""
        key: int | str = camera.name  # the window's camera has no number
        for number, other in enumerate(self.cameras):
            if other is camera:
                key = number
                break
        pose = camera.location, camera.rotation
        shown = self._shown.setdefault(key, pose)
        if shown == pose:
            self._lag.pop(key, None)
            return pose
        if key not in self._lag:
            fault = self.faults.strike("stale")
            self._lag[key] = int(fault.amount()) if fault else 0
        if self._lag[key] > 0:
            self._lag[key] -= 1
            return shown
        del self._lag[key]
        self._shown[key] = pose
        return pose
