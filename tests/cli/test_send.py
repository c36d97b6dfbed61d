"""``omniscv send``: commands to a server, and nothing else."""

import socket

import pytest

import mock_server
from omniscv.cli import run


@pytest.fixture(scope="module")
def server():
    with mock_server.serve("four-wall", dialect="N2") as running:
        yield running


def test_replies_are_printed_in_order_binary_ones_by_kind_and_size(server, capsys):
    commands = ["vget /unrealcv/status", "vget /camera/0/depth npy", "vget /object/Table/mobility"]
    assert run(["send", server.uri, *commands]) == 0
    first, *_, picture, last = capsys.readouterr().out.splitlines()
    assert first == "Is Listening"
    assert picture.startswith("NPY, ")
    assert picture.endswith(" bytes, 640 x 480 px")
    assert last == "Movable"


def test_nothing_is_done_to_the_game_beside_the_commands(server, capsys):
    before = dict(server.statistics.counts)
    assert run(["send", server.uri, "vset /action/game/pause", "vget /action/game/is_paused"]) == 0
    assert capsys.readouterr().out.splitlines() == ["ok", "true"]
    sent = {text: n for text, n in server.statistics.counts.items() if before.get(text, 0) != n}
    assert {text for text in sent if text.startswith("vset")} == {"vset /action/game/pause"}
    assert len(server.world.cameras) == 1


def test_the_first_refusal_ends_it_with_1(server, capsys):
    assert run(["send", server.uri, "vget /scene/name", "vget /nothing", "vget /scene/name"]) == 1
    printed = capsys.readouterr()
    assert printed.out == "four-wall\n"
    assert "'vget /nothing' was refused: \"error No handler found" in printed.err


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["mock://four-wall"], "Missing argument 'COMMAND...'"),
        (["captures.sqlite", "vget /objects"], "expected unreal://host:port"),
        (["unreal://localhost:1", "vbatch 3"], "expected one with its own reply"),
        (["unreal://localhost:1", "vget\n/objects"], "expected one line such as 'vget /objects'"),
        (["unreal://localhost:1", "vget /objects", "--timeout", "0"], "--timeout: expected"),
    ],
)
def test_wrong_usage_is_one_line_and_2(arguments, says, capsys):
    assert run(["send", *arguments]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert says in line


def test_no_server_is_one_line_and_1(capsys):
    with socket.socket() as taken:  # and nobody listens there
        taken.bind(("127.0.0.1", 0))
        assert run(["send", "unreal://{}:{}".format(*taken.getsockname()), "vget /objects"]) == 1
    assert "No UnrealCV server reachable" in capsys.readouterr().err
