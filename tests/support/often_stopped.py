"""A server that is started and stopped by its first signal, many times; prints how long each stop took, s.

Usage: often_stopped.py COUNT PROGRAM, one of ``mock_server`` and ``omniscv``. Each server is a process of its
own, forked after everything is imported, so that the time goes into stops. Its client asks for many images.
"""

import os
import re
import signal
import sys
import time

import mock_server
import mock_server.__main__
from omniscv import cli
from support.wire import RawClient

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
ARGUMENTS = ("four-wall", "--port", "0", "--size", "512x512")
PICTURES = [b"1:vget /camera/0/lit png", b"2:vset /camera/0/rotation 0 5 0", b"3:vget /camera/0/depth npy"]


class Address:
    def __init__(self, line):
        self.host, port = re.search(r"unreal://([\d.]+):(\d+)", line).groups()
        self.port = int(port)


def serve(program, output):
    """Run a server in a forked process, which ends with its exit code."""
    os.dup2(output, sys.stdout.fileno())
    if program == "mock_server":
        os._exit(mock_server.__main__.main(ARGUMENTS))
    sys.argv = ["omniscv", "serve", *ARGUMENTS]
    try:
        cli.main()
    except SystemExit as left:
        os._exit(left.code)


def stop(program, number):
    """Return how long a server takes to end after its first signal, and its exit code."""
    reading, writing = os.pipe()
    server = os.fork()
    if server == 0:
        serve(program, writing)
    os.close(writing)
    with os.fdopen(reading) as lines:
        client = RawClient(Address(lines.readline()))
        client.send(*PICTURES * 50)
        client.frame()
        time.sleep(0.02 * (number % 10))
        before = time.monotonic()
        os.kill(server, SIGNALS[number % len(SIGNALS)])
        _, status = os.waitpid(server, 0)
        seconds = time.monotonic() - before
        client.socket.close()
    return seconds, os.waitstatus_to_exitcode(status)


if __name__ == "__main__":
    mock_server.load_scene("four-wall").trace((0, 0, 1.5), (1, 0, 0))
    for each in range(int(sys.argv[1])):
        print("{:.3f} {}".format(*stop(sys.argv[2], each)), flush=True)
