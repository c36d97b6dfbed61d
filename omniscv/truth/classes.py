"""Semantic classes of objects, by their names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


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
