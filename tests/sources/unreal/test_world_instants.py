"""A live source at an instant: captures show exactly the scene then, and the game is as it was afterwards."""

import dataclasses

import numpy as np
import pytest
from support.faces import face_requests
from support.unreal import agrees, answering, opened
from support.worlds import CENTER, DIALECTS, MOVED, SCENE, SIZE, THINGS, ahead, at_time, placed, serve

import mock_server
import omniscv
from omniscv.cameras import create
from omniscv.errors import ArgumentError, ServerRefusedError, SourceError, TornSetError
from omniscv.geometry import Pose
from omniscv.geometry.instant import Instant
from omniscv.sources import Request, View
from omniscv.sources.recording.inspection import info

MODES = ("depth",)
RUNNING = {"time_step_s": 0.02}


def faces(source):
    return [Request(each.view, each.mode, source.state) for each in face_requests(SIZE, MODES, CENTER)]


def wrong(source, scene):
    captures = source.capture(faces(source))
    return [(c.mode, c.view.pose.angles()) for c in captures if not agrees(c, source, scene)]


@pytest.mark.parametrize("dialect", DIALECTS)
def test_a_puppet_shows_the_scene_at_any_time(dialect):
    with serve(dialect, **RUNNING) as server, omniscv.open_source(server.uri) as source:
        for time_s in (0.4, 3.25):
            instant = at_time(time_s)
            with source.at(instant) as still:
                assert server.world.paused
                assert still.state == source.state == instant.state
                assert still.capabilities.moves
                assert source.instant is source.instant  # described once, not at every capture
                assert not wrong(still, SCENE.at(time_s))
            assert not server.world.paused
            assert (source.state, source.instant.poses) == ("", {})


@pytest.mark.parametrize("dialect", DIALECTS)
def test_pausing_reads_where_the_objects_are(dialect):
    with serve(dialect, **RUNNING) as server, omniscv.open_source(server.uri, freeze="pause") as source:
        states = set()
        for _ in range(2):
            with source.at(Instant({"Ball": MOVED}, time=1.0)) as still:
                time_s = server.world.time_s
                found = still.instant
                states.add(still.state)
                assert set(found.poses) == {"Ball"}
                assert found.time is None
                assert abs(found.poses["Ball"].position - SCENE.at(time_s).pose("Ball")[1]).max() < 1e-4
                assert not wrong(still, SCENE.at(time_s))
            assert not server.world.paused
        assert len(states) == 2
        assert source.state == ""
        server.world.paused = True
        with source.at(Instant()) as still:  # without names: of all that can be moved
            assert set(still.instant.poses) == {"Ball", "Box", "Pole"}
        assert server.world.paused  # as it was


def test_a_batch_is_answered_in_one_tick():
    view = View(Pose.from_angles(CENTER), 90.0, 16, 16)
    payloads = {}
    for freeze in ("none", "batch"):
        with serve("N2", **RUNNING) as server, omniscv.open_source(server.uri, freeze=freeze) as source:
            with source.at(Instant(hidden=frozenset({"Box"}))) as there:
                requests = [Request(view, "depth", there.state)] * 80
                payloads[freeze] = {capture.payload for capture in there.capture(requests)}
                other = Request(View(Pose.from_angles((0, 0.2, 1.5)), 90.0, 16, 16), "depth", there.state)
                assert len(list(there.capture([*requests[:6], other]))) == 7
            assert server.statistics.total("vbatch") == (3 if freeze == "batch" else 0)
            assert not server.world.paused
    assert len(payloads["batch"]) == 1
    assert len(payloads["none"]) > 1


def test_nothing_is_paused_where_nothing_is_to_be_kept_nor_proven_of_a_still_game():
    with serve(time_step_s=0.0) as server, omniscv.open_source(server.uri, freeze="none") as source:
        with source.at(Instant({"Box": MOVED}, frozenset({"Ball"}), 1.5, "night")) as there:
            assert there.state == Instant({"Box": MOVED}, frozenset({"Ball"}), 1.5, "night").state
            assert not server.world.paused
            (capture,) = there.capture(ahead(there, ("object_mask",)))
            assert source.objects().colors["Ball"] not in {
                tuple(color) for color in capture.pixels.reshape(-1, 3).tolist()
            }
        assert not wrong(source, SCENE)
        assert server.statistics.total("vset /action/game") == 0
    with serve("N1") as server, omniscv.open_source(server.uri) as source:
        assert not source.capabilities.moves
        with source.at(Instant()) as same:
            assert (same.state, same.capabilities.moves) == ("", False)


def test_a_picture_that_proves_is_another_picture():
    """Also where it follows what it proves at once, and a camera gives several modes together."""
    with serve("0.3.10", **RUNNING) as server, omniscv.open_source(server.uri) as source:
        (first,) = ahead(source)
        before = server.statistics.counts["vget /camera/0/depth npy"]
        captures = list(source.capture([first, dataclasses.replace(first, again=True)]))
        assert len(captures) == 2
        assert server.statistics.counts["vget /camera/0/depth npy"] >= before + 2


@pytest.mark.parametrize(("dialect", "late"), [("0.3.10", 3), ("N1", 3)])
def test_captures_right_after_a_move_show_it_also_where_frames_lag(dialect, late):
    with (
        serve(dialect, time_step_s=0.0, faults=[f"late-objects={late}"]) as server,
        omniscv.open_source(server.uri) as source,
    ):
        requests = ahead(source)
        list(source.capture(requests))
        with source.at(Instant({"Box": MOVED})) as there:
            (capture,) = there.capture(ahead(there))  # from where the camera was
            assert agrees(capture, source, placed({"Box": MOVED}))
        (capture,) = source.capture(requests)
        assert agrees(capture, source, SCENE)


