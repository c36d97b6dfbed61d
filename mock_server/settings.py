"""The settings of a server, checked once."""

from collections.abc import Iterable
from dataclasses import dataclass
from numbers import Integral, Real
from pathlib import Path
from typing import Literal, TypedDict, get_args

DialectName = Literal["1.x", "0.3.10", "L", "M", "N1", "N2"]
"""Dialects by name. ``1.x`` is any of the modern ones; the letters are those of the protocol reference."""

Depth = Literal["half", "float32"]
Platform = Literal["windows", "linux"]

DIALECTS: tuple[DialectName, ...] = get_args(DialectName)
DEPTHS: tuple[Depth, ...] = get_args(Depth)
PLATFORMS: tuple[Platform, ...] = get_args(Platform)

_RANGES = {"port": (0, 65535), "fov_deg": (1, 179), "latency_ms": (0, 3.6e6), "frames_per_s": (1e-3, 1e6)}


class Options(TypedDict, total=False):
    """The optional keywords of ``serve``, as :class:`Settings` explains them."""

    host: str
    depth: Depth
    platform: Platform
    latency_ms: float
    size: tuple[int, int]
    fov_deg: float
    window: tuple[int, int] | None
    frames_per_s: float
    folder: Path | None
    faults: Iterable[str]
    seed: int


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What a server is like.

    Attributes:
        port: 0 takes any free port.
        dialect: one of ``DIALECTS``.
        host: the address to listen on.
        depth: ``half``: depth is rounded to half floats as in the engine; ``float32``: it is not.
        platform: ``linux``: dialects N1 and N2 leave TCP for a Unix socket once their first client has left.
        latency_ms: delay of every reply after its request; pipelined requests share it, as they share an
            engine's tick.
        size: width and height of new cameras, px, as in the plugin's settings.
        fov_deg: horizontal field of view of new cameras.
        window: width and height of the game's window, from which dialect 0.3.10 takes its masks, px; None
            for ``size``.
        frames_per_s: the frame rate while no request comes.
        folder: where commands that name a file write; None for a temporary one, removed at the end.
        faults: faults to inject, such as ``("delay=0.2@0.05", "vignette")``: see ``mock_server.faults``.
        seed: seed of the faults' random numbers.

    Raises:
        ValueError: a word is unknown, or a number is out of its range.
    """

    port: int = 0
    dialect: DialectName = "1.x"
    host: str = "127.0.0.1"
    depth: Depth = "half"
    platform: Platform = "windows"
    latency_ms: float = 0.0
    size: tuple[int, int] = (640, 480)
    fov_deg: float = 90.0
    window: tuple[int, int] | None = None
    frames_per_s: float = 60.0
    folder: Path | None = None
    faults: Iterable[str] = ()
    seed: int = 0

    def __post_init__(self) -> None:
        for key, words in (("dialect", DIALECTS), ("depth", DEPTHS), ("platform", PLATFORMS)):
            if (value := getattr(self, key)) not in words:
                raise ValueError(f"{key}: expected one of {', '.join(words)}; got {value!r}")
        for key, (least, most) in _RANGES.items():
            value = getattr(self, key)
            if not (isinstance(value, Real) and least <= float(value) <= most):
                raise ValueError(f"{key}: expected a number from {least:g} to {most:g}, got {value!r}")
        for key, size in (("size", self.size), ("window", self.window_size)):
            whole = isinstance(size, tuple) and all(isinstance(n, Integral) and int(n) > 0 for n in size)
            if not (whole and len(size) == 2):
                raise ValueError(f"{key}: expected (width, height) of at least 1 px each, got {size!r}")
        if isinstance(self.faults, str):
            raise ValueError(f"faults: expected a list of texts, got {self.faults!r}")

    @property
    def window_size(self) -> tuple[int, int]:
        """Width and height of the game's window, px."""
        return self.window or self.size
