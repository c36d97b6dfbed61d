"""An UnrealCV server over an analytic scene, for tests, demos and newcomers without Unreal.

Scenes are traced exactly, so they are also the reference for composed images; this package imports nothing of
``omniscv``. Public names are imported when they are first used.
"""

from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

from mock_server.stop_signal import stop_signal  # at once: its module has the same name

if TYPE_CHECKING:
    from mock_server.scene import Hits, Scene, load_scene, summary
    from mock_server.scene_file import Room
    from mock_server.server import Server, serve
    from mock_server.settings import DIALECTS, Depth, DialectName, scene_names

__all__ = ["DIALECTS", "Depth", "DialectName", "Hits", "Room", "Scene", "Server",
           "load_scene", "scene_names", "serve", "stop_signal", "summary"]  # fmt: skip

_HOMES = {
    "scene": ("Hits", "Scene", "load_scene", "summary"),
    "scene_file": ("Room",),
    "server": ("Server", "serve"),
    "settings": ("DIALECTS", "Depth", "DialectName", "scene_names"),
}


def __getattr__(name: str) -> Any:
    for module, names in _HOMES.items():
        if name in names:
            globals()[name] = resolve_name(f"mock_server.{module}:{name}")
            return globals()[name]
    raise AttributeError(f"module 'mock_server' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
