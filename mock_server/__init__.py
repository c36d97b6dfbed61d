"""An UnrealCV server over an analytic scene, for tests, demos and newcomers without Unreal.

The scene is traced exactly, so it is also the reference that composed images are compared with; this package
shares no code with ``omniscv``.
"""

from mock_server.catalog import load_scene, scene_names, summary
from mock_server.render import ViewHits, render_view
from mock_server.scene import Hits, Scene
from mock_server.scene_file import Room
from mock_server.server import Server, serve
from mock_server.settings import DIALECTS, Depth, DialectName
from mock_server.stop_signal import stop_signal

__all__ = ["DIALECTS", "Depth", "DialectName", "Hits", "Room", "Scene", "Server", "ViewHits",
           "load_scene", "render_view", "scene_names", "serve", "stop_signal", "summary"]  # fmt: skip
