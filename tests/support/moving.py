"""Worlds that move while they are captured, made of a scene that is traced exactly at every time."""

from dataclasses import replace

import mock_server
from omniscv.geometry.instant import Instant
from omniscv.sources import Request, SourceWrapper
from omniscv.sources.scene import SceneSource


class Unfrozen(SourceWrapper):
    """A scene whose clock goes on with every capture; it knows no state but the still one.

    Args:
        time_of: seconds of the scene's clock, by how many captures were made before.
        scene: a name.
    """

    def __init__(self, time_of, scene="workshop"):
        super().__init__(SceneSource(mock_server.load_scene(scene)))
        self._time_of, self.made, self.requests = time_of, 0, []

    @property
    def capabilities(self):
        return replace(super().capabilities, moves=True)

    def capture(self, requests):
        for request in requests:
            request.check_state(self.state, "unfrozen")
            instant = Instant(time=self._time_of(self.made))
            self.made += 1
            self.requests.append(request)
            with self.at(instant) as there:
                (capture,) = there.capture([Request(request.view, request.mode, there.state)])
            yield replace(capture, request=request)


class Frozen(SourceWrapper):
    """A source whose world may move, and that counts what is captured."""

    def __init__(self, source):
        super().__init__(source)
        self.requests = []

    @property
    def capabilities(self):
        return replace(super().capabilities, moves=True)

    def capture(self, requests):
        return super().capture(self.requests.append(request) or request for request in requests)

    def at(self, instant):
        found = Frozen(super().at(instant))
        found.requests = self.requests
        return found


def scene_at(time, scene="workshop"):
    """The scene's source at a time."""
    return SceneSource(mock_server.load_scene(scene), instant=Instant(time=time))
