"""``python -m mock_server`` as a program of its own, and the signals that stop it."""

import re
import signal
import socket
import subprocess
import sys

import pytest
from support.wire import RawClient

import mock_server
from mock_server.__main__ import main

STOPS = 30

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
        self.host, port = re.match(r"unreal://([\d.]+):(\d+) ", line).groups()
        self.port = int(port)


def run(*arguments, interrupt):
    """Start Python as a shell does: a job in the background (SIG_IGN) inherits an ignored SIGINT."""
    before = signal.signal(signal.SIGINT, interrupt)
    try:
        return subprocess.Popen(
            [sys.executable, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("interrupt", [signal.default_int_handler, signal.SIG_IGN])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_first_signal_stops_it_quietly_with_a_client_connected(number, interrupt):
    arguments = ("six-wall", "--port", "0", "--dialect", "M", "--size", "20x10")
    process = run("-m", "mock_server", *arguments, interrupt=interrupt)
    try:
        line = process.stdout.readline()
        assert line.endswith(" six-wall dialect M\n")
        client = RawClient(Address(line))
        assert client.greeting == b"connected to six-wall"
        assert client.text("vget /unrealcv/version") == "0.3.10"
        process.send_signal(number)
        assert process.communicate(timeout=60) == ("", "")
        assert process.returncode == 0
        client.socket.close()
    finally:
        process.kill()


@pytest.mark.parametrize("interrupt", [signal.default_int_handler, signal.SIG_IGN])
def test_a_signal_to_any_thread_is_noticed_every_time(interrupt):
    process = run("-c", STOPPED_BY_ANOTHER_THREAD, interrupt=interrupt)
    try:
        out, err = process.communicate(timeout=120)
    finally:
        process.kill()
    assert (out.split(), err) == ([str(stop) for stop in range(STOPS)], "")


def test_handlers_are_restored():
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    with mock_server.stop_signal() as wait:
        assert signal.getsignal(signal.SIGTERM) != before[1]
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGINT)
        assert wait() is signal.SIGTERM
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["nowhere"], 2, "scene: expected one of direction, four-wall, six-wall, waves, or a YAML"),
        (["--dialect", "X"], 2, "dialect: expected one of"),
        (["--platform", "amiga"], 2, "platform: expected one of windows, linux; got 'amiga'"),
        (["--size", "big"], 2, "expected a size such as 640x480, got 'big'"),
        (["--size", "0x10"], 2, "size: expected"),
        (["--fov", "nan"], 2, "fov_deg: expected"),
        (["--latency-ms", "inf"], 2, "latency_ms: expected a number from 0 to 3.6e+06, got inf"),
    ],
)  # fmt: skip
def test_wrong_arguments_are_one_line(capsys, arguments, code, message):
    try:
        returned = main([*arguments, "--port", "0"])
    except SystemExit as left:  # argparse leaves by itself
        returned = left.code
    assert returned == code
    text = capsys.readouterr()
    assert message in text.err
    assert text.out == ""
    assert "Traceback" not in text.err


def test_a_port_in_use_is_reported(capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert main(["--port", str(port)]) == 1
    assert f"expected to listen on 127.0.0.1:{port}; " in capsys.readouterr().err
