"""Faults that the server injects on request: ``NAME[=VALUE][@PROBABILITY]``, such as ``delay=0.2@0.05``.

The default probability is 1. Every fault has an independent random generator, seeded by the server's seed and
the fault's name: the same requests get the same faults, whatever other faults are active. ``KINDS`` lists all
faults, as ``python -m mock_server --help`` does. ``Server.faults`` starts and stops faults while the server
runs, except the ``PERMANENT`` ones.
"""

import math
import random
import reprlib
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

Value = float | str | None


class Kind(NamedTuple):
    """What a fault does, its default value (None: it takes no value), and its largest value."""

    text: str
    default: Value = None
    most: float = 1e9


KINDS = {
    # The transport; drawn for each reply, or for each connection where it says so.
    "delay": Kind("the reply comes VALUE seconds later, and all behind it too", 0.5, 3600.0),
    "drip": Kind("the reply comes in small pieces, spread over VALUE seconds", 0.5, 3600.0),
    "missing": Kind("the reply is never sent"),
    "wrong-id": Kind("the reply carries the next id"),
    "no-id": Kind("the reply comes without its id"),
    "clicked": Kind("'clicked', as at a click, comes each VALUE seconds; 0: before each reply", 0.0, 3600.0),
    "cut": Kind("only the share VALUE of the payload is sent; the next frame follows at once", 0.5, 1.0),
    "bad-magic": Kind("the frame starts with a wrong magic number"),
    "zero-size": Kind("the frame has a size of 0, and no payload"),
    "huge": Kind("the frame's header says 4 GB"),
    "reset": Kind("the connection is reset after half the reply"),
    "no-greeting": Kind("for each connection: no greeting; requests are answered"),
    "second-client": Kind("for each connection: another one is served first, VALUE seconds", 1.0, 3600.0),
    # The world; drawn for each image, or for each command or frame where it says so.
    "stale": Kind("for each move: VALUE images still show what the camera saw before", 1.0),
    "exposure-drift": Kind("gain goes VALUE of the way to grey, until 'r.EyeAdaptationQuality 0'", 0.3, 1.0),
    "narrow-fov": Kind("images span VALUE degrees less than the camera's field of view", 10.0, 178.0),
    "temporal": Kind("lit: each image keeps the share VALUE of the camera's one before", 0.5, 1.0),
    "lit-normals": Kind("images of normals are the lit ones, as of branch 5.2 before 2026-03-11"),
    "ray-depth": Kind("dialects 1.x send the depth of 0.3.10: metres along the ray"),
    "moving-world": Kind("depth grows by the share VALUE from each depth image to the next", 0.1),
    "refuse-mask": Kind("requests for an object mask are answered by an error"),
    "ignore-pose": Kind("for each command that sets a camera's pose: it is answered ok, and changes nothing"),
    "torn": Kind("the clock advances by VALUE frames just before the image, unless paused", 1.0, 60.0),
    "late-objects": Kind("objects are as VALUE frames before the last (in 0.3.10: one more)", 2.0, 60.0),
    "ignore-pause": Kind("for each frame: the clock advances though the game is paused"),
    "vanishing": Kind("for each object at each place of the camera, and at a repeated image: none has it"),
    "falling": Kind("for each frame: the player sinks by VALUE cm", 1.0),
    "authentication": Kind("for each command: it is refused, because the client has not authenticated"),
    "turned": Kind("images that look steeply up or down are turned by VALUE degrees", 0.12, 180.0),
    "roll": Kind("every image is turned about its axis by VALUE degrees", 1.0, 180.0),
    "jitter": Kind("every image is shifted by up to VALUE pixels, another way each time", 0.5, 100.0),
    "far-origin": Kind("locations are single precision, VALUE km from the world's origin", 100.0),
    "near-plane": Kind("surfaces are not seen nearer than VALUE cm before the camera", 10.0),
    "far-plane": Kind("depth is at most VALUE metres", 100.0),
    "radial-depth": Kind("planar depth goes VALUE of the way to the distance along the ray", 1.0, 1.0),
    "depth-bits": Kind("depth is an integer of VALUE bits for 100 m", 16.0, 32.0),
    "depth-mantissa": Kind("depth is a float with a mantissa of VALUE bits", 7.0, 52.0),
    "mask-blur": Kind("masks: the edges of objects are blended over VALUE pixels", 1.0, 100.0),
    "mask-noise": Kind("masks: colours are off by up to VALUE levels", 2.0, 255.0),
    "near-colors": Kind("masks: every second object is VALUE levels beside the one before", 1.0, 255.0),
    "distortion": Kind("a lens that sees the share VALUE farther out in the corners", 0.01, 1.0),
    "lit-offset": Kind("lit is shifted by VALUE pixels against the other modes", 1.0, 100.0),
    "mask-offset": Kind("masks are shifted by VALUE pixels against the other modes", 1.0, 100.0),
    "color-cast": Kind("lit: red is up to VALUE brighter and blue darker, or the other way", 0.1, 1.0),
    "depth-scale": Kind("depth is too large by the share VALUE", 0.01, 100.0),
    "jpeg": Kind("8-bit images went through JPEG of quality 100 - VALUE", 10.0, 100.0),
    # The world, permanent.
    "dark-manual": Kind("lit: manual exposure is VALUE stops darker than the scene describes", 2.0, 20.0),
    "vignette": Kind("lit: darker by VALUE in the corners, until 'r.Tonemapper.Quality 1'", 0.4, 1.0),
    "mask-gamma": Kind("masks: 8-bit linear vertex colours, dark ones collide (always so in dialect 0.3.10)"),
    "sky-dome": Kind("the sky is the object SkyDome, a sphere of VALUE metres around the camera", 500.0),
    "bloom": Kind("lit: VALUE of the light is spread in each image, until 'r.BloomQuality 0'", 0.2, 1.0),
    "tone": Kind("lit: srgb, film or linear codes; exposure, vignette and bloom act on light", "srgb"),
    "gloss": Kind("lit: VALUE (the last object) mirrors what it faces, with half of the light", ""),
    "glass": Kind("VALUE (the last object) is half transparent in lit, and missing in all other modes", ""),
    "object-missing": Kind("VALUE (the last object) is in lit and normals only, until its colour is set", ""),
}
"""All faults by name. Some end at a console command, after ``vrun``."""

