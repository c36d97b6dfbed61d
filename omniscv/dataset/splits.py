"""Which split a frame is in: all frames of a place are in one, so that neighbours never straddle two."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from omniscv.arguments import Reader, fields, number, one_of, shown, whole_number
from omniscv.dataset.manifest import check_key
from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.geometry.clusters import cluster_starts

_SHARES = 1e-6  # how far their sum may be off 1


@dataclass(frozen=True)
class Split:
    """How places are shared among splits, by a hash of their names: others that come later move none.

    Attributes:
        shares: split to its share of the places; their sum is 1.
        distance_m: poses that are at most that far from each other are of one place, and so are those that a
            chain of such poses joins. Poses with a place of their own are of that place alone.
        seed: another one shares them otherwise.
    """

    shares: Mapping[str, float]
    distance_m: float = 0.5
    seed: int = 0

    @classmethod
    def read(cls, name: str, value: object) -> Split:
        """Return the split that a mapping describes: ``{train: 0.8, val: 0.2, by: place, seed: 0}``.

        Raises:
            ArgumentError: no mapping, shares that are not 1 together, or another field that is wrong.
        """
        if not isinstance(value, Mapping):
            raise ArgumentError(f"{name}: expected a mapping from split to share, got {shown(value)}")
        shares = {key: partial(number, least=0, most=1) for key in value if key not in _OPTIONS}
        for split in shares:
            check_key(name, split)
        given = fields(name, value, {**shares, **_OPTIONS})
        by = given.pop("by", "place")
        options = {key: given.pop(key) for key in _OPTIONS if key in given}
        if abs(sum(given.values()) - 1) > _SHARES:
            wanted = f"expected shares by {by} that are 1 together, such as train: 0.8, val: 0.2"
            raise ArgumentError(f"{name}: {wanted}; got {shown(given)}")
        return cls(given, **options)

    def of(self, place: str) -> str:
        """Return the split of a place."""
        digest = hashlib.sha256(f"{self.seed}:{place}".encode()).digest()
        left = int.from_bytes(digest[:8], "big") / 2**64
        for split, share in self.shares.items():
            left -= share
            if left < 0:
                return split
        return [split for split, share in self.shares.items() if share > 0][-1]  # of shares just below 1

    def places(self, positions_w: Array, given: Sequence[str] = ()) -> tuple[str, ...]:
        """Return the place of each pose: the given one, else ``X,Y,Z`` of the first pose of its place.

        Args:
            positions_w: (N, 3) metres, world frame.
            given: a place for each pose, empty where it has none; may be empty.
        """
        given = given or [""] * len(positions_w)
        free = [i for i, place in enumerate(given) if not place]
        positions = dict.fromkeys(map(tuple, positions_w[free].tolist()))  # many poses may share one
        first = dict(zip(positions, cluster_starts(np.array(list(positions)), self.distance_m), strict=True))
        found = list(given)
        for i in free:
            found[i] = ",".join(f"{each:.3f}" for each in first[tuple(positions_w[i].tolist())])
        return tuple(found)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values that :meth:`read` reads."""
        return {**self.shares, "by": "place", "distance_m": self.distance_m, "seed": self.seed}


_OPTIONS: dict[str, Reader] = {
    "by": partial(one_of, words=("place",)),
    "distance_m": partial(number, above=0),
    "seed": partial(whole_number, least=0),
}
