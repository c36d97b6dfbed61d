"""What a dataset holds beyond images: the keys of a job that only ``omniscv dataset make`` uses.

Names and options of truths and formats are checked by :func:`omniscv.make.check_dataset`, which knows their
registries.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from omniscv.arguments import flag, number, shown, stem, texts, whole_number, within, wrong
from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.geometry.clusters import cluster_starts
from omniscv.records import checked, listed, mapping, read, record, word
from omniscv.render_options import Tolerance
from omniscv.storage import bounded

_TOLERANCE = 1e-6  # of the sum of shares


@record
class Split:
    """How frames are divided among splits: by a hash of their places, so that new places move no others.

    Poses within a distance of each other, directly or by a chain of poses, are of one place. Poses with a
    ``place`` of their own are of that place.

    Attributes:
        shares: split to its share of the places; their sum is 1.
    """

    shares: Mapping[str, float]
    distance_m: float = checked(number, above=0, default=0.5, help="poses within this distance are one place")
    seed: int = checked(whole_number, least=0, default=0, help="seed of the division into splits")
    by: str = word(("place", "world"), default="place", help="what is divided: places, or whole worlds")

    def of(self, place: str) -> str:
        """Return the split of a place."""
        digest = hashlib.sha256(f"{self.seed}:{place}".encode()).digest()
        left = int.from_bytes(digest[:8], "big") / 2**64
        for split, share in self.shares.items():
            left -= share
            if left < 0:
                return split
        return [split for split, share in self.shares.items() if share > 0][-1]  # of shares just below 1

    def places(self, positions_w: Array, names: Sequence[str] = ()) -> tuple[str, ...]:
        """Return the place of each pose: its name, else ``X,Y,Z`` of the first pose of its place.

        Args:
            positions_w: (N, 3) metres, world frame.
            names: of the poses' places, empty for a pose without one; may be empty.
        """
        places = list(names) or [""] * len(positions_w)
        unnamed = [i for i, place in enumerate(places) if not place]
        positions = dict.fromkeys(map(tuple, positions_w[unnamed].tolist()))  # many poses may share one
        first = dict(zip(positions, cluster_starts(np.array(list(positions)), self.distance_m), strict=True))
        for i in unnamed:
            places[i] = ",".join(f"{value:.3f}" for value in first[tuple(positions_w[i].tolist())])
        return tuple(places)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values that :func:`read_split` reads."""
        return {**self.shares, "by": self.by, "distance_m": self.distance_m, "seed": self.seed}


def read_split(name: str, value: object) -> Split:
    """Return the split that a mapping describes: ``{train: 0.8, val: 0.2, seed: 0}``."""
    if isinstance(value, Split):
        return value
    if not isinstance(value, Mapping):
        raise ArgumentError(f"{name}: expected a mapping from split to share, got {shown(value)}")
    options = {key: value[key] for key in ("distance_m", "seed", "by") if key in value}
    shares = {
        stem(name, split): number(f"{name}.{split}", share, least=0, most=1)
        for split, share in value.items()
        if split not in options
    }
    if abs(sum(shares.values()) - 1) > _TOLERANCE:
        raise wrong(name, "shares whose sum is 1, such as train: 0.8, val: 0.2", shares)
    return read(Split, {"shares": shares, **options}, name)


def plain(name: str, value: object, cls: type[Any]) -> dict[str, Any]:
    """Return the keys of a mapping as a record's readers convert them, without those that it leaves out.

    A dataset's manifest holds what its job says, not the defaults of a version.
    """
    return _given(asdict(read(cls, value, name)), mapping(name, value))


def _given(values: Mapping[str, Any], keys: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of some keys, and below them of the keys that mappings have."""
    return {
        key: _given(values[key], below) if isinstance(below, Mapping) else values[key]
        for key, below in keys.items()
    }


@record
class Media:
    """Metadata of pictures."""

    xmp: bool = checked(flag, default=False, help="Photo Sphere metadata in equirectangular pictures")
    north: float = checked(number, default=0.0, help="compass heading of the world's X axis, degrees")


def read_classes(name: str, value: object) -> Any:
    """Return the content of a ``classes.yaml``, which is given by its path or as it is."""
    if not isinstance(value, str):
        return mapping(name, value)
    with within(value):
        return bounded.parse_yaml(bounded.read_text(Path(value)))


def read_truth(name: str, value: object) -> dict[str, dict[str, Any]]:
    """Return the options of the truths that are switched on, by name."""
    truths = {key: _options(f"{name}.{key}", options) for key, options in mapping(name, value).items()}
    if truths.get("tolerance") is not None:
        truths["tolerance"] = plain(f"{name}.tolerance", truths["tolerance"], Tolerance)
    return {key: options for key, options in truths.items() if options is not None}


def _options(name: str, value: object) -> dict[str, Any] | None:
    """Return options: none for true, ``{kind: WORD}`` for a word; None for false and off."""
    if value is None or value is False or value == "off":
        return None
    options = {} if value is True else {"kind": value} if isinstance(value, str) else value
    if not isinstance(options, Mapping):
        raise ArgumentError(f"{name}: expected true, false, or a mapping of options, got {shown(value)}")
    return dict(options)


def read_export(name: str, value: object) -> dict[str, Any]:
    """Return ``{format: NAME, OPTION: VALUE}`` of such a mapping, or of a format's name."""
    export = {"format": value} if isinstance(value, str) else value
    if not isinstance(export, Mapping) or not isinstance(export.get("format"), str):
        raise wrong(name, "a format, or {format: NAME, OPTION: VALUE}", value)
    cameras = {"cameras": texts(f"{name}.cameras", export["cameras"])} if "cameras" in export else {}
    return {**export, **cameras}


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
