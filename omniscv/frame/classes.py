"""Semantic classes of objects, by their names."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import translate
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import flag, label, one_of, shown, text, whole_number, within
from omniscv.errors import ArgumentError, UnmatchedNamesError
from omniscv.records import checked, listed, nested, read, record
from omniscv.storage import bounded

Unmatched = Literal["error", "other", "ignore"]

BACKGROUND = 0
"""The class of pixels without an object, or of an object without a class."""

_MOST = np.iinfo(np.uint16).max
_OTHER = {"nyu40": "otherprop"}
"""By taxonomy, the class of objects that no rule matches; ``other`` elsewhere."""


@dataclass(frozen=True)
class SemanticClass:
    """A class that objects belong to.

    Attributes:
        id: of its pixels in class maps, 1 to 65535; 0 is the background.
        name: unique.
        supercategory: a broader word; empty if none.
        stuff: whether it is background without instances, such as walls.
    """

    id: int
    name: str
    supercategory: str = ""
    stuff: bool = False


@dataclass(frozen=True)
class ClassTable:
    """The classes of a dataset, and the class of every object.

    Attributes:
        classes: by name, in the order of their ids.
        of_object: object name to class name; objects without a class are left out.
        taxonomy: the name of a table that is shipped, or ``custom``.
    """

    classes: Mapping[str, SemanticClass]
    of_object: Mapping[str, str]
    taxonomy: str = "custom"

    def of(self, name: str) -> SemanticClass | None:
        """Return the class of an object; None without one."""
        class_name = self.of_object.get(name)
        return None if class_name is None else self.classes[class_name]

    def ids(self, instances: Mapping[str, int]) -> NDArray[np.uint16]:
        """Return (65536,) the class id of every instance id, of its name; ``BACKGROUND`` without a class."""
        class_of = np.full(_MOST + 1, BACKGROUND, np.uint16)
        for name, instance in instances.items():
            if (semantic := self.of(name)) is not None:
                class_of[instance] = semantic.id
        return class_of


def _regex(name: str, value: object) -> str:
    try:
        re.compile(text(name, value))
    except (re.error, OverflowError, RecursionError) as cause:
        raise ArgumentError(f"{name}: expected a regular expression, got {shown(value)}: {cause}") from cause
    return str(value)


@record
class Rule:
    """A class, and a pattern of the whole names of its objects, case-sensitive.

    The pattern is ``match``, with ``*``, ``?`` and ``[...]`` as in file names, or ``regex``. The other keys
    describe the class, and may be left out.
    """

    class_name: str = checked(label, key="class")
    match: str = checked(text, default="")
    regex: str = checked(_regex, default="")
    id: int | None = checked(whole_number, least=1, most=_MOST, default=None)
    supercategory: str | None = checked(
        lambda name, value: value if value == "" else label(name, value), default=None
    )
    stuff: bool | None = checked(flag, default=None)

    def __post_init__(self) -> None:
        if bool(self.match) == bool(self.regex):
            rule = {"class": self.class_name, "match": self.match, "regex": self.regex}
            raise ArgumentError(f"expected one of 'match' and 'regex', got {shown(rule)}")

    @cached_property
    def _compiled(self) -> re.Pattern[str]:
        return re.compile(self.regex or translate(self.match))

    def matches(self, name: str) -> bool:
        """Return whether an object is of the class."""
        return self._compiled.fullmatch(name) is not None

    def to_dict(self) -> dict[str, Any]:
        """Return its keys as plain values."""
        pattern = {"regex": self.regex} if self.regex else {"match": self.match}
        about = {"id": self.id, "supercategory": self.supercategory, "stuff": self.stuff}
        return {**pattern, "class": self.class_name, **about}


def _rules(name: str, value: object) -> tuple[Rule, ...]:
    if not isinstance(value, list | tuple) or not value:
        raise ArgumentError(f"{name}: expected a list of {{match: PATTERN, class: NAME}}, got {shown(value)}")
    rules: tuple[Rule, ...] = listed(nested(Rule))(name, value)
    return rules


@record
class ClassRules:
    """Classes, and rules that give object names a class, as in ``classes.yaml``. The first match wins::

        taxonomy: nyu40            # or custom
        background: 0
        rules:
          - {match: "Layout_Wall_*", class: wall, id: 1, stuff: true}
          - {regex: "(Chair|Stool)_\\d+", class: chair, supercategory: furniture}
        unmatched: error           # error, other or ignore

    Objects that no rule matches are an error, of the class ``other``, or of no class. A class without an id
    has that of the taxonomy, else the next free one from 1, in the order of rules. ``rules`` are completed by
    all that is known of their classes.
    """

    rules: tuple[Rule, ...] = checked(_rules)
    taxonomy: str = checked(
        lambda name, value: one_of(name, value, ("custom", *taxonomies())), default="custom"
    )
    background: int = checked(whole_number, least=BACKGROUND, most=BACKGROUND, default=BACKGROUND)
    unmatched: Unmatched = checked(one_of, words=get_args(Unmatched), default="error")

    def __post_init__(self) -> None:
        rules = []
        for rule in self.rules:
            described = self.classes[rule.class_name]
            rules.append(
                replace(
                    rule,
                    id=described.id,
                    supercategory=described.supercategory,
                    stuff=described.stuff,
                )
            )
        vars(self)["rules"] = tuple(rules)

    @cached_property
    def classes(self) -> dict[str, SemanticClass]:
        """The classes by name, in the order of their ids."""
        known: dict[str, int] = {}
        if self.taxonomy != "custom":
            table = files("omniscv.frame") / "taxonomies" / f"{self.taxonomy}.csv"
            for line in table.read_text(encoding="utf-8").splitlines()[1:]:
                number, name = line.split(",", 1)
                known[name] = int(number)
        described = _describe(self.rules, known)
        if self.unmatched == "other":
            name = _OTHER.get(self.taxonomy, "other")
            described.setdefault(name, {"id": known[name]} if known else {})
        return _number_classes(described)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values that :func:`class_rules` reads."""
        return {
            "taxonomy": self.taxonomy,
            "background": BACKGROUND,
            "rules": [rule.to_dict() for rule in self.rules],
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
        class_names: dict[str, str] = {}
        unmatched = []
        for name in names:
            class_name = self.class_of(name)
            if class_name is None:
                unmatched.append(name)
            else:
                class_names[name] = class_name
        if unmatched and self.unmatched == "error":
            raise UnmatchedNamesError(unmatched)
        return ClassTable(self.classes, class_names, self.taxonomy)


def class_rules(classes: str | Path | Mapping[str, Any] | ClassRules) -> ClassRules:
    """Return the rules of a ``classes.yaml``, given by its path or its content."""
    if isinstance(classes, ClassRules):
        return classes
    if isinstance(classes, Mapping):
        with within("classes"):
            return read(ClassRules, classes)
    if not isinstance(classes, str | Path):
        raise ArgumentError(f"classes: expected a file, or a mapping with 'rules', got {shown(classes)}")
    with within(classes):
        return read(ClassRules, bounded.parse_yaml(bounded.read_text(Path(classes))))


def taxonomies() -> tuple[str, ...]:
    """Return the names of the tables that are shipped."""
    folder = files("omniscv.frame") / "taxonomies"
    return tuple(sorted(file.name.removesuffix(".csv") for file in folder.iterdir()))


def _describe(rules: Sequence[Rule], known: Mapping[str, int]) -> dict[str, dict[str, Any]]:
    """By class name, the fields that rules give; ArgumentError for contradictions."""
    described: dict[str, dict[str, Any]] = {}
    for i, rule in enumerate(rules):
        with within(f"rules[{i}]"):
            name = rule.class_name
            if known:
                one_of("class", name, known)
            values = described.setdefault(name, {"id": known[name]} if known else {})
            for key in ("id", "supercategory", "stuff"):
                value = getattr(rule, key)
                if value is not None and value != values.setdefault(key, value):
                    expected = f"expected {shown(values[key])} for class {name!r}"
                    raise ArgumentError(f"{key}: {expected}, got {shown(value)}")
    return described


def _number_classes(described: Mapping[str, dict[str, Any]]) -> dict[str, SemanticClass]:
    """Return the classes by name, in the order of their ids; one without an id gets the next free one.

    ArgumentError: two classes have the same id.
    """
    owners: dict[int, str] = {}
    for name, fields in described.items():
        if "id" not in fields:
            continue
        owner = owners.setdefault(fields["id"], name)
        if owner != name:
            expected = f"expected one class for every id, {fields['id']} is {owner!r}"
            raise ArgumentError(f"rules: {expected}; got {name!r} too")
    free_ids = iter(id_ for id_ in range(1, _MOST + 1) if id_ not in owners)
    classes = []
    for name, fields in described.items():
        id_ = fields["id"] if "id" in fields else next(free_ids)
        classes.append(SemanticClass(**{"name": name, **fields, "id": id_}))
    classes.sort(key=lambda semantic_class: semantic_class.id)
    return {semantic_class.name: semantic_class for semantic_class in classes}
