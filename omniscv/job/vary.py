"""The key ``vary`` of a job: what of the world is drawn anew for each frame, place or world (docs/worlds.md).

**A draw depends on nothing but what it is for**: it is a hash of the seed, the world, the setting, the object
and the frame or place. So shards, orders and further rules change no other draw.
"""

import hashlib
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from statistics import NormalDist
from typing import Any

import numpy as np

from omniscv.arguments import number, numbers, one_of, shown, text, whole_number, within
from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.geometry.instant import turn_about_z
from omniscv.geometry.scene_geometry import ObjectBox
from omniscv.records import checked, mapping, record, word
from omniscv.sources.base import OBJECT_SETTINGS

KINDS = ("objects", "lights", "materials")
"""What a source may vary (:attr:`omniscv.sources.base.Capabilities.varies`)."""
COMMAND = "command"
"""A setting that is a command of a live server, in which ``{KEY}`` stands for the drawn value of a key."""
_DRAWS = 50
_LEAST_U = 2.0**-54  # a normal distribution has no value at 0


def uniform(seed: int, world: str, path: str, name: str, key: str) -> float:
    """Return a number in [0, 1) with 53 random bits: of the SHA-256 of the arguments as compact JSON."""
    text = json.dumps([seed, world, path, name, key], separators=(",", ":"), ensure_ascii=False)
    return (int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big") >> 11) * 2.0**-53


def draw(value: Any, u: Callable[[str], float]) -> Any:
    """Return what is drawn for a value as :func:`read_value` returns it; ``u`` gives the number in [0, 1) of
    a component: ``""``, or ``.0``, ``.1``, ``.2`` of a vector."""
    if not isinstance(value, dict | list):
        return value
    if isinstance(value, list):
        low, high = value
        return low + u("") * (high - low)
    ((word, of),) = value.items()
    if word == "box":
        low, high = of
        return [low[i] + u(f".{i}") * (high[i] - low[i]) for i in range(len(low))]
    if word == "choice":
        return of[math.floor(u("") * len(of))]
    if word == "log":
        return of[0] * (of[1] / of[0]) ** u("")
    return NormalDist(*of).inv_cdf(max(u(""), _LEAST_U))


def read_value(name: str, value: object) -> Any:
    """Return a value as plain numbers and lists; ArgumentError for anything but those of this module."""
    if (isinstance(value, list) and len(value) == 2) or isinstance(value, tuple):
        return _range(name, value)
    if not isinstance(value, Mapping):
        return number(f"{name}, if not [low, high] or a mapping", value)
    if len(value) != 1:
        raise ArgumentError(f"{name}: expected one of log, normal, choice, box; got {shown(list(value))}")
    ((word, of),) = value.items()
    where = f"{name}.{one_of(name, word, ('log', 'normal', 'choice', 'box'))}"
    if word == "choice":
        if not isinstance(of, list) or not of:
            raise ArgumentError(f"{where}: expected a list of numbers or of vectors, got {shown(of)}")
        return {word: numbers(where, of, (None, np.size(of[0])) if np.ndim(of[0]) else (None,)).tolist()}
    if word == "box":
        low, high = numbers(where, of, (2, 3)).tolist()
        if any(a > b for a, b in zip(low, high, strict=True)):
            raise ArgumentError(f"{where}: expected corners in order, got {shown(of)}")
        return {word: [low, high]}
    if word == "normal":
        mean, sigma = numbers(where, of, (2,)).tolist()
        return {word: [mean, number(f"{where}: sigma", sigma, above=0)]}
    low, high = _range(where, of)
    return {word: [number(where, low, above=0), high]}


def _range(name: str, value: Any) -> list[float]:
    low, high = numbers(name, value, (2,)).tolist()
    if low > high:
        raise ArgumentError(f"{name}: expected [low, high] in order, got {shown(value)}")
    return [low, high]


Rules = Mapping[str, Mapping[str, Any]]
"""By a name, or a pattern of names: values by setting."""


def _rules(name: str, value: object) -> dict[str, dict[str, Any]]:
    rules = {}
    for pattern, settings in mapping(name, {} if value is None else value).items():
        where = f"{name}.{text(name, pattern)}"
        known = mapping(where, settings, OBJECT_SETTINGS if name == "objects" else None)
        rules[pattern] = {
            key: (text if key == COMMAND else read_value)(f"{where}.{key}", entry)
            for key, entry in known.items()
        }
        if name == "objects":
            _check_object(where, rules[pattern])
        if COMMAND in known:
            with within(f"{where}.{COMMAND}"):
                _command(pattern, dict.fromkeys(known, 0.0) | {COMMAND: known[COMMAND]})
    return rules


def _check_object(where: str, settings: Mapping[str, Any]) -> None:
    """Refuse a chance beyond 1, and a clearance that is drawn."""
    number(f"{where}.clearance", settings.get("clearance", 0), least=0)
    number(f"{where}.shown", settings.get("shown", 1), least=0, most=1)


def _command(name: str, settings: Mapping[str, Any]) -> str:
    """Return a command with its values filled in, in decimals, as servers parse them."""
    values = {
        key: f"{value:.6f}".rstrip("0").rstrip(".") for key, value in settings.items() if key != COMMAND
    }
    try:
        return str(settings[COMMAND]).format(name=name, **values)
    except (KeyError, IndexError, ValueError, AttributeError) as wrong:
        known = ", ".join(["name", *values])
        raise ArgumentError(f"expected only the words {known} in braces, got {shown(str(wrong))}") from wrong


@record
class Vary:
    """What is drawn, and how often: see the module."""

    seed: int = checked(whole_number, least=0, default=0, help="seed of all draws")
    per: str = word(("frame", "place", "world"), default="frame", help="how often: frame, place or world")
    objects: Rules = checked(_rules, default_factory=dict, help="by name: shift, turn_deg, shown, clearance")
    lights: Rules = checked(_rules, default_factory=dict, help="by name: settings, or a command's")
    materials: Rules = checked(_rules, default_factory=dict, help="by name: settings, or a command's")
    cameras: Rules = checked(_rules, default_factory=dict, help="by name: parameters, drawn for each world")

    def draw_cameras(self, cameras: object, world: str) -> dict[str, Any]:
        """Return the descriptions of a job's cameras for a world, with the parameters that are drawn for it;
        such cameras are named after it."""
        described = mapping("cameras", cameras)
        for name, rules in self.cameras.items():
            camera = described[one_of("vary.cameras", name, described)]
            if rules and (not isinstance(camera, Mapping) or "file" in camera):
                raise ArgumentError(f"vary.cameras.{name}: expected a camera with its parameters in the job")
        start = f"{world}-" if world else ""
        return {
            f"{start}{name}" if name in self.cameras else name: self._drawn(name, camera, world)
            for name, camera in described.items()
        }

    def _drawn(self, name: str, camera: Any, world: str) -> Any:
        """Return the description of a camera with the parameters that are drawn for a world."""
        drawn = {
            key: draw(value, self.u(world, f"cameras.{key}", name, ""))
            for key, value in self.cameras.get(name, {}).items()
        }
        sizes = {key: int(value) if value % 1 == 0 else value for key, value in drawn.items()}
        return {**camera, **sizes} if sizes else camera

    def u(self, world: str, path: str, name: str, key: str) -> Callable[[str], float]:
        """Return the function of :func:`draw`."""
        return lambda part: uniform(self.seed, world, path + part, name, key)

    @property
    def rules(self) -> dict[str, Rules]:
        """The rules by kind, of those kinds that have some."""
        return {kind: rules for kind in KINDS if (rules := getattr(self, kind))}


@dataclass(frozen=True, eq=False)
class Draws:
    """The draws of one world.

    Attributes:
        vary: the rules.
        world: its name; empty in a job with one source.
        variable: by kind and name, the settings that the source has, and how many numbers each has.
        boxes: of objects at rest, for ``clearance``.
        pivots_w: (3,) by object, where it is turned about.
        skipped: by rule, how many objects its pattern matches that cannot be moved; known with the settings.
    """

    vary: Vary
    world: str
    variable: Mapping[str, Mapping[str, Mapping[str, int]]]
    boxes: Mapping[str, ObjectBox] = field(default_factory=dict)
    pivots_w: Mapping[str, Array] = field(default_factory=dict)
    skipped: dict[str, int] = field(default_factory=dict)

    def settings(self) -> dict[str, dict[str, dict[str, Any]]]:
        """Return the values by kind and name; of two patterns that match, the later one's."""
        found: dict[str, dict[str, dict[str, Any]]] = {}
        for kind, rules in self.vary.rules.items():
            by_name: dict[str, dict[str, Any]] = {}
            for pattern, settings in rules.items():
                known = self.variable.get(kind, {})
                matching = [name for name in known if name == pattern or fnmatchcase(name, pattern)]
                if COMMAND in settings:
                    matching = [pattern]
                elif pattern not in matching:
                    able = [name for name in matching if settings.keys() <= known[name].keys()]
                    self.skipped[f"{kind}.{pattern}"] = len(matching) - len(able)
                    matching = able
                if not matching:
                    got = f"got none; it has {shown(', '.join(known) or 'none')}"
                    raise ArgumentError(f"vary.{kind}.{pattern}: expected {kind} of the source, {got}")
                for name in matching:
                    if COMMAND not in settings:
                        _check_sizes(f"vary.{kind}.{name}", settings, known[name])
                    by_name.setdefault(name, {}).update(settings)
            found[kind] = dict(sorted(by_name.items()))
        return found

    def of(self, key: str) -> dict[str, dict[str, dict[str, Any]]]:
        """Return what is drawn for a frame, a place, or the empty key of a world: by kind, name and
        setting."""
        drawn: dict[str, dict[str, dict[str, Any]]] = {}
        for kind, by_name in self.settings().items():
            for name, settings in by_name.items():
                values = self._draw(kind, name, name, settings, key)
                if COMMAND in settings:
                    values[COMMAND] = _command(name, values)
                drawn.setdefault(kind, {})[name] = values
        self._keep_apart(drawn.get("objects", {}), key)
        return drawn

    def _draw(
        self, kind: str, name: str, draw_name: str, settings: Mapping[str, Any], key: str
    ) -> dict[str, Any]:
        u = {setting: self.vary.u(self.world, f"{kind}.{setting}", draw_name, key) for setting in settings}
        values = {name: draw(value, u[name]) for name, value in settings.items() if name != "clearance"}
        if kind == "objects" and "shown" in values:
            values["shown"] = u["shown"]("") < values["shown"]
        return values

    def _keep_apart(self, objects: dict[str, dict[str, Any]], key: str) -> None:
        """Draw places of objects with a clearance again, until they have it.

        Boxes along the world's axes are compared: with those of objects placed before, and with those of all
        others that are as far away at rest, so that an object may stand on a floor.
        """
        settings = self.settings().get("objects", {})
        wanted = {name: of["clearance"] for name, of in settings.items() if of.get("clearance")}
        placed = {
            name: self._extent(name, objects.get(name, {}))
            for name in self.boxes
            if name not in wanted and objects.get(name, {}).get("shown", True)
        }
        for name, clearance in wanted.items():
            if not objects[name].get("shown", True):
                continue
            if name not in self.boxes:
                raise ArgumentError(f"vary.objects.{name}: expected an object whose box the source knows")
            rest = self._extent(name, {})
            others = {
                other: extent
                for other, extent in placed.items()
                if other in wanted or _distance(rest, self._extent(other, {})) >= clearance
            }
            for attempt in range(1, _DRAWS + 1):
                here = self._extent(name, objects[name])
                if all(
                    _distance(here, extent) >= max(clearance, wanted.get(other, 0))
                    for other, extent in others.items()
                ):
                    break
                if attempt == _DRAWS:
                    got = f"expected a free place, got none in {_DRAWS} draws"
                    raise ArgumentError(f"vary.objects.{name}: {got}; give a smaller clearance")
                again = self._draw("objects", name, f"{name}#{attempt}", settings[name], key)
                objects[name] |= {what: again[what] for what in ("shift", "turn_deg") if what in again}
            placed[name] = here

    def _extent(self, name: str, settings: Mapping[str, Any]) -> tuple[Array, Array]:
        """Return the least and the greatest corner of an object's box as it was drawn, along world axes."""
        box = self.boxes[name]
        pivot = self.pivots_w.get(name, box.center_w)
        turned = (box.corners_w() - pivot) @ turn_about_z(settings.get("turn_deg", 0.0)).T
        corners = turned + pivot + np.asarray(settings.get("shift", (0, 0, 0)))
        return corners.min(axis=0), corners.max(axis=0)


def _check_sizes(where: str, settings: Mapping[str, Any], known: Mapping[str, int]) -> None:
    """Refuse a setting that a source does not have, and a value of another number of components."""
    for setting, value in settings.items():
        count = np.size(draw(value, lambda _: 0.0))
        if setting not in known:
            raise ArgumentError(f"{where}: expected one of {', '.join(known)}; got {shown(setting)}")
        if count != known[setting]:
            raise ArgumentError(f"{where}.{setting}: expected {known[setting]} numbers, got {count}")


def _distance(a: tuple[Array, Array], b: tuple[Array, Array]) -> float:
    """Return the distance between two boxes along the world's axes; 0 where they touch."""
    return float(np.linalg.norm(np.maximum(0, np.maximum(a[0] - b[1], b[0] - a[1]))))
