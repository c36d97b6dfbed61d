"""A recording behind the UnrealCV socket: the official client gets the bytes that the server sent."""

import contextlib
import os
import signal
from types import SimpleNamespace

import pytest
from support.processes import OMNISCV, started
from support.wire import old_client

import mock_server
import omniscv

YAWS = (0, 90)
OLD = os.environ.get("UNREALCV_0_3_10", "")
"""Folder with the client of 2017, as in ``test_public_scripts``; without it, the new one alone is tested."""


@pytest.fixture(params=["1.x", "0.3.10"])
def dialect(request):
    return request.param


@pytest.fixture
def served(dialect, tmp_path):
    """A server, and 'omniscv serve' of what was recorded of it: their ports."""
    path = tmp_path / "room.sqlite"
    with mock_server.serve("four-wall", dialect=dialect, size=(64, 64)) as live:
        with omniscv.open_source(live.uri) as source, omniscv.record(source, path) as recorder:
            for yaw in YAWS:
                pose = omniscv.Pose.from_unreal((50, -40, 150), (0, yaw, 0))
                view = omniscv.sources.View(pose, 90.0, 64, 64)
                modes = ("lit", "object_mask", "depth", "normals")
                list(recorder.capture(omniscv.sources.Request(view, mode) for mode in modes))
            recorder.objects()
        with started(*OMNISCV, "serve", str(path), "--port", "0") as process:
            line = process.stdout.readline()
            assert ("dialect N3" if dialect == "1.x" else "dialect 0.3.10") in line
            yield live.port, int(line.split()[0].rpartition(":")[2])
            process.send_signal(signal.SIGTERM)
            process.communicate(timeout=60)
            assert process.returncode == 0


@pytest.mark.parametrize("client", ["1.3.2", "0.3.10"] if OLD else ["1.3.2"])
def test_official_clients_get_the_replies_and_bytes_of_the_server_that_was_recorded(served, connect, client):
    """The tutorial's steps: status, pictures in every form, and the colour of each object's mask."""
    with contextlib.ExitStack() as clients:

        def request_of(port):
            server = SimpleNamespace(host="127.0.0.1", port=port)
            if client == "1.3.2":
                return connect(server).request
            return clients.enter_context(old_client(server, OLD))

        live, recorded = map(request_of, served)
        status = recorded("vget /unrealcv/status")
        assert "Is Listening" in status or "Client Connected" in status
        commands = ["vget /objects"]
        forms = [f"vget /camera/0/{m}" for m in ("lit png", "object_mask png", "normal png", "depth npy")]
        for yaw in YAWS:
            commands += ["vset /camera/0/location 50 -40 150", f"vset /camera/0/rotation 0 {yaw} 0"]
            commands += ["vget /camera/0/location"] * 4 + ["vget /camera/0/rotation", *forms]
        commands += [f"vget /object/{name}/color" for name in live("vget /objects").split()]
        for command in commands:
            expected = live(command)
            assert isinstance(expected, bytes) == (command in forms)
            assert recorded(command) == expected, command
        recorded("vset /camera/0/location 50 -40 151")
        for _ in range(2):
            recorded("vget /camera/0/location")
        refused = recorded("vget /camera/0/lit png")
        assert refused.startswith("error ")
        assert "position by 0.01 m" in refused