PERMANENT = (
    "dark-manual", "vignette", "bloom", "tone", "gloss", "glass", "mask-gamma", "sky-dome",
    "object-missing",
)  # fmt: skip
"""Faults that are active from the start, without a probability."""


@dataclass(frozen=True)
class Fault:
    """An active fault."""

    name: str
    value: Value
    probability: float

    def amount(self) -> float:
        """Return the value of a fault that takes a number."""
        assert isinstance(self.value, float)
        return self.value


def parse(text: str) -> Fault:
    """Return the fault that a text of the grammar above describes.

    Raises:
        ValueError: an unknown name, or a value or probability out of its range.
    """
    head, at, chance = text.partition("@")
    name, equals, value = head.partition("=")
    if name not in KINDS:
        raise ValueError(f"fault: expected one of {', '.join(KINDS)}; got {reprlib.repr(name)}")
    kind = KINDS[name]
    if at and name in PERMANENT:
        raise ValueError(f"fault {name}: expected no probability, it holds always; got {reprlib.repr(text)}")
    probability = _number(chance, 1.0, f"fault {name}: probability") if at else 1.0
    if not equals:
        return Fault(name, kind.default, probability)
    if kind.default is None:
        raise ValueError(f"fault {name}: expected no value, got {reprlib.repr(text)}")
    number = value if isinstance(kind.default, str) else _number(value, kind.most, f"fault {name}")
    return Fault(name, number, probability)


def _number(text: str, most: float, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 <= value <= most:
        raise ValueError(f"{where}: expected a number from 0 to {most:g}, got {reprlib.repr(text)}")
    return value


class Faults(dict[str, Fault]):
    """The active faults of one server, by name.

    Attributes:
        generators: by fault, its random generator.
        struck: how often each fault was drawn.

    Args:
        texts: faults in the grammar above; of one name, the last counts.
        seed: seed of the random generators.

    Raises:
        ValueError: a wrong text.
    """

    def __init__(self, texts: Iterable[str] = (), seed: int = 0) -> None:
        super().__init__()
        self._seed = seed
        self.generators: dict[str, random.Random] = {}
        self.struck: dict[str, int] = {}
        for text in texts:
            self._add(parse(text))

    def start(self, text: str) -> None:
        """Start a fault.

        Raises:
            ValueError: a wrong text, or a permanent fault.
        """
        fault = parse(text)
        if fault.name in PERMANENT:
            raise ValueError(f"fault {fault.name}: expected when the server starts, not later")
        self._add(fault)

    def stop(self, name: str) -> None:
        """Stop a fault."""
        self.pop(name, None)

    def strike(self, name: str) -> Fault | None:
        """Return a fault if it is active and its random generator draws it."""
        fault = self.get(name)
        if fault is None or self.generators[name].random() >= fault.probability:
            return None
        self.struck[name] += 1
        return fault

    def _add(self, fault: Fault) -> None:
        self[fault.name] = fault
        self.generators[fault.name] = random.Random(f"{self._seed} {fault.name}")
        self.struck.setdefault(fault.name, 0)
