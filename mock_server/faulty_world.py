"""A world whose pictures have faults; which ones, faults.py tells."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
from numpy.typing import NDArray

from mock_server import pictures
from mock_server.faults import Faults
from mock_server.render import ViewHits, pinhole_rays
from mock_server.rotator import Triple, camera_to_world
from mock_server.scene import Scene
from mock_server.world import Camera, SceneObject, World, horizontal_fov

DOME = "SkyDome"
_DOME_COLOR = (135, 206, 235)
_MIDDLE_GREY = 0.5
_NO_VIGNETTE = re.compile(r"vrun r\.Tonemapper\.Quality [01]\s*")
_NO_ADAPTATION = re.compile(r"vrun r\.EyeAdaptationQuality 0\s*")
_PAINTS = re.compile(r"vset /object/(\S+)/color ")

Pose = tuple[Triple, Triple]


class FaultyWorld(World):
    """A world seen through faulty eyes.

    Args:
        scene, size, fov_deg: as :class:`World`.
        faults: what is wrong.

    Raises:
        ValueError: the missing object is none of the scene's.
    """

    def __init__(self, scene: Scene, size: tuple[int, int], fov_deg: float, faults: Faults) -> None:
        super().__init__(scene, size, fov_deg)
        self._faults = faults
        self._dome: SceneObject | None = None
        if faults.get("sky-dome"):
            self._dome = SceneObject(DOME, _DOME_COLOR, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
            self.objects[DOME] = self._dome
        self._missing = self._missing_object()
        self._gain = 1.0
        self._vignette, self._adapts = faults.get("vignette"), True
        self._shown: dict[int | str, Pose] = {}
        self._lag: dict[int | str, int] = {}

    def hear(self, text: str) -> None:
        """Takes note of a command that cures a fault."""
        if _NO_VIGNETTE.fullmatch(text):
            self._vignette = None
        if _NO_ADAPTATION.fullmatch(text):
            self._adapts, self._gain = False, 1.0
        painted = _PAINTS.match(text)
        if painted and painted[1] == self._missing:
            self._missing = None

    def look(self, camera: Camera) -> ViewHits:
        location, rotation = self._pose_shown(camera)
        camera = dataclasses.replace(camera, location=location, rotation=rotation)
        view = super().look(camera)
        if self._missing is not None:
            rest = self._without(camera, self._missing)
            view = dataclasses.replace(rest, color=view.color, normal=view.normal)
        if self._dome is not None and not self._dome.hidden:
            view = _domed(view, camera, self._dome_radius(), len(self._actors) + 1)
        return view

    def lit(self, view: ViewHits) -> NDArray[np.uint8]:
        drift = self._faults.strike("exposure-drift")
        if drift is not None and self._adapts:
            wanted = _MIDDLE_GREY / max(1 / 255, float(view.color.mean()) / 255)
            self._gain += drift.amount() * (wanted - self._gain)
        if self._gain == 1.0 and self._vignette is None:
            return view.color
        light = view.color * self._gain
        if self._vignette is not None:
            light *= 1 - self._vignette.amount() * _squared_radius(view.label.shape)[..., None]
        return np.clip(np.round(light), 0, 255).astype(np.uint8)

    def mask(self, view: ViewHits) -> NDArray[np.uint8]:
        colors = [(0, 0, 0), *(actor.color for actor in self._actors)]
        if self._dome is not None:
            colors.append(self._dome.color)
        table = np.array(colors, dtype=np.uint8)
        if self._faults.get("mask-gamma"):
            table = pictures.through_vertex_colors(table)
        return table[view.label]

    def bounds(self, actor: SceneObject) -> NDArray[np.float64]:
        if actor is self._dome:
            return 100.0 * self._dome_radius() * np.array([[-1.0] * 3, [1.0] * 3])
        return super().bounds(actor)

    def _missing_object(self) -> str | None:
        fault = self._faults.get("object-missing")
        if fault is None:
            return None
        name = fault.value or (self.scene.objects[-1] if self.scene.objects else "")
        if name not in self.scene.objects:
            raise ValueError(
                f"fault object-missing: expected one of {', '.join(self.scene.objects)}; got {name!r}"
            )
        return str(name)

    def _pose_shown(self, camera: Camera) -> Pose:
        """Where a picture is taken from: where the camera is, or where it was."""
        numbers = (i for i, each in enumerate(self.cameras) if each is camera)
        key = next(numbers, camera.name)  # the window's camera has no number
        pose = camera.location, camera.rotation
        shown = self._shown.setdefault(key, pose)
        if shown == pose:
            self._lag.pop(key, None)
            return pose
        if key not in self._lag:
            fault = self._faults.strike("stale")
            self._lag[key] = int(fault.amount()) if fault else 0
        if self._lag[key] > 0:
            self._lag[key] -= 1
            return shown
        del self._lag[key]
        self._shown[key] = pose
        return pose

    def _without(self, camera: Camera, name: str) -> ViewHits:
        """A look at the scene without an object."""
        actor = self._actors[self.scene.objects.index(name)]
        hidden, actor.hidden = actor.hidden, True
        view = super().look(camera)
        actor.hidden = hidden
        return view

    def _dome_radius(self) -> float:
        fault = self._faults.get("sky-dome")
        assert fault is not None
        return fault.amount()


def _domed(view: ViewHits, camera: Camera, radius_m: float, label: int) -> ViewHits:
    """The view with a sphere around the camera behind everything."""
    rays, length = pinhole_rays(camera_to_world(camera.rotation), horizontal_fov(camera), *camera.size)
    sky = view.distance > radius_m
    return dataclasses.replace(
        view,
        label=np.where(sky, label, view.label).astype(np.uint16),
        depth=np.where(sky, radius_m / length, view.depth),
        distance=np.where(sky, radius_m, view.distance),
        normal=np.where(sky[..., None], -rays, view.normal),
    )


def _squared_radius(shape: tuple[int, ...]) -> NDArray[np.float64]:
    """(H, W) 0 in the middle, 1 in the corners."""
    y, x = ((np.arange(n) + 0.5 - n / 2) / (n / 2) for n in shape)
    return np.asarray((x[None, :] ** 2 + y[:, None] ** 2) / 2)
