"""What a server can be told to do wrong: ``NAME[=VALUE][@PROBABILITY]``, such as ``delay=0.2@0.05``.

Probability is 1 when left out. Every fault throws dice of its own, from the server's seed and its name:
the same requests meet the same faults, whatever other faults are on. ``Server.faults`` turns faults that
throw dice on and off while the server runs.

Faults of the line; one throw for each reply, or for each connection where it says so:

================== ======== ==============================================================================
name               value    what happens
================== ======== ==============================================================================
``delay``          0.5      the reply comes this many seconds later, and all behind it too
``drip``           0.5      the reply comes in small pieces, spread over this many seconds
``missing``                 the reply is never sent
``wrong-id``                the reply carries the next id
``no-id``                   the reply comes without its id
``clicked``                 ``clicked``, without an id, comes before the reply: a click in the game's window
``cut``            0.5      only this share of the payload is sent; the next frame follows in its midst
``bad-magic``               the frame starts with a wrong magic number
``zero-size``               the frame claims to be empty, and is
``huge``                    the frame claims 4 GB
``reset``                   the connection is reset, half a reply on its way
``no-greeting``             for each connection: no greeting; requests are answered
``second-client``  1        for each connection: another client is served first, for this many seconds
================== ======== ==============================================================================

Faults of the picture; one throw for each look of a camera, or none where it says so:

================== ======== ==============================================================================
``stale``          1        after a move, so many pictures still show what the camera saw before (thrown for
                            each move)
``exposure-drift`` 0.3      eye adaptation: at each lit picture the gain goes this share of the way to what
                            makes the view middle grey. Ended by ``vrun r.EyeAdaptationQuality 0``
``vignette``       0.4      always: lit pictures darken as ``(1 - VALUE t)``, t the squared distance from the
                            centre, 1 in the corners. Ended by ``vrun r.Tonemapper.Quality 1`` (or 0)
``mask-gamma``              always: mask colours go through 8-bit linear vertex colours, so dark ones collide
                            (dialect 0.3.10 does so without being told)
``half-depth``              always: depth goes through half floats, also with ``depth="float32"``
``sky-dome``       500      always: the sky is the object SkyDome, a sphere of this radius, metres, around the
                            camera
``object-missing`` last one always: the object of this name is in lit and normal pictures, but in no depth nor
                            mask until ``vset /object/NAME/color``, as one that was spawned late
================== ======== ==============================================================================
"""

from __future__ import annotations

import random
from collections.abc import Iterable
from dataclasses import dataclass

Value = float | str | None

DEFAULTS: dict[str, Value] = {
    "delay": 0.5,
    "drip": 0.5,
    "missing": None,
    "wrong-id": None,
    "no-id": None,
    "clicked": None,
    "cut": 0.5,
    "bad-magic": None,
    "zero-size": None,
    "huge": None,
    "reset": None,
    "no-greeting": None,
    "second-client": 1.0,
    "stale": 1.0,
    "exposure-drift": 0.3,
    "vignette": 0.4,
    "mask-gamma": None,
    "half-depth": None,
    "sky-dome": 500.0,
    "object-missing": "",
}
"""The faults, and their values where none is given; None: it takes no value."""

_LARGEST = {"cut": 1.0, "exposure-drift": 1.0, "vignette": 1.0}
FIXED = ("vignette", "mask-gamma", "half-depth", "sky-dome", "object-missing")
"""Faults that are there from the start, without dice."""


@dataclass(frozen=True)
class Fault:
    """A fault, as asked for."""

    name: str
    value: Value
    probability: float

    def amount(self) -> float:
        """The value of a fault that takes a number."""
        assert isinstance(self.value, float)
        return self.value


def parse(text: str) -> Fault:
    """A fault of the grammar above.

    Raises:
        ValueError: an unknown name, or a value or probability that it cannot have.
    """
    head, at, chance = text.partition("@")
    name, equals, value = head.partition("=")
    if name not in DEFAULTS:
        raise ValueError(f"fault: expected one of {', '.join(DEFAULTS)}; got {name!r}")
    if at and name in FIXED:
        raise ValueError(f"fault {name}: expected no probability, it is always there; got {text!r}")
    probability = _number(chance, 1.0, f"fault {name}: probability") if at else 1.0
    default = DEFAULTS[name]
    if not equals:
        return Fault(name, default, probability)
    if default is None:
        raise ValueError(f"fault {name}: expected no value, got {text!r}")
    if isinstance(default, str):
        return Fault(name, value, probability)
    most = _LARGEST.get(name, float("inf"))
    return Fault(name, _number(value, most, f"fault {name}"), probability)


def _number(text: str, most: float, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not 0 <= value <= most or value == float("inf"):
        raise ValueError(f"{where}: expected a number from 0 to {most:g}, got {text!r}")
    return value


class Faults:
    """The faults of one server.

    Args:
        texts: faults in the grammar above; the last of a name counts.
        seed: of the dice.

    Raises:
        ValueError: a text that is no fault.
    """

    def __init__(self, texts: Iterable[str] = (), seed: int = 0) -> None:
        faults = [parse(text) for text in texts]
        self._seed = seed
        self._faults = {fault.name: fault for fault in faults}
        self._dice = {name: random.Random(f"{seed} {name}") for name in self._faults}
        self.struck: dict[str, int] = dict.fromkeys(self._faults, 0)
        """How often each fault has struck."""

    def __bool__(self) -> bool:
        return bool(self._faults)

    def start(self, text: str) -> None:
        """Turns a fault on, from now.

        Raises:
            ValueError: a text that is no fault, or one that is there from the start or not at all.
        """
        fault = parse(text)
        if fault.name in FIXED:
            raise ValueError(f"fault {fault.name}: expected when the server starts, not later")
        self._dice[fault.name] = random.Random(f"{self._seed} {fault.name}")
        self.struck.setdefault(fault.name, 0)
        self._faults[fault.name] = fault

    def stop(self, name: str) -> None:
        """Turns a fault off."""
        self._faults.pop(name, None)

    def get(self, name: str) -> Fault | None:
        """A fault, if it is on at all."""
        return self._faults.get(name)

    def strike(self, name: str) -> Fault | None:
        """A fault, if it is on and the dice say so."""
        fault = self._faults.get(name)
        if fault is None or self._dice[name].random() >= fault.probability:
            return None
        self.struck[name] += 1
        return fault
