"""Official clients, 1.3.2 and 0.3.10, take the mock for a game: what public scripts and the API ask for."""

import contextlib
import logging
import os
import socket
from collections import Counter

import cv2
import numpy as np
import pytest
from support.wire import leave, official_api, old_client

import mock_server
from mock_server.objects import axes
from mock_server.protocol import read_frame

SIZE = (24, 18)
DIALECTS = ("L", "N1", "N3")


def size_of(data):
    """Width and height of a PNG."""
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR).shape[1::-1]


OLD = os.environ.get("UNREALCV_0_3_10", "")
"""Folder with the old client; without it, the new one alone is tested."""


@pytest.fixture(params=["1.3.2", "0.3.10"] if OLD else ["1.3.2"])
def talk(request, start, connect):
    """Starts a server, and returns the request function of an official client."""
    with contextlib.ExitStack() as clients:

        def talk_to(dialect="L", **options):
            server = start(dialect=dialect, size=SIZE, **options)
            if request.param == "1.3.2":
                return connect(server).request
            return clients.enter_context(old_client(server, OLD))

        yield talk_to


@pytest.mark.parametrize("dialect", DIALECTS)
@pytest.mark.parametrize("files", ["folder", "anywhere"])
def test_files_have_their_names_and_leave_the_folder_only_if_the_server_was_told(
    talk, tmp_path, caplog, dialect, files
):
    folder = tmp_path / "folder"
    outside = tmp_path / "out"
    request = talk(dialect, folder=folder, files=files)
    for path in (folder, outside):
        path.mkdir()
    (folder / "link").symlink_to(outside)
    for name in ("run/7/lit.PNG", "../out/a.png", f"{outside}/b.png", "link/c.png", "x/../../out/d.png"):
        assert not request(f"vget /camera/0/lit {name}").startswith("error")
    assert size_of((folder / "run/7/lit.PNG").read_bytes()) == SIZE
    written = sorted(path.stem for path in outside.glob("*.png"))
    assert written == (list("abcd") if files == "anywhere" else [])
    assert [r.levelno for r in caplog.records if "--files anywhere" in r.message] == (
        [] if files == "anywhere" else [logging.WARNING] * 4
    )


@pytest.mark.parametrize("dialect", DIALECTS)
def test_the_window_takes_the_size_of_the_console_and_is_shot_into_files(talk, tmp_path, dialect):
    request = talk(dialect, folder=tmp_path)
    window = "vget /camera/0/object_mask png" if dialect == "L" else "vget /screenshot png"
    for command, size in (("vrun setres 32x20w", (32, 20)), ("vrun r.SetRes 40x30", (40, 30))):
        assert request(command) == "ok"
        assert size_of(request(window)) == size
    request("vrun HighResShot 2")
    shots = list(tmp_path.glob("Saved/Screenshots/*.png"))
    assert [size_of(shot.read_bytes()) for shot in shots] == [(80, 60)]


def test_the_right_eye_is_beside_the_left_one(talk):
    request = talk(right_eye=True)
    request("vset /camera/0/pose 0 0 150 0 30 0")
    for distance in (40, 7):
        request("vget /unrealcv/echo a")
        request("vget /unrealcv/echo b")
        left, right = (np.array(request(f"vget /camera/{i}/location").split(), float) for i in (0, 1))
        np.testing.assert_allclose(right - left, distance * axes((0, 30, 0))[:, 1], atol=1e-3)
        request("vset /action/eyes_distance 7")
    assert request("vget /camera/1/lit png") != request("vget /camera/0/lit png")
    assert "EnableRightEye: true" in request("vget /unrealcv/status")


