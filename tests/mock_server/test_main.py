"""``python -m mock_server`` as a program of its own."""

import re
import signal
import socket
import subprocess
import sys

import pytest
from wire import RawClient


class Address:
    def __init__(self, line):
        self.host, port = re.match(r"unreal://([\d.]+):(\d+) ", line).groups()
        self.port = int(port)


def run(*arguments):
    return subprocess.Popen(
        [sys.executable, "-m", "mock_server", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM])
def test_it_tells_its_address_serves_and_ends_quietly(end):
    process = run("six-wall", "--port", "0", "--dialect", "M", "--size", "20x10")
    try:
        line = process.stdout.readline()
        assert line.endswith(" six-wall dialect M\n")
        client = RawClient(Address(line))
        assert client.greeting == b"connected to six-wall"
        assert client.text("vget /unrealcv/version") == "0.3.10"
        client.socket.close()
        process.send_signal(end)
        assert process.communicate(timeout=60) == ("", "")
        assert process.returncode == 0
    finally:
        process.kill()


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["nowhere"], 2, "scene: expected one of direction, four-wall, six-wall, waves, or a YAML"),
        (["--dialect", "X"], 2, "dialect: expected one of"),
        (["--platform", "amiga"], 2, "platform: expected one of windows, linux; got 'amiga'"),
        (["--size", "big"], 2, "expected a size such as 640x480, got 'big'"),
        (["--size", "0x10"], 2, "size: expected"),
        (["--fov", "nan"], 2, "fov_deg: expected"),
    ],
)  # fmt: skip
def test_wrong_arguments_are_one_line(capsys, arguments, code, message):
    from mock_server.__main__ import main

    try:
        returned = main([*arguments, "--port", "0"])
    except SystemExit as left:  # argparse leaves by itself
        returned = left.code
    assert returned == code
    text = capsys.readouterr()
    assert message in text.err
    assert text.out == ""
    assert "Traceback" not in text.err


def test_a_port_in_use_is_said(capsys):
    from mock_server.__main__ import main

    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert main(["--port", str(port)]) == 1
    assert f"expected to listen on 127.0.0.1:{port}; " in capsys.readouterr().err
