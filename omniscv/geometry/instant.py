"""The world at one instant: where its moving objects are, and which objects are hidden."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from types import MappingProxyType
from typing import Any, Self

from omniscv.arguments import Reader, fields, numbers, optional_number, shown, text, texts
from omniscv.errors import ArgumentError
from omniscv.geometry.pose import Pose

_DECIMALS = 7
"""Of metres and matrix entries: what servers are sent has three decimals of a centimetre."""


@dataclass(frozen=True, eq=False)
class Instant:
    """What was set in a world that moves, or was read back from it.

    Attributes:
        poses: by object, from the object's frame to the world: its position, and ``R_w_o``, the identity for
            an object that is turned as the engine's axes are (X forward, Y left, Z up in our frame).
        hidden: names of objects that are not shown.
        time: seconds on the scene's own clock; None where it is not known, or nothing follows it.
        name: of a state that neither poses nor time describe, such as of a light.
    """

    poses: Mapping[str, Pose] = field(default_factory=lambda: MappingProxyType({}))
    hidden: frozenset[str] = frozenset()
    time: float | None = None
    name: str = ""

    @property
    def state(self) -> str:
        """The state of the world by which requests, plans and recordings tell instants apart.

        Empty for a world in which nothing was changed, so that it is the one state of a world that is still;
        else 16 hexadecimal digits of a hash of all that is known. Equal instants have equal states in every
        process: a job that is replayed computes the states of its recording.
        """
        if not (self.poses or self.hidden or self.name) and self.time is None:
            return ""
        poses = {name: _numbers(pose) for name, pose in self.poses.items()}
        known = [poses, sorted(self.hidden), None if self.time is None else round(self.time, 9), self.name]
        return hashlib.sha256(json.dumps(known, sort_keys=True).encode()).hexdigest()[:16]

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        poses = {name: self.poses[name].to_dict() for name in sorted(self.poses)}
        return {"poses": poses, "hidden": sorted(self.hidden), "time": self.time, "name": self.name}

    @classmethod
    def from_dict(cls, data: object) -> Self:
        """Return the inverse of :meth:`to_dict`; ArgumentError for anything else."""
        found = fields("", data, _FIELDS, needed=tuple(_FIELDS))
        return cls(MappingProxyType(found["poses"]), found["hidden"], found["time"], found["name"])


def _poses(name: str, value: object) -> dict[str, Pose]:
    if not isinstance(value, Mapping):
        raise ArgumentError(f"{name}: expected a mapping of object names to poses, got {shown(value)}")
    return {text(name, key): _pose(f"{name}: {shown(key)}", each) for key, each in value.items()}


def _pose(name: str, value: object) -> Pose:
    found = fields(name, value, _POSE, needed=tuple(_POSE))
    return Pose(found["position"], found["rotation"])


def _hidden(name: str, value: object) -> frozenset[str]:
    return frozenset(texts(name, value) if value else ())


def _name(name: str, value: object) -> str:
    return text(name, value) if value else ""


_POSE = {"position": partial(numbers, shape=(3,)), "rotation": partial(numbers, shape=(3, 3))}
_FIELDS: Mapping[str, Reader] = {"poses": _poses, "hidden": _hidden, "time": optional_number, "name": _name}


def _numbers(pose: Pose) -> list[float]:
    return [round(float(x), _DECIMALS) + 0.0 for x in (*pose.position, *pose.rotation.ravel())]
