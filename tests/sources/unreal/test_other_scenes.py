"""A game that is started again with another scene: captures of two scenes never come together."""

import pkgutil
import time
from contextlib import ExitStack

import pytest
from support.faces import face_requests

import mock_server
import omniscv
from omniscv.errors import SceneChangedError
from omniscv.sources.labels import labels_of
from omniscv.sources.recording.inspection import verify

DIALECTS = {"1.x": {}, "0.3.10": {"size": (16, 16)}}
MODES = ("lit", "object_mask", "depth")
REQUESTS = [request for x in range(10) for request in face_requests(16, MODES, (0.1 * x, 0.0, 1.5))]


class Game:
    def __init__(self, dialect, **options):
        self._options = {"dialect": dialect, **DIALECTS[dialect], **options}
        self.server = mock_server.serve("four-wall", **self._options)

    def start_again(self, scene):
        self.server.stop()
        self.server = mock_server.serve(scene, port=self.server.port, **self._options)


@pytest.fixture(params=DIALECTS)
def game(request):
    with ExitStack() as running:
        game = Game(request.param)
        running.callback(lambda: game.server.stop())
        yield game


def midway(game, requests, scene="six-wall"):
    for index, request in enumerate(requests):
        if index == 2 * len(requests) // 3:
            game.start_again(scene)
        yield request


def test_another_scene_in_mid_image_is_refused_and_nothing_of_it_is_recorded(game, tmp_path):
    path = tmp_path / "room.sqlite"
    live = omniscv.open_source(game.server.uri)
    got = []
    says = r"expected the scene 'four-wall'.*, got 'six-wall'.*; open the source again"
    with omniscv.record(live, path) as source, pytest.raises(SceneChangedError, match=says):
        got.extend(source.capture(midway(game, REQUESTS)))
    assert 0 < len(got) < len(REQUESTS)
    found = verify(path)
    assert (found.captures, found.faults) == (len(got), [])
    assert {capture.provenance["scene"] for capture in got} == {"four-wall"}


def test_another_scene_names_no_objects(game):
    with omniscv.open_source(game.server.uri) as source:
        game.start_again("six-wall")
        with pytest.raises(SceneChangedError):
            source.objects()
        with pytest.raises(SceneChangedError):
            source.geometry()


def test_the_same_scene_is_taken_up(game):
    with omniscv.open_source(game.server.uri) as source:
        assert len(list(source.capture(midway(game, REQUESTS, "four-wall")))) == len(REQUESTS)


@pytest.mark.parametrize("step", ["driver.paint", "source.object_table"])
def test_a_restart_while_colours_are_read_leaves_no_objects_out(step, game, monkeypatch):
    """A game that has just started shows one object in black, until it is painted."""
    name = f"omniscv.sources.unreal.{step}"
    with omniscv.open_source(game.server.uri) as source:
        table = source.objects()
    original = pkgutil.resolve_name(name)
    restarts = [True]

    def restarted(*arguments):
        if step == "driver.paint":
            original(*arguments)
        if restarts.pop() if restarts else False:
            game.start_again("four-wall")
        return original(*arguments) if step == "source.object_table" else None

    monkeypatch.setattr(name, restarted)
    with omniscv.open_source(game.server.uri) as source:
        assert source.objects() == table
        (capture,) = source.capture(face_requests(16, ("object_mask",), (0.0, 0.0, 1.5))[:1])
        assert labels_of(capture.pixels, table)[1] == {}
    assert not restarts


def open_level(server, name):
    """Open a level and wait for it: it stands in the next frame, before which a batch may be captured."""
    server.open_level(name)
    while server.world.scene.name != name:
        time.sleep(0.001)


def test_another_level_behind_the_same_connection_is_refused(game):
    with omniscv.open_source(game.server.uri) as source:
        list(source.capture(REQUESTS[:6]))
        open_level(game.server, "six-wall")
        with pytest.raises(SceneChangedError):
            list(source.capture(REQUESTS[6:12]))


def test_another_level_in_a_batch_of_one_tick_is_refused():
    with (
        mock_server.serve("four-wall", dialect="N2", size=(16, 16), frames_per_s=1000) as server,
        omniscv.open_source(server.uri, freeze="batch") as source,
    ):
        list(source.capture(REQUESTS[:6]))
        open_level(server, "six-wall")
        with pytest.raises(SceneChangedError):
            list(source.capture(REQUESTS[6:12]))
