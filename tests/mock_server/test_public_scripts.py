"""What public scripts ask for beside poses and pictures, over TCP with the official client."""

import logging
import socket

import cv2
import numpy as np
import pytest

import mock_server
from mock_server.objects import axes
from mock_server.protocol import read_frame

SIZE = (24, 18)
DIALECTS = ("L", "N1", "N3")


def decode_png(data):
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)


@pytest.fixture
def talk(start, connect):
    """Start a server and return the request function of the official client."""
    return lambda dialect="L", **options: connect(start(dialect=dialect, size=SIZE, **options)).request


@pytest.mark.parametrize("dialect", DIALECTS)
@pytest.mark.parametrize("files", ["folder", "anywhere"])
def test_files_have_their_names_and_leave_the_folder_only_if_the_server_was_told(
    talk, tmp_path, caplog, dialect, files
):
    folder, outside = tmp_path / "folder", tmp_path / "out"
    request = talk(dialect, folder=folder, files=files)
    for name in ("run/7/lit.PNG", "../out/a.png", f"{outside}/b.png"):
        assert not request(f"vget /camera/0/lit {name}").startswith("error")
    assert decode_png((folder / "run/7/lit.PNG").read_bytes()).shape[:2] == SIZE[::-1]
    assert sorted(p.name for p in outside.glob("*")) == (["a.png", "b.png"] if files == "anywhere" else [])
    assert [r.levelno for r in caplog.records if "--files anywhere" in r.message] == (
        [] if files == "anywhere" else [logging.WARNING] * 2
    )


def test_only_local_servers_write_anywhere():
    with pytest.raises(ValueError, match="files: expected one of folder; got 'anywhere'"):
        mock_server.serve("four-wall", host="0.0.0.0", files="anywhere")


@pytest.mark.parametrize("dialect", DIALECTS)
def test_the_window_takes_the_size_of_the_console_and_is_shot_into_files(talk, tmp_path, dialect):
    request = talk(dialect, folder=tmp_path)
    window = "vget /camera/0/object_mask png" if dialect == "L" else "vget /screenshot png"
    for command, size in (("vrun setres 32x20w", (32, 20)), ("vrun r.SetRes 40x30", (40, 30))):
        assert request(command) == "ok"
        assert decode_png(request(window)).shape[1::-1] == size
    request("vrun HighResShot 2")
    shots = list(tmp_path.glob("Saved/Screenshots/*.png"))
    assert [decode_png(shot.read_bytes()).shape[1::-1] for shot in shots] == [(80, 60)]


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


@pytest.mark.parametrize("actor", [False, True])
def test_the_mask_follows_the_field_of_view_where_the_level_has_a_camera_actor(talk, actor):
    request = talk(camera_actor=actor)
    wide = request("vget /camera/0/object_mask png")
    request("vset /camera/0/horizontal_fieldofview 40")
    assert (request("vget /camera/0/object_mask png") != wide) == actor


@pytest.mark.parametrize("dialect", DIALECTS)
def test_static_objects_say_so_and_stay(talk, dialect):
    """Walls and floors are static; only plugin 0.3.10 says that it could not move one."""
    request, refused = talk(dialect), "error Failed to move object Layout_Floor" if dialect == "L" else "ok"
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
    room, picture = request("vget /objects").split(), request("vget /camera/0/lit png")
    assert request("vset /action/game/level Nowhere") == "ok"
    assert request("vget /objects").split() == room
    assert [record.message.count("'Nowhere'") for record in caplog.records] == [1]
    assert request("vset /action/game/level /Game/Maps/six-wall") == "ok"
    request("vget /unrealcv/version")
    assert request("vget /objects").split() == list(mock_server.load_scene("six-wall").objects) != room
    assert request("vget /camera/0/lit png") != picture
    assert request("vget /scene/name") == "four-wall"  # of the project
    if dialect == "L":
        assert decode_png(request("vget /camera/1/lit png")).shape[1::-1] == SIZE
    else:
        assert request("vget /level/name") == "six-wall"


def test_fast_captures_of_the_dev_build_come_after_their_replies(talk, tmp_path):
    request = talk("Dev", folder=tmp_path, frames_per_s=1e-3)  # requests end frames, and nothing else does
    late = {}
    for fast in (1, 0):
        assert request(f"vset /camera/0/use_fast_capture {fast}") == "ok"
        assert request("vget /camera/0/use_fast_capture") == str(fast)
        assert request(f"vget /camera/0/lit {fast}.png") == f"{fast}.png"
        late[fast] = not (tmp_path / f"{fast}.png").exists()
        for _ in range(3):
            request("vget /unrealcv/version")
        assert (tmp_path / f"{fast}.png").exists()
    assert late == {1: True, 0: False}


def test_the_dev_build_annotates_all_objects_or_none(talk):
    request = talk("Dev")
    mask = request("vget /camera/0/seg png")
    assert request("vset /annotation/world/clear") == "ok"
    assert not decode_png(request("vget /camera/0/seg png")).any()
    request("vset /annotation/world")
    assert request("vget /camera/0/seg png") == mask


def test_clicks_come_by_themselves():
    with (
        mock_server.serve("four-wall", dialect="L", size=SIZE, faults=["clicked=0.02"]) as server,
        socket.create_connection((server.host, server.port), timeout=20) as connection,
    ):
        assert [read_frame(connection) for _ in range(3)] == [b"connected to four-wall", *[b"clicked"] * 2]
