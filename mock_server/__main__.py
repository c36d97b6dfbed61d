"""``python -m mock_server``: a scene behind the UnrealCV protocol, for any client, until Ctrl-C.

The first line on the standard output is the address, for scripts that take any free port. SIGINT, SIGTERM and
SIGHUP stop the server, SIGINT also where it was ignored at the start: see :func:`mock_server.stop_signal`.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from mock_server.catalog import scene_names
from mock_server.faults import KINDS
from mock_server.server import serve
from mock_server.settings import DEPTHS, DIALECTS, PLATFORMS
from mock_server.stop_signal import stop_signal


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve until a signal, and return the exit code: 1 where the server ended by itself."""
    options = vars(_parser().parse_args(arguments))
    with stop_signal() as wait:
        try:
            server = serve(**options)
        except ValueError as wrong:
            print(f"mock_server: {wrong}", file=sys.stderr)
            return 2
        except OSError as failed:
            address = f"{options['host']}:{options['port']}"
            print(f"mock_server: expected to listen on {address}; {failed}", file=sys.stderr)
            return 1
        with server:
            print(f"{server.uri} {server.scene.name} dialect {server.settings.dialect}", flush=True)
            stopped = wait(server)
    if stopped is None:
        print(f"mock_server: {server.fault or 'the server has ended'}", file=sys.stderr)
    return 0 if stopped else 1


def _parser() -> argparse.ArgumentParser:
    width = max(map(len, KINDS))
    faults = "\n".join(
        f"  {name:{width}}  {kind.text}{f' (default {kind.default})' if kind.default else ''}"
        for name, kind in KINDS.items()
    )
    parser = argparse.ArgumentParser(
        prog="python -m mock_server",
        description=__doc__.split("\n")[0],
        epilog=f"faults:\n{faults}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        argument_default=argparse.SUPPRESS,  # the settings have the defaults
    )
    add = parser.add_argument
    add("scene", nargs="?", default="four-wall", help=f"{', '.join(scene_names())}, or a YAML file")
    add("--port", type=int, default=9000, help="0 takes any free port (default 9000)")
    add("--host", default="127.0.0.1", help="the address to listen on (default loopback)")
    add("--dialect", help=f"one of {', '.join(DIALECTS)}")
    add("--platform", help=f"one of {', '.join(PLATFORMS)}")
    add("--depth", help=f"one of {', '.join(DEPTHS)}")
    add("--latency-ms", type=float, help="delay of every reply, ms")
    step = "what the clock of a scene that moves advances in a frame, seconds (default 1/60)"
    add("--time-step", type=float, dest="time_step_s", help=step)
    add("--paced", action="store_true", help="requests wait for the next of 60 frames a second")
    add("--size", type=_size, help="of images, px (default 640x480)")
    add("--fov", type=float, dest="fov_deg", help="field of view, degrees (default 90)")
    add("--window", type=_size, help="size of the game's window, px (default as --size)")
    add("--folder", type=Path, help="where file commands write (default a temporary one)")
    fault = "NAME[=VALUE][@PROBABILITY], such as delay=0.2@0.05; repeatable; see below"
    add("--fault", action="append", dest="faults", help=fault)
    add("--seed", type=int, help="seed of the faults' random numbers")
    return parser


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise argparse.ArgumentTypeError(f"expected a size such as 640x480, got {text[:80]!r}")
    return int(width), int(height)


if __name__ == "__main__":
    sys.exit(main())
