"""``python -m mock_server``: a room behind the UnrealCV protocol, for any client, until Ctrl-C.

The first line on the standard output tells the address, for scripts that take any free port.
"""

from __future__ import annotations

import argparse
import contextlib
import signal
import sys
import threading
from collections.abc import Sequence
from pathlib import Path

from mock_server.scene import scene_names
from mock_server.server import DEPTHS, DIALECTS, PLATFORMS, Server


def main(arguments: Sequence[str] | None = None) -> int:
    """Serves until Ctrl-C or a termination signal; the exit code."""
    options = _parser().parse_args(arguments)
    try:
        server = Server(
            options.scene,
            options.port,
            options.dialect,
            latency_ms=options.latency_ms,
            depth=options.depth,
            platform=options.platform,
            host=options.host,
            size=options.size,
            fov_deg=options.fov,
            window=options.window,
            folder=options.folder,
            faults=options.fault,
            seed=options.seed,
        )
    except ValueError as wrong:
        print(f"mock_server: {wrong}", file=sys.stderr)
        return 2
    except OSError as failed:
        print(f"mock_server: expected to listen on {options.host}:{options.port}; {failed}", file=sys.stderr)
        return 1
    with server, contextlib.suppress(KeyboardInterrupt):
        ended = threading.Event()
        signal.signal(signal.SIGTERM, lambda *_: ended.set())
        print(f"{server.uri} {server.scene.name} dialect {options.dialect}", flush=True)
        ended.wait()
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m mock_server", description=__doc__.split("\n")[0])
    parser.add_argument(
        "scene", nargs="?", default="four-wall", help=f"{', '.join(scene_names())}, or a YAML file"
    )
    parser.add_argument("--port", type=int, default=9000, help="0 takes any free port (default 9000)")
    parser.add_argument("--host", default="127.0.0.1", help="the address to listen on (default loopback)")
    parser.add_argument("--dialect", default="1.x", help=f"one of {', '.join(DIALECTS)}")
    parser.add_argument("--platform", default="windows", help=f"one of {', '.join(PLATFORMS)}")
    parser.add_argument("--depth", default="half", help=f"one of {', '.join(DEPTHS)}")
    parser.add_argument("--latency-ms", type=float, default=0.0, help="how late every reply is")
    parser.add_argument("--size", type=_size, default=(640, 480), help="of images, px (default 640x480)")
    parser.add_argument("--fov", type=float, default=90.0, help="field of view, degrees (default 90)")
    parser.add_argument("--window", type=_size, help="size of the game's window (default as --size)")
    parser.add_argument("--folder", type=Path, help="where file commands write (default a temporary one)")
    parser.add_argument(
        "--fault",
        action="append",
        default=[],
        help="NAME[=VALUE][@PROBABILITY], such as delay=0.2@0.05; repeatable; see mock_server/faults.py",
    )
    parser.add_argument("--seed", type=int, default=0, help="of the faults' dice")
    return parser


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise argparse.ArgumentTypeError(f"expected a size such as 640x480, got {text!r}")
    return int(width), int(height)


if __name__ == "__main__":
    sys.exit(main())
