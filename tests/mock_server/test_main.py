"""``python -m mock_server`` as a program of its own, and the signals that stop it."""

import contextlib
import re
import signal
import socket
import threading
import time
from pathlib import Path

import pytest
from support.processes import OMNISCV, started
from support.wire import RawClient

import mock_server
from mock_server.__main__ import main

STOPS = 10

STOPPED_BY_ANOTHER_THREAD = f"""
import signal, socket, threading
import mock_server

scene = mock_server.load_scene("direction")
for stop in range({STOPS}):
    with mock_server.stop_signal() as wait, mock_server.serve(scene) as server:
        client = socket.create_connection((server.host, server.port))
        client.recv(100)
        number = (signal.SIGINT, signal.SIGTERM)[stop % 2]
        # The kernel may choose any thread for a signal. Here it is never the main one.
        sender = threading.Thread(target=lambda: signal.pthread_kill(threading.get_ident(), number))
        sender.start()
        assert wait() == number
        sender.join()
    client.close()
    print(stop, flush=True)
"""


class Address:
    def __init__(self, line):
        self.host, port = re.search(r"unreal://([\d.]+):(\d+)", line).groups()
        self.port = int(port)


SERVERS = {"mock_server": ("-m", "mock_server"), "omniscv serve": (*OMNISCV, "serve")}


@pytest.mark.parametrize(
    ("name", "number", "ignored"),
    [
        ("mock_server", signal.SIGINT, [signal.SIGINT, signal.SIGHUP]),
        ("omniscv serve", signal.SIGTERM, [signal.SIGHUP]),
    ],
)
def test_the_first_signal_stops_it_quietly_with_a_client_connected(name, number, ignored, tmp_path):
    """A SIGHUP that nohup ignores does not. The folder for files, which the client has used, is removed."""
    arguments = ("six-wall", "--port", "0", "--dialect", "M", "--size", "20x10")
    with started(*SERVERS[name], *arguments, ignored=ignored) as process:
        line = process.stdout.readline()
        assert "six-wall" in line
        client = RawClient(Address(line))
        assert client.greeting == b"connected to six-wall"
        folder = Path(re.search("Config file: (.*)", client.text("vget /unrealcv/status"))[1]).parent
        assert folder.is_dir()
        if signal.SIGHUP in ignored:
            process.send_signal(signal.SIGHUP)
            assert client.text("vget /unrealcv/version") == "0.3.10"
        process.send_signal(number)
        assert process.communicate(timeout=60) == ("", "")
        assert process.returncode == 0
        assert not folder.exists()
        client.socket.close()


def test_a_server_that_cannot_listen_any_more_ends_with_one_line(capsys):
    """A folder is where its Unix socket has to be."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    path = Path(f"/tmp/unrealcv_{port}.socket")
    path.mkdir()
    address = Address(f"unreal://127.0.0.1:{port}")
    client = threading.Thread(target=connect_and_leave, args=(address,), daemon=True)
    client.start()
    try:
        assert main(["direction", "--port", str(port), "--platform", "linux"]) == 1
    finally:
        path.rmdir()
    client.join(60)
    out, err = capsys.readouterr()
    assert out == f"unreal://127.0.0.1:{port} direction dialect N3\n"
    assert err.startswith(f"mock_server: expected to go on listening; {path}: ")
    assert err.count("\n") == 1


def connect_and_leave(address):
    while True:
        with contextlib.suppress(ConnectionRefusedError):
            return RawClient(address).socket.close()
        time.sleep(0.01)


def test_a_signal_to_any_thread_is_noticed_every_time():
    with started("-c", STOPPED_BY_ANOTHER_THREAD, ignored=[signal.SIGINT]) as process:
        out, err = process.communicate(timeout=120)
    assert (out.split(), err) == ([str(stop) for stop in range(STOPS)], "")


def test_handlers_are_restored():
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    with mock_server.stop_signal() as wait:
        assert signal.getsignal(signal.SIGTERM) != before[1]
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGINT)
        assert wait() is signal.SIGTERM
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


def test_wrong_arguments_are_one_line(capsys):
    for arguments, message in (
        (
            ["nowhere"],
            "scene: expected one of courtyard, direction, fence, flat, four-wall, open, six-wall, ",
        ),
        (["--size", "big"], "expected a size such as 640x480, got 'big'"),
        (["--fault", f"delay={'9' * 9999}"], "fault delay: expected a number from 0 to 3600, got '9999"),
        (["--fault", "nofault"], "object-missing; got 'nofault'"),
        (["--latency-ms", "inf"], "latency_ms: expected a number from 0 to 3.6e+06, got inf"),
    ):
        try:
            returned = main([*arguments, "--port", "0"])
        except SystemExit as left:  # argparse leaves by itself
            returned = left.code
        assert returned == 2
        text = capsys.readouterr()
        assert message in text.err
        assert text.out == ""
        assert "Traceback" not in text.err


def test_a_port_in_use_is_reported(capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert main(["--port", str(port)]) == 1
    assert f"expected to listen on 127.0.0.1:{port}; " in capsys.readouterr().err
