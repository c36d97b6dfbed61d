"""Plugin 1.1.0, dialect N3: it lists its commands, and has cine cameras; on Windows it also shares memory.

The closed Dev build adds to it, as far as it is documented: each command may be missing from a real one.
"""

import json
from collections.abc import Callable, Mapping
from functools import partial

from mock_server import cine as cine_model
from mock_server.dialects.common import THREE, Reply, Row, sets, with_target
from mock_server.dialects.v1 import BAD_ARGUMENT, MODES, Branch52
from mock_server.objects import SceneObject
from mock_server.world import Camera

_NO_WINDOWS = "error Windows shared memory transport is only available on Windows"
_BONES = (" [str]", " [str] [str]")


class Plugin11(Branch52):
    """Plugin 1.1.0: the commands of branch 5.2, and those that the reference calls new since N2."""

    version = "1.1.0"

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
            refuse = camera(_refuse_sharing)
            rows += [(f"vget {cam}/{mode}_shared", f"{mode} in shared memory", refuse) for mode in MODES]
        return rows

    def _list(self) -> str:
        return "\n".join(sorted({command.template for command in self.commands}))


def _refuse_sharing(_: Camera) -> str:
    return _NO_WINDOWS


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
        ]
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


def _stable_id(camera: Camera) -> str:
    return f"CID-{camera.actor or camera.name}-00"
