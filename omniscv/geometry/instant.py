"""The state of the world at one instant: poses of moving objects, and objects that are hidden."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from functools import cached_property
from typing import Any, Self

from omniscv.arguments import optional_number, text, texts
from omniscv.geometry.pose import Pose
from omniscv.records import checked, named, nested, read, record

_DECIMALS = 7
"""Of metres and matrix entries in ``state``: servers are sent three decimals of a centimetre."""


def _hidden(name: str, value: Any) -> frozenset[str]:
    return frozenset(texts(name, list(value) if isinstance(value, frozenset) else value) if value else ())


def _name(name: str, value: Any) -> str:
    return text(name, value) if value else ""


@record(eq=False)
class Instant:
    """What was set in a moving world, or was read back from it.

    Attributes:
        poses: by object, from the object's frame to the world: its position, and ``R_w_o``, the identity for
            an object that is turned as the engine's axes are (X forward, Y left, Z up in our frame).
        hidden: names of objects that are not shown.
        time: seconds on the scene's own clock; None if it is unknown or nothing depends on it.
        name: of a state that neither poses nor time describe, such as a light's.
    """

    poses: Mapping[str, Pose] = checked(named(nested(Pose)), default_factory=dict)
    hidden: frozenset[str] = checked(_hidden, default=frozenset())
    time: float | None = checked(optional_number, default=None)
    name: str = checked(_name, default="")

    @cached_property
    def state(self) -> str:
        """The key by which requests, plans and recordings tell states of the world apart.

        Empty for an unchanged world, so that a still world has one state; else 16 hexadecimal digits of a
        hash of all fields. Equal instants have equal states in every process, so a replayed job computes the
        states of its recording.
        """
        if not (self.poses or self.hidden or self.name) and self.time is None:
            return ""
        poses = {
            name: [round(float(x), _DECIMALS) + 0.0 for x in (*pose.position, *pose.rotation.ravel())]
            for name, pose in self.poses.items()
        }
        fields = [poses, sorted(self.hidden), None if self.time is None else round(self.time, 9), self.name]
        return hashlib.sha256(json.dumps(fields, sort_keys=True).encode()).hexdigest()[:16]

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        poses = {name: self.poses[name].to_dict() for name in sorted(self.poses)}
        return {"poses": poses, "hidden": sorted(self.hidden), "time": self.time, "name": self.name}

    @classmethod
    def from_dict(cls, data: object) -> Self:
        """Return the instant that :meth:`to_dict` described; ArgumentError for anything else."""
        return read(cls, data)
