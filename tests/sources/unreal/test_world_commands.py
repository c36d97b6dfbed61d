"""Commands beside captures: in turns with viewpoints, and repeated only where that is harmless."""

import threading

import numpy as np
import pytest
from support.unreal import opened, relayed
from support.worlds import CENTER, MOVED, SIZE, ahead, serve

import omniscv
from omniscv.errors import ArgumentError, ServerConnectionError, ServerRefusedError
from omniscv.geometry import Pose
from omniscv.sources import Request, View
from omniscv.sources.pool import SourcePool
from omniscv.sources.unreal.source import turns


@pytest.fixture(scope="module")
def source():
    with serve(time_step_s=0.0) as server, omniscv.open_source(server.uri) as opened:
        yield opened


@pytest.mark.parametrize("dialect", ["0.3.10", "N2"])
def test_replies_are_text_and_binary_ones_their_size_and_kind(dialect):
    with serve(dialect) as server, omniscv.open_source(server.uri) as opened:
        assert opened.command("vget /scene/name") == "yard"
        assert opened.command("vget /unrealcv/echo hello ") == "hello"
        assert opened.command("vget /camera/0/lit png").startswith("PNG, ")
        assert opened.command("vget /camera/0/depth npy").endswith(" bytes, 24 x 24 px")
        with pytest.raises(ServerRefusedError, match="'vget /nothing' was refused"):
            opened.command("vget /nothing")
        assert opened.state == ""


@pytest.mark.parametrize("text", ["", "  ", "vget /objects\nvget /objects", "vbatch 2", "a" * 5000, None])
def test_commands_that_would_break_the_stream_are_refused(source, text):
    with pytest.raises(ArgumentError, match="command: expected one"):
        source.command(text)


def test_commands_that_may_change_the_world_give_it_a_state(source):
    (before,) = source.capture(ahead(source))
    for harmless in ("vget /objects", "vset /camera/1/location 0 0 0", "vset /viewmode lit"):
        source.command(harmless)
        assert source.state == ""
    (again,) = source.capture(ahead(source))
    np.testing.assert_array_equal(before.pixels, again.pixels)  # the camera is aimed anew
    states = {""}
    for command in ("vset /object/Box/location 200 0 150", "vrun slomo 0.5", "vrun slomo 0.5"):
        source.command(command)
        states.add(source.state)
    assert len(states) == 4
    (moved,) = source.capture(ahead(source))
    assert (moved.pixels != before.pixels).any()


def test_a_source_without_a_server_has_no_commands_and_no_world():
    with omniscv.open_source("scene://four-wall") as scene:
        with pytest.raises(ArgumentError, match="expected a live server"):
            scene.command("vget /objects")
        with pytest.raises(ArgumentError, match="expected a live server"):
            scene.world.objects()


def test_no_command_comes_between_the_requests_of_a_viewpoint():
    log = []
    threads = []

    def change(command, forward):
        log.append(command)
        if sum(each.endswith("depth npy") for each in log) == 3 and not threads:
            threads.append(threading.Thread(target=source.command, args=("vget /unrealcv/echo now",)))
            threads[0].start()
        return forward(command)

    views = [View(Pose.from_angles(CENTER, yaw), 90.0, SIZE, SIZE) for yaw in range(0, 300, 25)]
    with serve(time_step_s=0.0) as server, relayed(server, change) as uri:
        source = omniscv.open_source(uri)
        with source:
            captures = list(source.capture(Request(view, "depth") for view in views))
            threads[0].join()
    assert len(captures) == len(views) == 12
    last = max(number for number, each in enumerate(log) if each.endswith("depth npy"))
    assert log.index("vget /unrealcv/echo now") > last


def test_turns_are_whole_viewpoints():
    def at(x, count, size=SIZE):
        return [Request(View(Pose.from_angles((x, 0, 0), i), 90.0, size, size), "lit") for i in range(count)]

    requests = [*at(0, 6), *at(1, 6), *at(2, 90), *at(3, 6), *at(4, 1, 4096), *at(5, 1), *at(6, 12, 4096)]
    found = list(turns(iter(requests), lambda request: None, alone=False))
    assert [request for turn in found for request in turn] == requests
    assert [len(turn) for turn in found] == [102, 7, 8, 5]  # more than 2^27 pixels are divided
    alone = list(turns(iter(requests), lambda request: None, alone=True))
    assert [len(turn) for turn in alone] == [6, 6, 90, 6, 1, 1, 12]


def test_a_command_whose_reply_is_lost_is_sent_again_only_where_that_is_harmless():
    log = []
    lost = []

    def change(text, forward):
        reply = forward(text)
        log.append(text)
        if text in lost:
            lost.remove(text)
            raise OSError
        return reply

    with serve() as server, opened(server, change) as game:
        for command, sent in (
            ("vget /object/Box/location", 2),
            ("vset /object/Box/location 200 0 150", 2),
            ("vrun slomo 1", 1),
            ("vexec Box jump", 1),
            ("vset /object/Box/destroy", 1),
            ("vset /objects/spawn CubeActor New", 1),
            ("vset /action/game/pause", 1),
            ("vset /camera/1/moveto 0 0 0", 1),
        ):
            lost.append(command)
            if sent == 2:
                assert game.command(command)
            else:
                with pytest.raises(ServerConnectionError, match="may have been carried out"):
                    game.command(command)
            assert (lost, log.count(command)) == ([], sent)
            assert game.command("vget /scene/name") == "yard"
        log.clear()
        lost.append("vget /unrealcv/version")  # the connection breaks while nothing is under way
        game.command("vrun slomo 1")
        assert (lost, log.count("vrun slomo 1")) == ([], 1)


def test_a_pool_changes_all_its_replicas():
    with (
        serve("N2", time_step_s=0.0) as first,
        serve("N2", time_step_s=0.0) as second,
        SourcePool([omniscv.open_source(each.uri) for each in (first, second)]) as pool,
    ):
        requests = ahead(pool, ("depth", "object_mask")) * 30
        instant = omniscv.geometry.instant.Instant({"Box": MOVED}, frozenset({"Pole"}), 2.0)
        with pool.at(instant) as moved:
            assert moved.state == pool.state == instant.state
            assert first.world.paused
            assert second.world.paused
            captures = list(moved.capture(ahead(moved, ("depth", "object_mask")) * 30))
        assert len({capture.payload for capture in captures}) == 2
        assert {capture.provenance["server"] for capture in captures} == {
            f"127.0.0.1:{each.port}" for each in (first, second)
        }
        assert pool.state == ""
        assert pool.command("vset /object/Box/hide") == "ok"
        assert first.world.objects["Box"].hidden
        assert second.world.objects["Box"].hidden
        with pytest.raises(ArgumentError, match="state"):
            list(pool.capture(requests))
