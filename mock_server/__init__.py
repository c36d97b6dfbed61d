"""A UnrealCV server over an analytic scene, for tests, demos and newcomers without Unreal.

The scene is traced exactly, so it is also the judge of every image composed from it; this package
shares no code with ``omniscv``.
"""

from mock_server.render import ViewHits, render_view
from mock_server.scene import Hits, Scene, load_scene, scene_names
from mock_server.server import DIALECTS, Server, serve

__all__ = [
    "DIALECTS",
    "Hits",
    "Scene",
    "Server",
    "ViewHits",
    "load_scene",
    "render_view",
    "scene_names",
    "serve",
]
