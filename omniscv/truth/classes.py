"""Semantic classes of objects, by their names."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from fnmatch import translate
from functools import cached_property, partial
from importlib.resources import files
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import Reader, fields, flag, one_of, shown, text, whole_number, within
from omniscv.errors import ArgumentError, UnmatchedNamesError

Unmatched = Literal["error", "other", "ignore"]

BACKGROUND = 0
"""The class of pixels that show no object, or one without a class."""

_MOST = np.iinfo(np.uint16).max
_OTHER = {"nyu40": "otherprop"}
"""The class of a taxonomy for objects that no rule matches; ``other`` elsewhere."""


@dataclass(frozen=True)
class SemanticClass:
    """A class that objects belong to.

    Attributes:
        id: of its pixels in class maps, 1 to 65535; 0 is the background.
        name: unique.
        supercategory: a broader word; empty if none.
        stuff: whether it is background that is not counted, such as walls.
    """

    id: int
    name: str
    supercategory: str = ""
    stuff: bool = False


@dataclass(frozen=True)
class ClassTable:
    """The classes of a dataset, and the class of every object: frozen when the dataset is begun.

    Attributes:
        classes: by name, in the order of their ids.
        of_object: object name to class name; objects without a class are left out.
        taxonomy: the name of a known table, or ``custom``.
    """

    classes: Mapping[str, SemanticClass]
    of_object: Mapping[str, str]
    taxonomy: str = "custom"

    def of(self, name: str) -> SemanticClass | None:
        """Return the class of an object; None without one."""
        found = self.of_object.get(name)
        return None if found is None else self.classes[found]

    def ids(self, instances: Mapping[str, int]) -> NDArray[np.uint16]:
        """Return (65536,) the class id of every instance id; ``BACKGROUND`` where there is none.

        Args:
            instances: object name to instance id.
        """
        class_of = np.full(_MOST + 1, BACKGROUND, np.uint16)
        for name, instance in instances.items():
            if (found := self.of(name)) is not None:
                class_of[instance] = found.id
        return class_of


@dataclass(frozen=True)
class Rule:
    """Objects whose whole name a pattern matches, case-sensitive, are of a class.

    Attributes:
        pattern: ``*``, ``?`` and ``[...]`` as in file names, or a regular expression.
        class_name: of :class:`ClassRules`.
        regex: whether the pattern is a regular expression.
    """

    pattern: str
    class_name: str
    regex: bool = False

    @cached_property
    def _compiled(self) -> re.Pattern[str]:
        return re.compile(self.pattern if self.regex else translate(self.pattern))

    def matches(self, name: str) -> bool:
        """Return whether an object is of the class."""
        return self._compiled.fullmatch(name) is not None


@dataclass(frozen=True)
class ClassRules:
    """What ``classes.yaml`` says: classes, and rules that give every object name one; the first match wins.

    Attributes:
        classes: by name, in the order of their ids.
        rules: in their order.
        unmatched: what becomes of objects that no rule matches: an error, the class ``other``, or no class.
        taxonomy: the name of a known table, or ``custom``.
    """

    classes: Mapping[str, SemanticClass]
    rules: tuple[Rule, ...]
    unmatched: Unmatched = "error"
    taxonomy: str = "custom"

    @classmethod
    def from_dict(cls, data: object) -> ClassRules:
        """Return the rules that plain values describe::

            taxonomy: nyu40            # or custom
            background: 0
            rules:
              - {match: "Layout_Wall_*", class: wall, id: 1, stuff: true}
              - {regex: "(Chair|Stool)_\\d+", class: chair, supercategory: furniture}
            unmatched: error           # error, other or ignore

        A class without an id has that of the taxonomy, else the next free one from 1, in the order of rules.

        Raises:
            ArgumentError: an unknown field, a pattern that is none, an id of two classes, a class that the
                taxonomy does not have, or a class that two rules describe differently.
        """
        given = fields("", data, _FIELDS, needed=("rules",))
        taxonomy, unmatched = given.get("taxonomy", "custom"), given.get("unmatched", "error")
        known = {} if taxonomy == "custom" else _taxonomy(taxonomy)
        described: dict[str, dict[str, Any]] = {}
        for i, entry in enumerate(given["rules"]):
            with within(f"rules[{i}]"):
                _describe(described, entry, known)
        if unmatched == "other":
            name = _OTHER.get(taxonomy, "other")
            described.setdefault(name, {"id": known[name]} if known else {})
        rules = tuple(
            Rule(entry.get("regex", entry.get("match")), entry["class"], "regex" in entry)
            for entry in given["rules"]
        )
        return cls(_numbered(described), rules, unmatched, taxonomy)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values that :meth:`from_dict` reads."""
        return {
            "taxonomy": self.taxonomy,
            "background": BACKGROUND,
            "rules": [
                {"regex" if rule.regex else "match": rule.pattern, "class": rule.class_name}
                | {
                    key: value
                    for key, value in asdict(self.classes[rule.class_name]).items()
                    if key != "name"
                }
                for rule in self.rules
            ],
            "unmatched": self.unmatched,
        }

    def class_of(self, name: str) -> str | None:
        """Return the class of an object: of the first rule that matches, else ``other``; None without one."""
        other = _OTHER.get(self.taxonomy, "other") if self.unmatched == "other" else None
        return next((rule.class_name for rule in self.rules if rule.matches(name)), other)

    def table(self, names: Iterable[str]) -> ClassTable:
        """Return the classes of objects.

        Raises:
            UnmatchedNamesError: no rule matches some names, and ``unmatched`` is ``error``.
        """
        found = {name: self.class_of(name) for name in names}
        unmatched = [name for name, class_name in found.items() if class_name is None]
        if unmatched and self.unmatched == "error":
            raise UnmatchedNamesError(unmatched)
        of_object = {name: class_name for name, class_name in found.items() if class_name is not None}
        return ClassTable(self.classes, of_object, self.taxonomy)


