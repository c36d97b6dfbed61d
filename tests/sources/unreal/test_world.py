"""The world behind a live source: objects, clock and console in every dialect, and the state that follows."""

import contextlib

import numpy as np
import pytest
from support.unreal import agrees, opened
from support.worlds import DIALECTS, MOVED, SCENE, ahead, placed, serve, turned

import mock_server
import omniscv
from omniscv.errors import ServerRefusedError, SourceError
from omniscv.geometry.instant import Instant

STILL = {"time_step_s": 0.0}


@pytest.fixture(scope="module", params=DIALECTS)
def server(request):
    with serve(request.param, **STILL) as running:
        running.dialect = request.param
        yield running


@pytest.fixture(scope="module")
def source(server):
    with omniscv.open_source(server.uri) as opened:
        yield opened


@pytest.fixture
def world(source):
    with source.world.changes():
        yield source.world
    assert source.state == ""


def shows(source, scene):
    return all(agrees(capture, source, scene) for capture in source.capture(ahead(source)))


def located(server, name):
    found = server.world.objects[name]
    return np.array([*found.location, *found.rotation])


def test_a_hidden_object_is_in_no_capture_until_it_is_shown(source, world):
    world.hide("Ball")
    (hidden,) = source.capture(ahead(source))
    world.show("Ball")
    assert source.state == ""
    (shown,) = source.capture(ahead(source))
    assert np.isinf(hidden.pixels).sum() > np.isinf(shown.pixels).sum()


def test_the_state_is_that_of_the_instant_and_empty_when_all_is_put_back(source):
    with source.world.changes():
        source.world.move("Box", MOVED)
        moved = source.state
        assert moved == omniscv.geometry.instant.Instant({"Box": MOVED}).state
        np.testing.assert_allclose(source.world.pose("Box").position, MOVED.position, atol=1e-4)
        np.testing.assert_allclose(source.world.pose("Box").rotation, MOVED.rotation, atol=4e-4)
        with source.world.changes():
            source.world.hide("Pole")
            source.world.move("Box", turned((1.0, 0.0, 1.0)))
            assert source.state not in ("", moved)
        assert source.state == moved
        assert shows(source, placed({"Box": MOVED}))
        assert not shows(source, SCENE)
    assert source.state == ""
    assert shows(source, SCENE)


def test_pausing_leaves_a_game_as_it_was(server, source, world):
    for was in (False, True):
        server.world.paused = was
        with world.changes():
            world.pause()
            world.pause()
            assert server.world.paused
            assert world.paused
            world.resume()
            world.resume()
            assert not world.paused
        assert server.world.paused is was
    server.world.paused = False


def test_bounds_are_along_the_worlds_axes_or_refused_before_anything_is_sent(server, world):
    if server.dialect == "0.3.10":
        sent = server.statistics.total("")
        with pytest.raises(ServerRefusedError, match=r"expected .* read the bounds.*got plugin"):
            world.bounds("Box")
        assert server.statistics.total("") == sent
    else:
        box = world.bounds("Pole")
        (low, high) = SCENE.bounds("Pole")
        np.testing.assert_allclose(box.center_w, (low + high) / 2, atol=1e-4)
        np.testing.assert_allclose(box.size, high - low, atol=2e-4)


@pytest.mark.parametrize("dialect", DIALECTS)
def test_changes_are_put_back_after_an_error_and_a_connection_fault(dialect):
    """The connection breaks behind the move, and once more while it is put back."""
    breaks = set()

    def change(command, forward):
        reply = forward(command)
        for start in list(breaks):
            if command.startswith(start):
                breaks.discard(start)
                raise OSError
        return reply

    with serve(dialect, **STILL) as server, opened(server, change, retries=8) as source:
        before = located(server, "Box")
        with contextlib.suppress(ZeroDivisionError), source.world.changes():
            source.world.pause()
            source.world.hide("Pole")
            breaks.add("vset /object/Box/location")
            source.world.move("Box", MOVED)
            assert np.abs(located(server, "Box") - before).max() > 1
            breaks.update(("vset /object/Box/rotation", "vset /object/Pole/show"))
            raise ZeroDivisionError
        assert not breaks
        np.testing.assert_allclose(located(server, "Box"), before, atol=0.006)
        assert not server.world.objects["Pole"].hidden
        assert not server.world.paused
        assert source.state == ""
        assert shows(source, SCENE)


def test_closing_the_source_puts_open_changes_back():
    with serve("M", **STILL) as server:
        source = omniscv.open_source(server.uri)
        with contextlib.ExitStack() as unfinished:
            unfinished.enter_context(source.world.changes())
            source.world.pause()
            source.world.hide("Ball")
            source.close()
            assert not server.world.paused
            assert not server.world.objects["Ball"].hidden
        with pytest.raises(SourceError, match="expected an open source"):
            source.world.pause()


@pytest.mark.parametrize("dialect", ["0.3.10", "N1"])
def test_a_pause_whose_reply_is_lost_is_not_sent_twice_where_it_toggles(dialect):
    lost = []

    def change(command, forward):
        reply = forward(command)
        if command == "vset /action/game/pause" and not lost:
            lost.append(command)
            raise OSError
        return reply

    with serve(dialect, **STILL) as server, opened(server, change) as source:
        expected = pytest.raises(SourceError, match="not sent again") if dialect == "0.3.10" else None
        with source.world.changes():
            with expected or contextlib.nullcontext():
                source.world.pause()
            assert server.world.paused
        assert not server.world.paused


@pytest.mark.parametrize("dialect", DIALECTS)
def test_static_objects_are_not_moved_nor_varied_and_nothing_else_moves(dialect):
    expected = "can be moved, got 'Layout_Floor', whose mobility is 'Static'"
    both = {"Ball": MOVED, "Layout_Floor": MOVED}
    drawn = {"objects": {"Layout_Floor": {"shift": [0.0, 0.0, 1.0]}}}
    with (
        mock_server.serve("four-wall", dialect=dialect, size=(8, 8)) as server,
        omniscv.open_source(server.uri) as source,
    ):
        before = located(server, "Ball")
        for instant in (Instant(both), Instant.drawn(drawn)):
            with pytest.raises(ServerRefusedError, match=expected):
                source.at(instant)
        assert source.state == ""
        np.testing.assert_allclose(located(server, "Ball"), before, atol=1e-2)  # as printed
