"""What a dataset holds beyond images: the keys of a job that only ``omniscv dataset make`` uses.

Names and options of truths and formats are checked by :func:`omniscv.make.check_dataset`, which knows their
registries.
"""

import hashlib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from omniscv.arguments import flag, number, one_of, shown, stem, texts, whole_number, within, wrong
from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.geometry.clusters import cluster_starts
from omniscv.records import checked, listed, mapping, optional, read, record, word
from omniscv.render_options import Tolerance
from omniscv.storage import bounded

_TOLERANCE = 1e-6  # of the sum of shares


_RULES = ("quota", "hash")


@record
class Split:
    """How frames are divided among splits, by their places, so that new places move no others.

    Poses within a distance of each other, directly or by a chain of poses, are of one place. Poses with a
    ``place`` of their own are of that place.

    Attributes:
        shares: split to its share of the places; their sum is 1.
        rule: ``quota``: as many places of a job, in the order of its poses, as the shares say, to the next
            whole place, drawn by hashes; ``hash``: each place by its own hash, as datasets before it. None:
            that of the dataset that is continued, ``quota`` for a new one.
    """

    shares: Mapping[str, float]
    distance_m: float = checked(number, above=0, default=0.5, help="poses within this distance are one place")
    seed: int = checked(whole_number, least=0, default=0, help="seed of the division into splits")
    by: str = word(("place", "world"), default="place", help="what is divided: places, or whole worlds")
    rule: str | None = checked(
        optional(partial(one_of, words=_RULES)),
        default=None,
        help="how places are drawn: quota, or hash alone; as the dataset has them, or quota, if not given",
    )

    def of(self, place: str) -> str:
        """Return the split of a place or world by its hash alone."""
        return _drawn(self._hash(place), self.shares)

    def divide(self, places: Iterable[str]) -> dict[str, str]:
        """Return the split of each of a job's places.

        Of the first n places, whatever n is, a split has its share of n rounded up or down where there are
        two splits; where there are more, it may be one place more or less. Places that are added at the end
        move no others.

        Args:
            places: in the order of the job's poses, also repeatedly.
        """
        split_of: dict[str, str] = {}
        counts = dict.fromkeys(self.shares, 0)
        for place in dict.fromkeys(places):
            split = self.of(place) if self.rule == "hash" else self._next(place, counts)
            counts[split] = counts.get(split, 0) + 1
            split_of[place] = split
        return split_of

    def _next(self, place: str, counts: Mapping[str, int]) -> str:
        """Return the split of the next place, after others of which splits have these counts."""
        number = sum(counts.values()) + 1
        lacking = {}
        able = {}
        for split, share in self.shares.items():
            due = share * number
            if counts[split] < math.floor(due + _TOLERANCE):
                lacking[split] = due - counts[split]
            if counts[split] + 1 <= math.ceil(due - _TOLERANCE):
                able[split] = share
        if lacking:
            return max(lacking, key=lacking.__getitem__)
        whole = sum(able.values())
        return _drawn(self._hash(place), {split: share / whole for split, share in able.items()})

    def _hash(self, place: str) -> float:
        """Return a number of a place, 0 to 1."""
        digest = hashlib.sha256(f"{self.seed}:{place}".encode()).digest()
        return int.from_bytes(digest[:8], "big") / 2**64

    def places(self, positions_w: Array, names: Sequence[str] = ()) -> tuple[str, ...]:
        """Return the place of each pose: its name, else ``X,Y,Z`` of the first pose of its place.

        Args:
            positions_w: (N, 3) metres, world frame.
            names: of the poses' places, empty for a pose without one; may be empty.
        """
        places = list(names) or [""] * len(positions_w)
        unnamed = np.flatnonzero([not place for place in places])
        positions = dict.fromkeys(map(tuple, positions_w[unnamed].tolist()))  # many poses may share one
        first = dict(zip(positions, cluster_starts(np.array(list(positions)), self.distance_m), strict=True))
        for index in unnamed:
            x, y, z = first[tuple(positions_w[index].tolist())]
            places[index] = f"{x:.3f},{y:.3f},{z:.3f}"
        return tuple(places)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values that :func:`read_split` reads."""
        values = {**self.shares, "by": self.by, "distance_m": self.distance_m, "seed": self.seed}
        return values if self.rule == "hash" else {**values, "rule": self.rule or _RULES[0]}


def _drawn(number: float, shares: Mapping[str, float]) -> str:
    """Return the split in whose share a number, 0 to 1, lies."""
    left = number
    last = ""
    for split, share in shares.items():
        left -= share
        if left < 0:
            return split
        if share > 0:
            last = split
    return last  # of shares whose sum is just below 1


def read_split(name: str, value: object) -> Split:
    """Return the split that ``value`` describes: ``{train: 0.8, val: 0.2, seed: 0}``.

    ArgumentError, which begins with ``name``: another value, or shares whose sum is not 1.
    """
    if isinstance(value, Split):
        return value
    if not isinstance(value, Mapping):
        raise ArgumentError(f"{name}: expected a mapping from split to share, got {shown(value)}")
    options = {}
    shares = {}
    for key, entry in value.items():
        if key in ("distance_m", "seed", "by", "rule"):
            options[key] = entry
        else:
            shares[stem(name, key)] = number(f"{name}.{key}", entry, least=0, most=1)
    if abs(sum(shares.values()) - 1) > _TOLERANCE:
        raise wrong(name, "shares whose sum is 1, such as train: 0.8, val: 0.2", shares)
    return read(Split, {"shares": shares, **options}, name)


def plain(name: str, value: object, cls: type[Any]) -> dict[str, Any]:
    """Return a mapping with its values as the readers of a record convert them.

    Keys that it leaves out stay out: the manifest of a dataset has what the job says, not the defaults of a
    version.

    Args:
        name: with which errors begin.
        value: the mapping.
        cls: the record.
    """
    return _given(asdict(read(cls, value, name)), mapping(name, value))


def _given(values: Mapping[str, Any], keys: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of some keys, and below them of the keys that mappings have."""
    given = {}
    for key, below in keys.items():
        given[key] = _given(values[key], below) if isinstance(below, Mapping) else values[key]
    return given


