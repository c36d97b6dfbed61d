"""The official client and its high-level ``UnrealCv_API`` take the mock for a game, of every dialect."""

import logging
from collections import Counter

import pytest
from support.wire import leave, official_api

MODERN = ("M", "N1", "N2", "N3")
SIZE = (48, 36)


@pytest.fixture(autouse=True, scope="module")
def quiet():
    logging.getLogger("unrealcv").setLevel(logging.CRITICAL)


# The client


@pytest.mark.parametrize("dialect", MODERN)
def test_the_official_client(start, connect, dialect):
    client = connect(start(dialect=dialect, size=SIZE))
    assert client.request("vset /cameras/spawn") == "FusionCameraActor_0"
    assert client.request("vset /camera/1/fov 60.0", -1) is True
    assert client.request("vget /camera/1/fov") == "60.000000"
    replies = client.request(["vget /camera/1/lit png", "vget /camera/1/depth npy", "vget /camera/1/seg bmp"])
    assert [reply[:2] for reply in replies] == [b"\x89P", b"\x93N", b"BM"]
    assert client.request([f"vget /unrealcv/echo w{i}" for i in range(200)]) == [f"w{i}" for i in range(200)]


# The high-level API


def test_construction_asks_for_what_the_reference_says(start):
    server = start(size=SIZE)
    leave(official_api(server, SIZE).client)
    asked = list(server.statistics.counts)
    assert asked[0] == "vget /unrealcv/commands"
    assert server.statistics.counts["vget /unrealcv/commands"] == 2
    whats = "unrealcv/version", "cameras", "camera/0/location", "camera/0/rotation", "camera/0/fov", "objects"
    assert asked[1:7] == [f"vget /{what}" for what in whats]


@pytest.fixture(params=MODERN)
def official(request, start):
    """A server of a scene that moves, one of each dialect, and the API that is connected to it."""
    server = start("workshop", dialect=request.param, size=(8, 8), frames_per_s=1e-3)
    api = official_api(server, (8, 8))
    yield server, api
    leave(api.client)


# Calls of the API, the command that each sends, and what it returns.
CALLS = [
    (("set_pause",), "vset /action/game/pause", None),
    (("get_is_paused",), "vget /action/game/is_paused", True),
    (("set_obj_location", "Crate", [10.0, -20.0, 30.5]), "vset /object/Crate/location 10.0 -20.0 30.5", None),
    (("get_obj_location", "Crate"), "vget /object/Crate/location", [10, -20, 30.5]),
    # The client sets roll, yaw, pitch, and gets pitch, yaw, roll.
    (("set_obj_rotation", "Crate", [0.0, 90.0, 0.0]), "vset /object/Crate/rotation 0.0 90.0 0.0", None),
    (("get_obj_rotation", "Crate"), "vget /object/Crate/rotation", [0, 90, 0]),
    (("get_obj_bounds", "Crate"), "vget /object/Crate/bounds", [-15, -50, 0.5, 35, 10, 60.5]),
    (("get_obj_scale", "Crate"), "vget /object/Crate/scale", [1, 1, 1]),
    (("set_obj_scale", "Crate", [1, 1, 2]), "vset /object/Crate/scale 1 1 2", None),
    (("get_obj_bounds", "Crate"), "vget /object/Crate/bounds", [-15, -50, -29.5, 35, 10, 90.5]),
    (("set_hide_obj", "Crate"), "vset /object/Crate/hide", None),
    (("set_show_obj", "Crate"), "vset /object/Crate/show", None),
    (("set_obj_color", "Crate", [1, 2, 3]), "vset /object/Crate/color 1 2 3", None),
    (("get_obj_color", "Crate"), "vget /object/Crate/color", [1, 2]),
    (("destroy_obj", "Crate"), "vset /object/Crate/destroy", None),
    (("set_resume",), "vset /action/game/resume", None),
    (("get_is_paused",), "vget /action/game/is_paused", False),
    (("set_global_time_dilation", 0.5), "vrun slomo 0.5", None),
]


def sent(server, api, call):
    """What a call returns, and the commands that it sends; some calls do not wait for their replies."""
    before = Counter(server.statistics.counts)
    returned = call()
    api.client.request("vget /scene/name")
    return returned, list(server.statistics.counts - before - Counter(["vget /scene/name"]))


def test_calls_for_objects_and_pause(official):
    server, api = official
    for (name, *arguments), command, expected in CALLS:
        returned, commands = sent(server, api, lambda name=name, given=arguments: getattr(api, name)(*given))
        assert (commands, returned) == ([command], expected)
    assert "Crate" not in api.obj_dict


def test_objects_are_spawned(official):
    server, api = official
    returned, commands = sent(server, api, lambda: api.set_new_obj("CubeActor", "Box"))
    red, green, blue = api.obj_dict["Box"]
    color = f"vset /object/Box/color {red} {green} {blue}"
    assert sorted(commands) == ["vget /cameras", color, "vset /objects/spawn CubeActor Box"]
    assert returned == "Box"
    assert "Box" in api.get_objects()
    assert api.get_obj_size("Box") == [100, 100, 100]
    with pytest.warns(UserWarning, match="Can not find a class with name 'Cow'"):
        assert api.set_new_obj("Cow", "Daisy") is None
    if server.settings.dialect == "N3":
        assert api.set_new_obj("CubeActor", "Far", [1.0, 2.0, 3.0]) == "Far"
        assert api.get_obj_location("Far") == [1, 2, 3]
        return
    with pytest.warns(UserWarning, match="for URI 'vset /objects/spawn CubeActor Far 1.0 2.0 3.0'"):
        assert api.set_new_obj("CubeActor", "Far", [1.0, 2.0, 3.0]) is None
