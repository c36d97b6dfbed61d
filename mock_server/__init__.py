"""An UnrealCV server over an analytic scene, for tests, demos and newcomers without Unreal.

The scene is traced exactly, so it is also the reference that composed images are compared with; this package
shares no code with ``omniscv``. Public names are imported when they are first used: tracing needs no server.
"""

from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

from mock_server.stop_signal import stop_signal  # at once: its module has the same name

if TYPE_CHECKING:
    from mock_server.catalog import load_scene, scene_names, summary
    from mock_server.render import ViewHits, render_view
    from mock_server.scene import Hits, Scene
    from mock_server.scene_file import Room
    from mock_server.server import Server, serve
    from mock_server.settings import DIALECTS, Depth, DialectName

__all__ = ["DIALECTS", "Depth", "DialectName", "Hits", "Room", "Scene", "Server", "ViewHits",
           "load_scene", "render_view", "scene_names", "serve", "stop_signal", "summary"]  # fmt: skip

_HOMES = {
    "catalog": ("load_scene", "scene_names", "summary"),
    "render": ("ViewHits", "render_view"),
    "scene": ("Hits", "Scene"),
    "scene_file": ("Room",),
    "server": ("Server", "serve"),
    "settings": ("DIALECTS", "Depth", "DialectName"),
}


def __getattr__(name: str) -> Any:
    for module, names in _HOMES.items():
        if name in names:
            globals()[name] = resolve_name(f"mock_server.{module}:{name}")
            return globals()[name]
    raise AttributeError(f"module 'mock_server' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