@record
class Media:
    """Metadata of pictures."""

    xmp: bool = checked(flag, default=False, help="Photo Sphere metadata in equirectangular pictures")
    north: float = checked(number, default=0.0, help="compass heading of the world's X axis, degrees")


def read_classes(name: str, value: object) -> Any:
    """Return the content of a ``classes.yaml``: ``value`` is it, or its path. Errors begin with ``name``."""
    if not isinstance(value, str):
        return mapping(name, value)
    with within(value):
        return bounded.parse_yaml(bounded.read_text(Path(value)))


def read_truth(name: str, value: object) -> dict[str, dict[str, Any]]:
    """Return the options of the truths that ``value`` switches on, by name. Errors begin with ``name``."""
    truths = {}
    for key, switch in mapping(name, value).items():
        options = _options(f"{name}.{key}", switch)
        if options is not None:
            truths[key] = options
    if "tolerance" in truths:
        truths["tolerance"] = plain(f"{name}.tolerance", truths["tolerance"], Tolerance)
    return truths


def _options(name: str, value: object) -> dict[str, Any] | None:
    """Return options: none for true, ``{kind: WORD}`` for a word; None for false and off."""
    if value is None or value is False or value == "off":
        return None
    if value is True:
        return {}
    if isinstance(value, str):
        return {"kind": value}
    if not isinstance(value, Mapping):
        raise ArgumentError(f"{name}: expected true, false, or a mapping of options, got {shown(value)}")
    return dict(value)


def read_export(name: str, value: object) -> dict[str, Any]:
    """Return ``{format: NAME, OPTION: VALUE}`` of ``value``, which is such a mapping or a format's name.

    ArgumentError, which begins with ``name``, for anything else.
    """
    if isinstance(value, str):
        return {"format": value}
    if not isinstance(value, Mapping) or not isinstance(value.get("format"), str):
        raise wrong(name, "a format, or {format: NAME, OPTION: VALUE}", value)
    export = dict(value)
    if "cameras" in export:
        export["cameras"] = texts(f"{name}.cameras", export["cameras"])
    return export


@record
class Recipe:
    """What a dataset holds beyond images: keys of a job's file, as they are read there.

    Truths and exports are mappings of options; an export also has ``format``, ``out`` and ``cameras``.
    """

    classes: Any = checked(read_classes, default=None, help="classes of object names, or a file")
    truth: Any = checked(read_truth, default=None, help="truths to derive, each true or its options")
    exports: Any = checked(
        listed(read_export), default=(), key="export", help="formats, each a name or its options"
    )
    split: Split | None = checked(read_split, default=None, help="share of each split")
    media: Any = checked(plain, cls=Media, default=None, help="metadata of pictures")
    watch: str | None = word(
        ("mark", "fail"),
        default=None,
        help="frames that the world left objects out of: mark (in frames.jsonl), or fail",
    )
