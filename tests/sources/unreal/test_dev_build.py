"""The closed Dev build, as far as documents go: its commands are used where the server lists them."""

import numpy as np
from support.unreal import agrees
from support.worlds import SCENE, ahead, at_time, serve

import omniscv


def test_a_world_is_frozen_but_for_the_pawn_and_goes_on_afterwards():
    with serve("Dev", time_step_s=0.02, frames_per_s=500) as server:
        with omniscv.open_source(server.uri) as source, source.at(at_time(0.8)) as frozen:
            assert server.world.paused
            (capture,) = frozen.capture(ahead(frozen))
            assert agrees(capture, source, SCENE.at(0.8))
        assert not server.world.paused
        sent = server.statistics
        assert sent.total("vset /world/pause_all_except_pawn") == sent.total("vset /world/resume_all") == 1
        assert sent.total("vset /action/game/pause") == 0


def test_its_camera_keeps_its_stable_id_while_numbers_change():
    """The level gains a camera before ours, and the connection breaks."""
    with serve("Dev", time_step_s=0.0) as server, omniscv.open_source(server.uri) as source:
        (before,) = source.capture(ahead(source))
        assert before.provenance["command"].startswith("vget /camera/CID-FusionCameraActor_0-00/")
        server.world.spawn()
        server.world.cameras.insert(1, server.world.cameras.pop())
        server.faults.start("reset@0.03")
        while server.faults.struck["reset"] < 3:
            (after,) = source.capture(ahead(source))
            np.testing.assert_array_equal(after.pixels, before.pixels)
        server.faults.stop("reset")
        assert server.statistics.total("vset /cameras/spawn") == 1


def test_objects_are_annotated_and_other_replies_than_ok_are_taken():
    with serve("Dev", faults=["object-missing=Box"]) as server, omniscv.open_source(server.uri) as source:
        assert server.statistics.total("vset /annotation/object/Box") == 1
        reply = source.command("vset /light/directional/intensity 3")
        assert reply == "Set DirectionalLight intensity to 3.00"


def test_fast_captures_are_switched_off_where_they_are_listed():
    with serve("Dev") as server, omniscv.open_source(server.uri):
        sent = server.statistics.counts
        assert sent["vset /camera/CID-FusionCameraActor_0-00/use_fast_capture 0"] == 1