@pytest.mark.parametrize("dialect", DIALECTS)
def test_moves_and_keys_take_the_pawn_to_what_is_in_the_way(talk, dialect):
    """The front wall is at x = 300 cm. The tick after a reply may not have come yet."""
    request = talk(dialect)
    for commands, location, yaw in (
        (["vset /camera/0/moveto 100 20 150"], (100, 20, 150), 0),
        (["vset /camera/0/moveto 1000 20 150"], (299.875, 20, 150), 0),
        (["vset /camera/0/moveto 2000 20 150", "vset /action/keyboard W 1"], (299.875, 20, 150), 0),
        (["vset /camera/0/location 0 0 150"], (0, 0, 150), 0),
        (["vset /action/keyboard W 0.1", "vset /action/keyboard a 0.05"], (120, -60, 150), 0),
        (["vset /action/keyboard Right 2", "vset /action/keyboard Up 0.05"], (120, 0, 150), 90),
        (["vset /action/keyboard F 1", "vrun slomo 0.5", "vrun slomo 1"], (120, 0, 150), 90),
    ):
        assert [request(command) for command in commands] == ["ok"] * len(commands)
        for _ in range(3):
            request("vget /unrealcv/version")
        found = [request(f"vget /camera/0/{what}").split() for what in ("location", "rotation")]
        np.testing.assert_allclose(np.array(found, float), [location, (0, yaw, 0)], atol=1e-3)


@pytest.mark.parametrize("dialect", DIALECTS)
def test_static_objects_say_so_and_stay(talk, dialect):
    """Walls and floors are static; only plugin 0.3.10 says that it could not move one."""
    request = talk(dialect)
    refused = "error Failed to move object Layout_Floor" if dialect == "L" else "ok"
    for name, mobility, moved in (("Layout_Floor", "Static", refused), ("Table", "Movable", "ok")):
        at = f"/object/{name}"
        before = [request(f"vget {at}/{what}") for what in ("location", "rotation")]
        assert request(f"vget {at}/mobility") == mobility
        assert request(f"vset {at}/location 1 2 3") == moved
        assert request(f"vset {at}/rotation 0 90 0") == "ok"
        after = [request(f"vget {at}/{what}") for what in ("location", "rotation")]
        assert (after == before) == (mobility == "Static")


@pytest.mark.parametrize("dialect", DIALECTS)
def test_a_level_is_another_scene_of_the_package(talk, caplog, dialect):
    request = talk(dialect, right_eye=True)
    room = request("vget /objects").split()
    picture = request("vget /camera/0/lit png")
    assert request("vset /action/game/level Nowhere") == "ok"
    assert request("vget /objects").split() == room
    assert [record.message.count("'Nowhere'") for record in caplog.records] == [1]
    assert request("vrun setres 32x20w") == "ok"
    assert request("vset /action/game/level /Game/Maps/six-wall") == "ok"
    request("vget /unrealcv/version")
    window = "vget /camera/0/object_mask png" if dialect == "L" else "vget /screenshot png"
    assert size_of(request(window)) == (32, 20)  # as before the level was opened
    assert request("vget /objects").split() == list(mock_server.load_scene("six-wall").objects) != room
    assert request("vget /camera/0/lit png") != picture
    assert request("vget /scene/name") == "four-wall"  # of the project
    if dialect == "L":
        assert size_of(request("vget /camera/1/lit png")) == SIZE
    else:
        assert request("vget /level/name") == "six-wall"


def test_clicks_come_by_themselves():
    with (
        mock_server.serve("four-wall", dialect="L", size=SIZE, faults=["clicked=0.02"]) as server,
        socket.create_connection((server.host, server.port), timeout=20) as connection,
    ):
        assert [read_frame(connection) for _ in range(3)] == [b"connected to four-wall", *[b"clicked"] * 2]


MODERN = ("M", "N1", "N2", "N3")
LARGER = (48, 36)


@pytest.fixture(autouse=True, scope="module")
def quiet():
    logging.getLogger("unrealcv").setLevel(logging.CRITICAL)


@pytest.mark.parametrize("dialect", MODERN)
def test_the_official_client(start, connect, dialect):
    client = connect(start(dialect=dialect, size=LARGER))
    assert client.request("vset /cameras/spawn") == "FusionCameraActor_0"
    assert client.request("vset /camera/1/fov 60.0", -1) is True
    assert client.request("vget /camera/1/fov") == "60.000000"
    replies = client.request(["vget /camera/1/lit png", "vget /camera/1/depth npy", "vget /camera/1/seg bmp"])
    assert [reply[:2] for reply in replies] == [b"\x89P", b"\x93N", b"BM"]
    assert client.request([f"vget /unrealcv/echo w{i}" for i in range(200)]) == [f"w{i}" for i in range(200)]


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