@pytest.mark.parametrize("dialect", ["0.3.10", "N1"])
def test_a_game_that_is_started_anew_is_brought_to_the_instant_again(dialect):
    instant = Instant({"Box": MOVED}, frozenset({"Ball"}), 2.0)
    rest = {name: THINGS[name] for name in ("Box", "Pole")}
    fewer = mock_server.Scene("yard", {"objects": rest}).at(0, {"Box": (MOVED.rotation, MOVED.position)})
    server = serve(dialect, **RUNNING)
    with omniscv.open_source(server.uri) as source, source.at(instant) as there:
        list(there.capture(ahead(there)))
        server.stop()
        with serve(dialect, port=server.port, **RUNNING) as again:
            (capture,) = there.capture(ahead(there))
            assert again.world.paused
            assert agrees(capture, source, fewer)
            source.close()
            assert not again.world.paused


def test_what_cannot_be_set_again_in_a_game_that_is_started_anew_is_an_error_and_then_another_state():
    server = serve(**RUNNING)
    with omniscv.open_source(server.uri, freeze="pause") as source:
        source.command("vrun slomo 0.5")
        requests = ahead(source)
        list(source.capture(requests))
        server.stop()
        with serve(port=server.port, time_step_s=0.5):
            with pytest.raises(SourceError, match="in which these were changed: commands; got one"):
                list(source.capture(requests))
            assert source.state == ""
            assert len(list(source.capture(ahead(source)))) == 1


def test_objects_that_were_read_are_where_they_were_after_a_fault_or_it_is_an_error():
    server = serve(**RUNNING)
    with omniscv.open_source(server.uri, freeze="pause", retries=8) as source:
        there = source.at(Instant({"Ball": MOVED}))
        requests = ahead(there)
        server.faults.start("reset@0.05")
        for _ in range(5):
            list(there.capture(requests))
        server.stop()
        with serve(port=server.port, time_step_s=0.0731):
            with pytest.raises(SourceError, match="expected objects where they were read"):
                list(there.capture(requests))
            assert source.state != requests[0].state
            there.close()


@pytest.mark.parametrize("dialect", DIALECTS[:3:2])
def test_batches_where_the_dialect_has_none_and_wrong_words_are_refused(dialect):
    with (
        serve(dialect) as server,
        pytest.raises(ServerRefusedError, match="expected a server that can answer a batch in one tick, got"),
    ):
        omniscv.open_source(server.uri, freeze="batch")
    with pytest.raises(ArgumentError, match=r"freeze: expected one of auto, puppet, .*; got 'hard'"):
        omniscv.open_source("unreal://localhost:1", freeze="hard")


def test_an_unknown_object_is_refused_and_the_game_goes_on():
    with serve(**RUNNING) as server, omniscv.open_source(server.uri) as source:
        for instant in (Instant({"Chair": MOVED}), Instant(hidden=frozenset({"Chair"}))):
            with pytest.raises(ArgumentError, match="expected objects of the scene, got 'Chair'"):
                source.at(instant)
        assert source.state == ""
        assert not server.world.paused


def test_a_game_that_does_not_stand_still_when_it_is_paused_is_refused():

    ignored = answering("ok", "vset /action/game/pause")
    refused = pytest.raises(ServerRefusedError, match="expected a game that stands still")
    with serve("0.3.10", **RUNNING) as server, opened(server, ignored) as source, refused:
        source.at(at_time(1.0))


def test_a_fault_while_an_instant_is_set_leaves_the_game_as_it_was():
    refuses = answering("error no", "vset /object/Pole/hide")
    with serve(time_step_s=0.0) as server, opened(server, refuses) as source:
        with pytest.raises(SourceError, match="'vset /object/Pole/hide' with ok, got 'error no'"):
            source.at(Instant({"Box": MOVED}, frozenset({"Ball", "Pole"})))
        assert source.state == ""
        assert not server.world.paused
        assert not server.world.objects["Ball"].hidden
        assert not wrong(source, SCENE)


ALL = ("lit", "object_mask", "depth")
LAYERS = ("lit", "labels", "depth")
WIDE = create("equirectangular", width=16, height=8)


TURNED = omniscv.Pose.from_angles(CENTER, yaw_deg=124)


def central(source):
    return omniscv.render(WIDE, TURNED, source, ALL, face_size=SIZE)


@pytest.mark.parametrize("dialect", ["0.3.10", "N1", "N3"])
def test_captures_of_a_running_game_are_never_delivered(dialect):
    with (
        serve(dialect, time_step_s=1 / 60) as server,
        omniscv.open_source(server.uri, freeze="none") as source,
        pytest.raises(TornSetError),
    ):
        central(source)


@pytest.mark.parametrize("freeze", ["puppet", "pause", "batch"])
def test_every_way_to_freeze_is_proven_and_recorded(freeze, tmp_path):
    path = tmp_path / "yard.sqlite"
    instant = at_time(0.8)
    with (
        serve("N2", time_step_s=0.02) as server,
        omniscv.record(omniscv.open_source(server.uri, freeze=freeze), path) as source,
        source.at(instant) as frozen,
    ):
        image = central(frozen)
    assert len(info(path).states) == 1
    with omniscv.open_source(path) as replay, replay.at(instant) as there:
        again = central(there)
        assert set(there.instant.poses) == {"Ball"}
    assert all(np.array_equal(image[name], again[name]) for name in LAYERS)


def test_a_pause_that_does_not_hold_is_found():
    with (
        serve("N1", time_step_s=0.02, faults=["ignore-pause"]) as server,
        omniscv.open_source(server.uri) as source,
        source.at(Instant(time=0.0)) as frozen,
        pytest.raises(TornSetError),
    ):
        central(frozen)
