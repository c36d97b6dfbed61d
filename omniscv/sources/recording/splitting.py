"""A recording becomes several: one for each place."""

import tempfile
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import numpy as np

from omniscv import storage
from omniscv.arguments import number, one_of
from omniscv.errors import ArgumentError
from omniscv.geometry.clusters import cluster_starts
from omniscv.sources.recording.adding import opened_whole
from omniscv.sources.recording.rows import Row, view_from_json
from omniscv.sources.recording.store import Store

_NEAREST_M = 0.001
"""Places have the names of their positions, in millimetres."""


def split(
    file: Path | str, out: Path | str, by: str = "place", distance_m: float = 0.5
) -> list[tuple[str, int]]:
    """Write a recording for each place of one: ``STEM.X,Y,Z.SUFFIX``; each replays what was captured there.

    Args:
        file: path or URL of the recording.
        out: path or URL of the folder, which must be empty or new.
        by: ``place``: optical centres that are at most a distance from each other, and those that a chain of
            such centres joins. X, Y, Z is the first of them, metres.
        distance_m: the distance, at least a millimetre.

    Returns:
        The name and the number of captures of each, in the order of recording.

    Raises:
        ArgumentError: another criterion, or a folder that holds something.
        RecordingError: the recording cannot be read, is damaged, or one cannot be written.
    """
    one_of("by", by, ("place",))
    number("distance_m", distance_m, least=_NEAREST_M)
    folder = storage.folder(out)
    if folder.names():
        raise ArgumentError(f"{folder}: expected an empty or new folder, but it holds something")
    local = storage.fetch_file(file)
    with closing(Store(local)) as store:
        rows = store.listing()
        name = Path(str(file).rpartition("/")[2])
        held: dict[str, list[int]] = {}
        for row, place in zip(rows, _places(rows, distance_m), strict=True):
            held.setdefault(f"{name.stem}.{place}{name.suffix}", []).append(row.number)
        with tempfile.TemporaryDirectory(dir=_beside(folder), prefix=".") as part:
            for each, numbers in held.items():
                _write(store, numbers, Path(part) / each)
            for each in held:
                folder.put(each, Path(part) / each)
    return [(each, len(numbers)) for each, numbers in held.items()]


def _places(rows: Sequence[Row], distance_m: float) -> list[str]:
    """The place of each capture: the view that was requested decides."""
    centers = [tuple(view_from_json(row.asked).pose.position.tolist()) for row in rows]
    distinct = list(dict.fromkeys(centers))
    place_of = dict(zip(distinct, cluster_starts(np.array(distinct), distance_m).tolist(), strict=True))
    return [",".join(f"{each + 0.0:.3f}" for each in place_of[center]) for center in centers]


def _write(store: Store, numbers: Sequence[int], path: Path) -> None:
    """Write captures of a recording, by their numbers, and what is known beside them."""
    with opened_whole(path) as into:
        into.set_scene(store.scene_identity)
        into.set_objects(store.objects())
        if geometry := store.geometry():
            into.set_geometry(geometry)
        known, noted = store.states(), set[str]()
        for row in store.rows(numbers):
            row.check_payload()
            if row.state and row.state not in noted:
                into.set_state(row.state, known[row.state])
                noted.add(row.state)
            into.add_row(row, row.description()[0])


def _beside(folder: storage.Folder) -> Path | None:
    """Where parts are written: on the file system of a local folder."""
    if folder.local is None:
        return None
    folder.local.mkdir(parents=True, exist_ok=True)
    return folder.local
