"""The settings of a server, checked once, and the names of the scenes."""

import reprlib
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from numbers import Integral, Real
from pathlib import Path
from typing import Any, Literal, get_args

DialectName = Literal["N3", "1.x", "0.3.10", "L", "M", "N1", "N2"]
"""Dialects by name. The letters are those of the protocol reference; ``1.x`` is the newest of them."""

Depth = Literal["half", "float32"]

DIALECTS: tuple[DialectName, ...] = get_args(DialectName)
WORDS: dict[str, tuple[str, ...]] = {
    "dialect": DIALECTS,
    "depth": get_args(Depth),
    "platform": ("windows", "linux"),
    "shared_memory": ("unlisted", "refusing"),
    "files": ("folder", "anywhere"),
}
"""By setting, the words that it accepts."""

SCENES = Path(__file__).parent / "scenes"

_RANGES = {
    "port": (0, 65535),
    "fov_deg": (1, 179),
    "latency_ms": (0, 3.6e6),
    "frames_per_s": (1e-3, 1e6),
    "time_step_s": (0, 3600),
}
_WHOLE = ("port", "seed")
_MOST_PX = 1 << 15
_LOCAL = ("127.0.0.1", "localhost", "::1")


def scene_names() -> list[str]:
    """Return the names of the scenes in this package."""
    return sorted(path.stem for path in SCENES.glob("*.yaml"))


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of a server.

    Attributes:
        port: 0 takes any free port.
        dialect: one of ``DIALECTS``; other words are those of ``WORDS``.
        host: the address to listen on.
        depth: ``half``: depth is rounded to half floats as in the engine; ``float32``: it is not.
        platform: ``linux``: dialects N1 and later listen on a Unix socket in place of TCP once their first
            client has left.
        shared_memory: whether N3 lists its commands for shared memory: ``unlisted``; ``refusing``, as a game
            on Linux does.
        latency_ms: delay of every reply after its request; pipelined requests share it, as they share an
            engine's tick.
        size: width and height of new cameras, px.
        fov_deg: horizontal field of view of new cameras.
        window: width and height of the game's window, from which dialect 0.3.10 takes its masks, px; None
            for ``size``.
        frames_per_s: the frame rate while no request comes.
        time_step_s: seconds that the scene's clock advances in a frame.
        folder: where file commands write; None for a temporary folder, removed at the end.
        files: ``folder``: names that lead out of it are not written; ``anywhere``: they are, as by an engine;
            local addresses only.
        right_eye: ``EnableRightEye`` of unrealcv.ini: dialect 0.3.10 has camera 1, 40 cm to the right.
        camera_actor: the level holds a CameraActor: the window of 0.3.10 follows the field of view.
        faults: faults to inject, such as ``("delay=0.2@0.05", "vignette")``: see ``mock_server.faults``.
        seed: seed of the faults' random numbers.

    Raises:
        ValueError: a word is unknown, or a number is out of its range.
    """

    port: int = 0
    dialect: DialectName = "N3"
    host: str = "127.0.0.1"
    depth: Depth = "half"
    platform: str = "windows"
    shared_memory: str = "unlisted"
    latency_ms: float = 0.0
    size: tuple[int, int] = (640, 480)
    fov_deg: float = 90.0
    window: tuple[int, int] | None = None
    frames_per_s: float = 60.0
    time_step_s: float = 1 / 60
    folder: Path | None = None
    files: str = "folder"
    right_eye: bool = False
    camera_actor: bool = False
    faults: Iterable[str] = ()
    seed: int = 0

    def __post_init__(self) -> None:
        for key, words in WORDS.items():
            if key == "files" and self.host not in _LOCAL:
                words = words[:1]
            self._expect(key, getattr(self, key) in words, f"one of {', '.join(words)};")
        for key, (least, most) in _RANGES.items():
            value: Any = getattr(self, key)
            is_number = isinstance(value, Real) and not isinstance(value, bool)
            self._expect(key, is_number and least <= value <= most, f"a number from {least:g} to {most:g},")
        for key in _WHOLE:
            self._expect(key, isinstance(getattr(self, key), Integral), "a whole number,")
        for key, size in (("size", self.size), ("window", self.window or self.size)):
            self._expect(key, _is_size(size), f"(width, height) of 1 to {_MOST_PX} px each,")
        self._expect("host", _is_host(self.host), "an address,")
        self._expect("folder", isinstance(self.folder, Path | None), "a Path or None,")
        self._expect("faults", not isinstance(self.faults, str), "a list of texts,")

    def _expect(self, key: str, fits: bool, wanted: str) -> None:
        if not fits:
            raise ValueError(f"{key}: expected {wanted} got {reprlib.repr(getattr(self, key))}")


def _is_size(size: Any) -> bool:
    """Return whether a value is a tuple (width, height), px, within the bounds."""
    if not isinstance(size, tuple) or len(size) != 2:
        return False
    return all(isinstance(side, Integral) and 1 <= int(side) <= _MOST_PX for side in size)


def _is_host(text: Any) -> bool:
    """Return whether a text can be an address; an empty one would be every address of this machine."""
    with suppress(UnicodeError):  # a label of the name is too long
        return isinstance(text, str) and bool(text.encode("idna")) and text.isprintable() and " " not in text
    return False