def taxonomies() -> tuple[str, ...]:
    """Return the names of the tables that are shipped."""
    folder = files("omniscv.truth") / "taxonomies"
    return tuple(sorted(each.name.removesuffix(".csv") for each in folder.iterdir()))


def _taxonomy(name: str) -> dict[str, int]:
    """Class name to id, of a table of lines ``id,name``."""
    text = (files("omniscv.truth") / "taxonomies" / f"{name}.csv").read_text(encoding="utf-8")
    return {line.partition(",")[2]: int(line.partition(",")[0]) for line in text.splitlines()[1:]}


def _describe(
    described: dict[str, dict[str, Any]], entry: Mapping[str, Any], known: Mapping[str, int]
) -> None:
    """Add what a rule says of its class to what is known of it."""
    name = entry["class"]
    if ("match" in entry) == ("regex" in entry):
        raise ArgumentError(f"expected one of 'match' and 'regex', got {shown(dict(entry))}")
    if known and name not in known:
        raise ArgumentError(f"class: expected one of {', '.join(known)}; got {shown(name)}")
    said = {key: value for key, value in entry.items() if key in ("id", "supercategory", "stuff")}
    if known:
        said = {"id": known[name], **said}
    before = described.setdefault(name, dict(said))
    for key, value in said.items():
        wanted = known[name] if known and key == "id" else before.get(key, value)
        if value != wanted:
            raise ArgumentError(f"{key}: expected {shown(wanted)} for class {name!r}, got {shown(value)}")
    before.update(said)


def _numbered(described: Mapping[str, dict[str, Any]]) -> dict[str, SemanticClass]:
    """Classes by name in the order of their ids; those without an id get the next free one."""
    owners: dict[int, str] = {}
    for name, said in described.items():
        if "id" in said and owners.setdefault(said["id"], name) != name:
            wanted = f"expected one class for every id, {said['id']} is {owners[said['id']]!r}"
            raise ArgumentError(f"rules: {wanted}; got {name!r} too")
    free = iter(number for number in range(1, _MOST + 1) if number not in owners)
    found = [
        SemanticClass(
            said["id"] if "id" in said else next(free),
            name,
            said.get("supercategory", ""),
            said.get("stuff", False),
        )
        for name, said in described.items()
    ]
    return {each.name: each for each in sorted(found, key=lambda each: each.id)}


# -- the fields of classes.yaml: each is read by a function (name, value) --------------------------------


def _rules(name: str, value: object) -> list[dict[str, Any]]:
    if not isinstance(value, list) or not value:
        wanted = "expected a list of {match: PATTERN, class: NAME}"
        raise ArgumentError(f"{name}: {wanted}, got {shown(value)}")
    return [fields(f"{name}[{i}]", each, _RULE, needed=("class",)) for i, each in enumerate(value)]


def _regex(name: str, value: object) -> str:
    try:
        re.compile(text(name, value))
    except (re.error, OverflowError, RecursionError) as cause:
        raise ArgumentError(f"{name}: expected a regular expression, got {shown(value)}: {cause}") from cause
    return str(value)


def _known_taxonomy(name: str, value: object) -> Any:
    return one_of(name, value, ("custom", *taxonomies()))


_RULE: dict[str, Reader] = {
    "match": text,
    "regex": _regex,
    "class": text,
    "id": partial(whole_number, least=1, most=_MOST),
    "supercategory": lambda name, value: value if value == "" else text(name, value),
    "stuff": flag,
}
_FIELDS: dict[str, Reader] = {
    "taxonomy": _known_taxonomy,
    "background": partial(whole_number, least=BACKGROUND, most=BACKGROUND),
    "rules": _rules,
    "unmatched": partial(one_of, words=get_args(Unmatched)),
}
