"""The world at one instant: where its moving objects are, and which objects are hidden."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

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


def _numbers(pose: Pose) -> list[float]:
    return [round(float(x), _DECIMALS) + 0.0 for x in (*pose.position, *pose.rotation.ravel())]
