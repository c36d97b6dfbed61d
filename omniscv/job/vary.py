"""The key ``vary`` of a job: what of the world is drawn anew for each frame, place or world (docs/worlds.md).

**A draw depends only on what it is for**: it is a hash of the seed, the world, the setting, the object, and
the frame or place. So neither shards nor the order of frames nor further rules change it.
"""

import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
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
_DRAWS = 50  # of an object's place, until it has its clearance
_LEAST_U = 2.0**-54  # a normal distribution has no value at 0


def uniform(seed: int, world: str, path: str, name: str, key: str) -> float:
    """Return a number in [0, 1) with 53 random bits, of the SHA-256 of the arguments as compact JSON.

    Args:
        seed: of all draws.
        world: the name of the world; empty in a job with one source.
        path: kind and setting, such as ``objects.shift``, with ``.0``, ``.1``, ``.2`` for a component.
        name: of the object, light, material or camera.
        key: of the frame or the place; empty for a world.
    """
    text = json.dumps([seed, world, path, name, key], separators=(",", ":"), ensure_ascii=False)
    return (int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big") >> 11) * 2.0**-53


def draw(value: Any, u: Callable[[str], float]) -> Any:
    """Return what is drawn for a ``value`` as :func:`read_value` returns it.

    ``u`` returns the number in [0, 1) of a component: ``""``, or ``.0``, ``.1``, ``.2`` of a vector.
    """
    if not isinstance(value, dict | list):
        return value
    if isinstance(value, list):
        low, high = value
        return low + u("") * (high - low)
    ((word, parameters),) = value.items()
    if word == "box":
        low, high = parameters
        return [low[axis] + u(f".{axis}") * (high[axis] - low[axis]) for axis in range(len(low))]
    if word == "choice":
        return parameters[math.floor(u("") * len(parameters))]
    if word == "log":
        low, high = parameters
        return low * (high / low) ** u("")
    mean, sigma = parameters
    return NormalDist(mean, sigma).inv_cdf(max(u(""), _LEAST_U))


def read_value(name: str, value: object) -> Any:
    """Return a ``value`` of a rule as plain numbers and lists: a number, ``[low, high]``, or a mapping.

    ArgumentError, which begins with ``name``, for anything else.
    """
    if (isinstance(value, list) and len(value) == 2) or isinstance(value, tuple):
        return _range(name, value)
    if not isinstance(value, Mapping):
        return number(f"{name}, if not [low, high] or a mapping", value)
    if len(value) != 1:
        raise ArgumentError(f"{name}: expected one of log, normal, choice, box; got {shown(list(value))}")
    ((word, parameters),) = value.items()
    where = f"{name}.{one_of(name, word, tuple(_READERS))}"
    return {word: _READERS[word](where, parameters)}


def _choice(where: str, value: Any) -> list[Any]:
    """Read the numbers, or vectors of one length, of which one is chosen."""
    if not isinstance(value, list) or not value:
        raise ArgumentError(f"{where}: expected a list of numbers or of vectors, got {shown(value)}")
    shape = (None, np.size(value[0])) if np.ndim(value[0]) else (None,)
    choices: list[Any] = numbers(where, value, shape).tolist()
    return choices


def _box(where: str, value: Any) -> list[list[float]]:
    """Read two corners of a box in which a vector lies."""
    low, high = numbers(where, value, (2, 3)).tolist()
    if np.greater(low, high).any():
        raise ArgumentError(f"{where}: expected corners in order, got {shown(value)}")
    return [low, high]


def _normal(where: str, value: Any) -> list[float]:
    """Read mean and standard deviation."""
    mean, sigma = numbers(where, value, (2,)).tolist()
    return [mean, number(f"{where}: sigma", sigma, above=0)]


def _log(where: str, value: Any) -> list[float]:
    """Read a range of numbers > 0, whose logarithm is drawn evenly."""
    low, high = _range(where, value)
    return [number(where, low, above=0), high]


_READERS: dict[str, Callable[[str, Any], list[Any]]] = {
    "log": _log,
    "normal": _normal,
    "choice": _choice,
    "box": _box,
}


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
        values: dict[str, Any] = {}
        for key, entry in known.items():
            read = text if key == COMMAND else read_value
            values[key] = read(f"{where}.{key}", entry)
        rules[pattern] = values
        if name == "objects":
            _check_object(where, values)
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
    values = {}
    for key, value in settings.items():
        if key != COMMAND:
            values[key] = f"{value:.6f}".rstrip("0").rstrip(".")
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
        """Return the descriptions of a job's ``cameras`` with the parameters that are drawn for a ``world``.

        Such cameras are named after it. ArgumentError: a rule is of no camera, or of one whose
        parameters are not in the job.
        """
        described = mapping("cameras", cameras)
        for name, rules in self.cameras.items():
            camera = described[one_of("vary.cameras", name, described)]
            if rules and (not isinstance(camera, Mapping) or "file" in camera):
                raise ArgumentError(f"vary.cameras.{name}: expected a camera with its parameters in the job")
        drawn = {}
        for name, camera in described.items():
            if name in self.cameras:
                drawn[f"{world}-{name}" if world else name] = self._drawn(name, camera, world)
            else:
                drawn[name] = camera
        return drawn

    def _drawn(self, name: str, camera: Any, world: str) -> Any:
        """Return the description of a camera with the parameters that are drawn for a world."""
        if not self.cameras[name]:
            return camera
        described = dict(camera)
        for key, rule in self.cameras[name].items():
            value = draw(rule, self.u(world, f"cameras.{key}", name, ""))
            described[key] = int(value) if value % 1 == 0 else value
        return described

    def u(self, world: str, path: str, name: str, key: str) -> Callable[[str], float]:
        """Return the function of :func:`draw` for a setting.

        Args:
            world: as of :func:`uniform`.
            path: as of :func:`uniform`, without a component.
            name: as of :func:`uniform`.
            key: as of :func:`uniform`.
        """
        return lambda part: uniform(self.seed, world, path + part, name, key)

    @property
    def rules(self) -> dict[str, Rules]:
        """The rules by kind, of those kinds that have rules."""
        rules = {}
        for kind in KINDS:
            if of_kind := getattr(self, kind):
                rules[kind] = of_kind
        return rules


Extent = tuple[Array, Array]
"""The least and the greatest corner of a box along the world's axes, (3,) metres each."""


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
            known = self.variable.get(kind, {})
            for pattern, settings in rules.items():
                for name in self._matching(kind, pattern, settings):
                    if COMMAND not in settings:
                        _check_sizes(f"vary.{kind}.{name}", settings, known[name])
                    by_name.setdefault(name, {}).update(settings)
            found[kind] = dict(sorted(by_name.items()))
        return found

    def _matching(self, kind: str, pattern: str, settings: Mapping[str, Any]) -> list[str]:
        """Return the names in the source that a rule is for, and count those that it skips.

        A command is for the pattern itself. A pattern that is a name is for it, and others that it matches;
        else it skips names that lack one of the settings. ArgumentError: it is for none.
        """
        if COMMAND in settings:
            return [pattern]
        known = self.variable.get(kind, {})
        matching = [name for name in known if name == pattern or fnmatchcase(name, pattern)]
        if pattern not in matching:
            able = [name for name in matching if settings.keys() <= known[name].keys()]
            self.skipped[f"{kind}.{pattern}"] = len(matching) - len(able)
            matching = able
        if not matching:
            present = shown(", ".join(known) or "none")
            raise ArgumentError(
                f"vary.{kind}.{pattern}: expected {kind} of the source, got none; it has {present}"
            )
        return matching

    def of(self, key: str) -> dict[str, dict[str, dict[str, Any]]]:
        """Return what is drawn for a frame, a place, or the empty key of a world: by kind, name and
        setting."""
        drawn: dict[str, dict[str, dict[str, Any]]] = {}
        for kind, by_name in self.settings().items():
            for name, settings in by_name.items():
                values = self._draw(kind, name, settings, key)
                if COMMAND in settings:
                    values[COMMAND] = _command(name, values)
                drawn.setdefault(kind, {})[name] = values
        self._keep_apart(drawn.get("objects", {}), key)
        return drawn

    def _draw(self, kind: str, draw_name: str, settings: Mapping[str, Any], key: str) -> dict[str, Any]:
        """Return the values of settings that are drawn by a name, for a frame or place."""
        values = {}
        for setting, rule in settings.items():
            if setting == "clearance":
                continue
            u = self.vary.u(self.world, f"{kind}.{setting}", draw_name, key)
            values[setting] = draw(rule, u)
            if kind == "objects" and setting == "shown":
                values[setting] = u("") < values[setting]
        return values

    def _keep_apart(self, objects: dict[str, dict[str, Any]], key: str) -> None:
        """Draw places of objects with a clearance again, until they have it.

        Boxes along the world's axes are compared: with those of objects placed before, and with those of all
        others that are as far away at rest, so that an object may stand on a floor.
        """
        settings = self.settings().get("objects", {})
        clearances = {}
        for name, of_object in settings.items():
            if of_object.get("clearance"):
                clearances[name] = of_object["clearance"]
        placed = {}
        for name in self.boxes:
            if name not in clearances and objects.get(name, {}).get("shown", True):
                placed[name] = self._extent(name, objects.get(name, {}))
        for name, clearance in clearances.items():
            if not objects[name].get("shown", True):
                continue
            if name not in self.boxes:
                raise ArgumentError(f"vary.objects.{name}: expected an object whose box the source knows")
            at_rest = self._extent(name, {})
            obstacles = []
            for other, extent in placed.items():
                if other in clearances:
                    obstacles.append((extent, max(clearance, clearances[other])))
                elif _distance(at_rest, self._extent(other, {})) >= clearance:
                    obstacles.append((extent, clearance))
            placed[name] = self._place(name, objects[name], settings[name], obstacles, key)

    def _place(
        self,
        name: str,
        values: dict[str, Any],
        settings: Mapping[str, Any],
        obstacles: Sequence[tuple[Extent, float]],
        key: str,
    ) -> Extent:
        """Draw the place of an object again until it is free, and return its extent there.

        Args:
            name: of the object.
            values: that are drawn for it; its place in them is replaced.
            settings: by which they are drawn.
            obstacles: extents, and how far away from each it must be, metres.
            key: of the frame or the place.
        """
        for attempt in range(1, _DRAWS + 1):
            extent = self._extent(name, values)
            if all(_distance(extent, other) >= clearance for other, clearance in obstacles):
                return extent
            if attempt < _DRAWS:
                again = self._draw("objects", f"{name}#{attempt}", settings, key)
                for setting in ("shift", "turn_deg"):
                    if setting in again:
                        values[setting] = again[setting]
        wanted = f"expected a free place, got none in {_DRAWS} draws"
        raise ArgumentError(f"vary.objects.{name}: {wanted}; give a smaller clearance")

    def _extent(self, name: str, settings: Mapping[str, Any]) -> Extent:
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


def _distance(first: Extent, second: Extent) -> float:
    """Return the distance between two boxes along the world's axes, metres; 0 where they touch."""
    first_low, first_high = first
    second_low, second_high = second
    gaps = np.maximum(first_low - second_high, second_low - first_high)
    return float(np.linalg.norm(np.maximum(0, gaps)))
