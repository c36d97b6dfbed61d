"""The parameters of a lens as one ordered list of numbers: focal lengths, centre, distortion.

Each lens declares its list, as COLMAP's models do. Calibration files, fits and ``omniscv cameras NAME``
follow from it: :mod:`omniscv.calibration` reads and writes the numbers by name.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from omniscv.arguments import wrong

Numbers = dict[str, float]
NEUTRAL = {"c": 1.0, "lc": 1.0, "most": 180.0}
"""Numbers that are not 0 where nothing is said."""


class Argument(NamedTuple):
    """An argument of a constructor.

    Attributes:
        name: of the argument.
        names: of its numbers; ``focal`` is fx and fy, which are equal.
        ends: whether zeros at the end are left out.
    """

    name: str
    names: tuple[str, ...]
    ends: bool = False

    @classmethod
    def of(cls, text: str) -> Argument:
        """Return the argument of ``fx``, ``k=k1,k2``, or ``polynomial=c0..c5``, which may end earlier."""
        name, _, names = text.partition("=")
        series = re.fullmatch(r"([a-z]+)0\.\.\1(\d+)", names)
        if series:
            return cls(name, tuple(f"{series[1]}{i}" for i in range(int(series[2]) + 1)), True)
        return cls(name, ("fx", "fy") if name == "focal" else tuple((names or name).split(",")))

    def __str__(self) -> str:
        is_one = self.name == "focal" or len(self.names) == 1
        return self.name if is_one else f"{self.name} = ({', '.join(self.names)})"


class Parameters(NamedTuple):
    """The numbers of a lens, in order, by group and by argument of its constructor."""

    focal: tuple[Argument, ...] = ()
    center: tuple[Argument, ...] = ()
    distortion: tuple[Argument, ...] = ()

    @classmethod
    def of(cls, text: str) -> Parameters:
        """Return the parameters of ``fx fy | cx cy | skew k=k1,k2,k3,k4``."""
        groups = []
        for group in text.split("|"):
            groups.append(tuple(map(Argument.of, group.split())))
        return cls(*groups)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all numbers."""
        names: list[str] = []
        for argument in chain(*self):
            names += argument.names
        return tuple(names)

    def __str__(self) -> str:
        groups = []
        for title, arguments in zip(("focal lengths", "centre", "distortion"), self, strict=True):
            if arguments:
                groups.append(f"{title} {', '.join(map(str, arguments))}")
        return "; ".join(groups)

    def numbers(self, camera: object) -> Numbers | None:
        """Return the numbers of a camera by name; None if it has more than there are names."""
        numbers: Numbers = {}
        for name, names, _ in chain(*self):
            value = getattr(camera, name)
            values = np.ravel(NEUTRAL[names[0]] if value is None else value).tolist()
            if any(values[len(names) :]):
                return None
            numbers |= zip(names, values * 2 if name == "focal" else values, strict=False)
        return numbers

    def arguments(self, numbers: Mapping[str, float]) -> dict[str, Any]:
        """Return the arguments of numbers by name; those missing are neutral.

        Raises:
            ArgumentError: two focal lengths for a lens that has one.
        """
        arguments: dict[str, Any] = {}
        for name, names, ends in chain(*self):
            values = [numbers.get(key, NEUTRAL.get(key, 0.0)) for key in names]
            if name == "focal" and values[0] != values[1]:
                wanted = "two that are equal (our division model stretches no axis)"
                raise wrong("focal lengths", wanted, values)
            while ends and len(values) > 1 and not values[-1]:
                values.pop()
            arguments[name] = values[0] if name == "focal" or len(names) == 1 else values
        return arguments
