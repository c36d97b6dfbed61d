"""The calls of the official ``UnrealCv_API`` for objects and pause: what is sent, and what is replied."""

import contextlib
import logging
from collections import Counter

import pytest
from support.wire import leave, official_api

MODERN = ("M", "N1", "N2", "N3")

CALLS = [
    (("set_pause",), "vset /action/game/pause", "ok", None),
    (("get_is_paused",), "vget /action/game/is_paused", "true", True),
    (("set_obj_location", "Crate", [10.0, -20.0, 30.5]),
     "vset /object/Crate/location 10.0 -20.0 30.5", "ok", None),
    (("get_obj_location", "Crate"), "vget /object/Crate/location", "10.000 -20.000 30.500", [10, -20, 30.5]),
    # The client sets roll, yaw, pitch, and gets pitch, yaw, roll.
    (("set_obj_rotation", "Crate", [0.0, 90.0, 0.0]), "vset /object/Crate/rotation 0.0 90.0 0.0", "ok", None),
    (("get_obj_rotation", "Crate"), "vget /object/Crate/rotation", "0.000 90.000 0.000", [0, 90, 0]),
    (("get_obj_bounds", "Crate"), "vget /object/Crate/bounds", "-15.00 -50.00 0.50 35.00 10.00 60.50",
     [-15, -50, 0.5, 35, 10, 60.5]),
    (("get_obj_scale", "Crate"), "vget /object/Crate/scale", "1.000 1.000 1.000", [1, 1, 1]),
    (("set_obj_scale", "Crate", [1, 1, 2]), "vset /object/Crate/scale 1 1 2", "ok", None),
    (("get_obj_scale", "Crate"), "vget /object/Crate/scale", "1.000 1.000 2.000", [1, 1, 2]),
    (("get_obj_bounds", "Crate"), "vget /object/Crate/bounds", "-15.00 -50.00 -29.50 35.00 10.00 90.50",
     [-15, -50, -29.5, 35, 10, 90.5]),
    (("set_hide_obj", "Crate"), "vset /object/Crate/hide", "ok", None),
    (("set_show_obj", "Crate"), "vset /object/Crate/show", "ok", None),
    (("set_obj_color", "Crate", [1, 2, 3]), "vset /object/Crate/color 1 2 3", "ok", None),
    (("get_obj_color", "Crate"), "vget /object/Crate/color", "(R=1,G=2,B=3,A=255)", [1, 2]),
    (("destroy_obj", "Crate"), "vset /object/Crate/destroy", "ok", None),
    (("set_resume",), "vset /action/game/resume", "ok", None),
    (("get_is_paused",), "vget /action/game/is_paused", "false", False),
    (("set_global_time_dilation", 0.5), "vrun slomo 0.5", "ok", None),
]  # fmt: skip


@pytest.fixture
def official(start, monkeypatch):
    """Starts a server and connects the API to it: both."""
    monkeypatch.setattr(logging.getLogger("unrealcv"), "level", logging.CRITICAL)
    with contextlib.ExitStack() as opened:

        def open_one(dialect):
            server = start("workshop", dialect=dialect, size=(8, 8), frames_per_s=1e-3)
            api = official_api(server, (8, 8))
            opened.callback(leave, api.client)
            return server, api

        yield open_one


def sent(server, api, call):
    """What a call returns, and the commands that it sends; some calls do not wait for their replies."""
    before = Counter(server.statistics.counts)
    returned = call()
    api.client.request("vget /scene/name")
    return returned, list(server.statistics.counts - before - Counter(["vget /scene/name"]))


@pytest.mark.parametrize("dialect", MODERN)
def test_calls_for_objects_and_pause(official, dialect):
    server, api = official(dialect)
    for (name, *arguments), command, _, expected in CALLS:
        returned, commands = sent(server, api, lambda name=name, given=arguments: getattr(api, name)(*given))
        assert (commands, returned) == ([command], expected)
    assert "Crate" not in api.obj_dict


@pytest.mark.parametrize("dialect", MODERN)
def test_their_replies_byte_by_byte(start, open_raw, dialect):
    raw = open_raw(start("workshop", dialect=dialect, size=(8, 8), frames_per_s=1e-3))
    for _, command, reply, _ in CALLS:
        assert raw.text(command) == reply


@pytest.mark.parametrize("dialect", MODERN)
def test_objects_are_spawned(official, dialect):
    server, api = official(dialect)
    returned, commands = sent(server, api, lambda: api.set_new_obj("CubeActor", "Box"))
    red, green, blue = api.obj_dict["Box"]
    color = f"vset /object/Box/color {red} {green} {blue}"
    assert sorted(commands) == ["vget /cameras", color, "vset /objects/spawn CubeActor Box"]
    assert returned == "Box"
    assert "Box" in api.get_objects()
    assert api.get_obj_size("Box") == [100, 100, 100]
    with pytest.warns(UserWarning, match="Can not find a class with name 'Cow'"):
        assert api.set_new_obj("Cow", "Daisy") is None
    if dialect == "N3":
        assert api.set_new_obj("CubeActor", "Far", [1.0, 2.0, 3.0]) == "Far"
        assert api.get_obj_location("Far") == [1, 2, 3]
        return
    with pytest.warns(UserWarning, match="for URI 'vset /objects/spawn CubeActor Far 1.0 2.0 3.0'"):
        assert api.set_new_obj("CubeActor", "Far", [1.0, 2.0, 3.0]) is None
