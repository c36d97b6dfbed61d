"""``python -m mock_server`` and ``omniscv serve``: a scene behind the UnrealCV protocol, until Ctrl-C.

The first line on the standard output starts with the address, for scripts that take any free port. SIGINT,
SIGTERM and SIGHUP stop the server, SIGINT also where it was ignored at the start: see
:func:`mock_server.stop_signal`.
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from mock_server.faults import KINDS
from mock_server.settings import WORDS, scene_names
from mock_server.stop_signal import stop_signal

_LONGEST_LINE = 900
_OTHERS = {"omniscv serve": ", a recording or a mesh"}
_EXAMPLE = "four-wall --port 9000 --dialect 0.3.10 --size 512x512"


def main(
    arguments: Sequence[str] | None = None,
    program: str = "python -m mock_server",
    opened: Callable[[dict[str, Any]], dict[str, Any]] = dict,
) -> int:
    """Serve until a signal, and return the exit code: 1 if the server ended by itself, 2 for wrong usage.

    Args:
        arguments: of the command line; None for those of the process.
        program: the command as its help shows it. Errors are one line on standard error that starts with its
            first word.
        opened: a function of the parsed options that returns them with another scene, and its settings, in
            place of a name.
    """
    name = program.split()[0] if program.startswith("omniscv") else "mock_server"
    with stop_signal() as wait:
        try:
            options = vars(_parser(program).parse_args(arguments))
            options = opened(options)
            from mock_server.server import serve  # loads the tracer, which help does without

            server = serve(**options)
        except SystemExit:  # of --help
            return 0
        except ValueError as cause:
            return _fail(name, cause, 2)
        except OSError as cause:
            address = f"{options.get('host', '127.0.0.1')}:{options['port']}"
            advice = "free it, or take any free port by --port 0"
            return _fail(name, f"expected to listen on {address}; {advice}; {cause.strerror}", 1)
        with server:
            print(f"{server.uri} {server.scene.name} dialect {server.settings.dialect}", flush=True)
            stopped = wait(server)
    return 0 if stopped else _fail(name, server.fault or "the server has ended", 1)


def _fail(name: str, cause: object, code: int) -> int:
    """Print an error in one printable line, and return the exit code."""
    line = "".join(map(_printable, " ".join(str(cause).split())))
    print(f"{name}: {line[:_LONGEST_LINE]}", file=sys.stderr, flush=True)
    return code


def _printable(character: str) -> str:
    """Return a character, or its escape sequence if it cannot be printed."""
    return character if character.isprintable() else character.encode("unicode_escape").decode()


class _Parser(argparse.ArgumentParser):
    """Raises errors as ValueError."""

    def error(self, message: str) -> NoReturn:
        raise ValueError(f"{message.removeprefix('argument ')} (see {self.prog} --help)")


def _fault_lines() -> str:
    """Return a line for each fault: its name, what it does, and its default value."""
    width = max(map(len, KINDS))
    lines = []
    for name, kind in KINDS.items():
        default = f" (default {kind.default})" if kind.default else ""
        lines.append(f"  {name:{width}}  {kind.text}{default}")
    return "\n".join(lines)


def _parser(program: str) -> argparse.ArgumentParser:
    parser = _Parser(
        prog=program,
        description="Serve a scene over the UnrealCV protocol, for any client, until Ctrl-C.",
        epilog=f"faults:\n{_fault_lines()}\n\nExample: {program} {_EXAMPLE}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        argument_default=argparse.SUPPRESS,  # the settings have the defaults
        allow_abbrev=False,
    )
    parser.add_argument(
        "scene",
        nargs="?",
        default="four-wall",
        help=f"{', '.join(scene_names())}, a YAML file" + _OTHERS.get(program, ""),
    )
    add = parser.add_argument_group("server").add_argument
    add("--port", type=int, default=9000, help="0 takes any free port (default 9000)")
    add("--host", help="the address to listen on (default 127.0.0.1)")
    words = {key: f"one of {', '.join(texts)}" for key, texts in WORDS.items()}
    add("--dialect", help=f"{words['dialect']} (default N3)")
    add("--platform", help=f"{words['platform']} (default windows)")
    add("--shared-memory", help=f"{words['shared_memory']} (default unlisted)")
    add("--latency-ms", type=float, help="delay of every reply, ms")
    add("--folder", type=Path, help="where file commands write (default a temporary one)")
    add("--files", help=f"{words['files']}: whether names may lead out of it (default folder)")
    eye = "dialect 0.3.10 has camera 1, 40 cm to the right"
    add("--right-eye", action="store_true", help=eye)
    level = "the level holds a CameraActor: the window of 0.3.10 follows the field of view"
    add("--camera-actor", action="store_true", help=level)
    add = parser.add_argument_group("images").add_argument
    add("--size", type=_size, help="of images, px (default 640x480)")
    add("--window", type=_size, help="of the game's window, px (default as --size)")
    add("--fov", type=float, dest="fov_deg", help="field of view, degrees (default 90)")
    add("--depth", help=f"{words['depth']} (default half)")
    step = "seconds that the clock of a moving scene advances in a frame (default 1/60)"
    add("--time-step", type=float, dest="time_step_s", help=step)
    add = parser.add_argument_group("misbehaviour").add_argument
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
