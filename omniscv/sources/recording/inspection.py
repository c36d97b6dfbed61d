"""What a recording holds, and whether it is undamaged."""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from omniscv import storage
from omniscv.errors import RecordingError
from omniscv.geometry.instant import Instant
from omniscv.sources.base import View
from omniscv.sources.recording.files import SCHEMA_VERSION
from omniscv.sources.recording.replay import in_words
from omniscv.sources.recording.rows import Row, view_from_json
from omniscv.sources.recording.store import Store
from omniscv.sources.recording.world_rows import WorldState, listed_scenes, object_from_json, scene_of

T = TypeVar("T")

_MODES = ("depth", "object_mask")
_PX = 64  # about how many pixels of a side are compared
_LEAST_EDGES = 30  # the fewest pixels at edges of a mask for a verdict
_BEND = 0.01  # relative second difference of inverse depth: half floats stay below 0.002
# Shares of a mask's edges that depth has too: 0.84 to 1 in one view, mostly less than 0.6 in two views.
_FITS = 0.9
_CONTRADICTS = 0.75


@dataclass(frozen=True)
class Info:
    """A recording in numbers.

    Attributes:
        captures: number of captures by mode.
        centers: number of optical centres.
        sizes: number of captures by size in px, as ``WIDTHxHEIGHT``.
        servers, scenes, dialects: where the captures came from.
        first, last: when they were captured, ISO 8601, UTC; empty where that is not recorded.
        objects: number of objects whose mask colour is known.
        states: by state of the world, the empty text for the still one: the number of captures, and what is
            known of its instant, as :meth:`omniscv.geometry.instant.Instant.to_dict` has it.
    """

    file: str
    bytes: int
    schema_version: int
    captures: dict[str, int]
    centers: int
    sizes: dict[str, int]
    servers: list[str]
    scenes: list[str]
    dialects: list[str]
    first: str
    last: str
    objects: int
    states: dict[str, dict[str, Any]]


def info(path: Path | str) -> Info:
    """Return what a recording holds, without its pixels; RecordingError if it cannot be read."""
    with closing(Store(storage.fetch_file(path))) as store:
        rows = store.listing()
        views: dict[str, View] = {}  # by its text, which captures of several modes have
        sizes: Counter[str] = Counter()
        for row in rows:
            if row.captured not in views:
                views[row.captured] = view_from_json(row.captured)
            view = views[row.captured]
            sizes[f"{view.width}x{view.height}"] += 1
        provenances = list(map(object_from_json, {row.provenance for row in rows}))
        first, last = _period(provenances)
        return Info(
            file=storage.without_secrets(path),
            bytes=store.path.stat().st_size,
            schema_version=SCHEMA_VERSION,
            captures=_by_mode(rows),
            centers=len({view.key().position for view in views.values()}),
            sizes=dict(sizes.most_common()),
            servers=_values(provenances, "server"),
            scenes=_values(provenances, "scene"),
            dialects=_values(provenances, "dialect"),
            first=first,
            last=last,
            objects=len(store.objects().colors),
            states=_described_states(rows, store.states()),
        )


def _values(provenances: Sequence[dict[str, Any]], key: str) -> list[str]:
    """Return what provenances have of a key, each value once, as text."""
    return sorted({str(provenance[key]) for provenance in provenances if key in provenance})


def _described_states(rows: Sequence[Row], states: Mapping[str, WorldState]) -> dict[str, dict[str, Any]]:
    """Return :attr:`Info.states`."""
    described: dict[str, dict[str, Any]] = {}
    for name, count in Counter(row.state for row in rows).items():
        instant = states[name].instant if name else Instant()
        described[name] = {"captures": count, "instant": instant.to_dict() if instant else None}
    return described


@dataclass(frozen=True)
class Center:
    """An optical centre of a recording, metres, world frame, in a state of the world.

    Attributes:
        captures: number of captures by mode.
        fov_deg: the least and the greatest field of view of a view.
        last: when it was captured last, ISO 8601, UTC; empty where that is not recorded.
    """

    center: tuple[float, ...]
    state: str
    captures: dict[str, int]
    fov_deg: tuple[float, float]
    last: str


def centers(path: Path | str) -> list[Center]:
    """Return the optical centres of a recording, in the order of their first captures, without its pixels."""
    rows: dict[tuple[object, str], list[Row]] = defaultdict(list)
    views: dict[tuple[object, str], list[View]] = defaultdict(list)
    with closing(Store(storage.fetch_file(path))) as store:
        for row in store.listing():
            view = view_from_json(row.captured)
            key = (view.key().position, row.state)
            rows[key].append(row)
            views[key].append(view)
    return [_center(rows[key], views[key]) for key in rows]


def _center(rows: Sequence[Row], views: Sequence[View]) -> Center:
    """Return the centre that captures in one state, and their views, have."""
    fovs_deg = [view.fov_deg for view in views]
    return Center(
        center=tuple(views[0].pose.position.tolist()),
        state=rows[0].state,
        captures=_by_mode(rows),
        fov_deg=(min(fovs_deg), max(fovs_deg)),
        last=_period([object_from_json(row.provenance) for row in rows])[1],
    )


@dataclass(frozen=True)
class Verification:
    """The damage found in a recording: one line for each fault."""

    file: str
    captures: int
    faults: list[str]

    @property
    def ok(self) -> bool:
        """Whether every capture is as it was recorded."""
        return not self.faults

    def lines(self) -> Iterator[str]:
        """The faults, then a summary."""
        yield from self.faults
        state = "all as recorded" if self.ok else f"{len(self.faults)} damaged"
        yield f"{self.file}: {self.captures} captures, {state}"


def verify(path: Path | str) -> Verification:
    """Check structure, objects, and captures: none is lost, all show one scene and their own views."""
    name = storage.without_secrets(path)
    faults: list[str] = []

    def check(read: Callable[[], T]) -> T | None:
        try:
            return read()
        except RecordingError as cause:
            faults.append(str(cause.at(name)))
            return None

    captures = 0
    scenes: set[str] = set()
    with closing(Store(storage.fetch_file(path))) as store:
        faults += [f"{name}: {fault}" for fault in store.structural_faults()]
        for read in (store.objects, store.geometry, store.states, store.listing):
            check(read)
        for row in store.rows():
            captures += 1
            if capture := check(row.capture):
                scenes |= scene_of(capture)
        if not faults:
            faults += [f"{name}: {fault}" for fault in stale_captures(store)]
            faults += [f"{name}: {fault}" for fault in unmoved_places(store)]
    if len(scenes) > 1:
        faults.append(f"{name}: expected captures of one scene, got some of {listed_scenes(scenes)}")
    return Verification(name, captures, faults)


def _by_mode(rows: Sequence[Row]) -> dict[str, int]:
    return dict(sorted(Counter(row.mode for row in rows).items()))


def _period(provenances: list[dict[str, Any]]) -> tuple[str, str]:
    """Return the first and the last time of captures, ISO 8601, UTC; empty where it is not recorded."""
    times = []
    for provenance in provenances:
        time = provenance.get("time")
        if isinstance(time, int | float):
            times.append(time)
    if not times:
        return "", ""
    return _iso(min(times)), _iso(max(times))


def _iso(seconds: float) -> str:
    try:
        return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="seconds")
    except (OverflowError, ValueError, OSError):  # anything may be written in a file
        return ""


def stale_captures(store: Store) -> Iterator[str]:
    """Yield a line for each capture of depth or masks that shows an earlier view, which a server sent again.

    Two views that look alike may share a picture byte for byte. If it belongs to one of them only, it
    contradicts the other mode of the wrong view: depth is smooth at the edges of its mask. Captures must be
    undamaged.
    """
    modes_of: dict[tuple[str, str], dict[str, Row]] = defaultdict(dict)
    same_bytes: dict[tuple[str, int], list[Row]] = defaultdict(list)
    for row in store.listing():
        if row.mode in _MODES and row.stops is None:
            modes_of[row.asked, row.state][row.mode] = row
            same_bytes[row.mode, row.payload_checksum].append(row)
    for (mode, _), rows in same_bytes.items():
        pairs = []
        for row in rows:
            pair = modes_of[row.asked, row.state]
            if len(pair) == len(_MODES):
                pairs.append(pair)
        if len({pair[mode].captured for pair in pairs}) < 2:
            continue
        picture = _pixels(store, rows[0])
        edges = _bends(picture) if mode == "depth" else _borders(picture)
        if edges.any():  # not of the sky, of which there may be many views
            yield from _contradicted(store, mode, pairs)


def _contradicted(store: Store, mode: str, pairs: Sequence[dict[str, Row]]) -> Iterator[str]:
    """Yield a line for each view whose other mode contradicts the picture that all of some views share.

    ``pairs`` are the captures of depth and mask of each view; their pictures in ``mode`` are the same.
    """
    shares = [_common_edges(store, pair) for pair in pairs]
    best = int(np.nan_to_num(shares).argmax())
    if not shares[best] >= _FITS:
        return
    other = in_words(view_from_json(pairs[best][mode].captured))
    for pair, share in zip(pairs, shares, strict=True):
        if share < _CONTRADICTS:
            view = in_words(view_from_json(pair[mode].captured))
            yield f"{mode} of {view}: expected its own picture, got that of {other}"


def unmoved_places(store: Store) -> Iterator[str]:
    """Yield a line for each place whose pictures are the same in all directions and modes.

    The camera did not move there. Masks alone are no evidence, as one object may be all around, nor is depth
    of the sky alone.
    """
    places: dict[tuple[Any, str], dict[Any, list[Row]]] = defaultdict(lambda: defaultdict(list))
    for row in store.listing():
        view = view_from_json(row.captured)
        kind = (row.mode, view.width, view.height, view.fov_deg, row.stops)
        places[view.key().position, row.state][kind].append(row)
    for (position, _), kinds in places.items():
        compared = list(filter(_has_several_views, kinds.values()))
        if not any(_is_evidence(store, rows[0]) for rows in compared):
            continue
        if all(map(_is_one_picture, compared)):
            count = max(map(len, compared))
            at = ", ".join(f"{value:.4g}" for value in position)
            why = "the camera did not move, or there was nothing to see"
            actual = f"got equal ones in all modes: {why}"
            yield f"{count} views at ({at}) m: expected a picture of each, {actual}"


def _has_several_views(rows: Sequence[Row]) -> bool:
    """Return whether captures are of more than one view."""
    return len({row.captured for row in rows}) > 1


def _is_one_picture(rows: Sequence[Row]) -> bool:
    """Return whether captures have the same bytes."""
    return len({row.payload_checksum for row in rows}) == 1


def _is_evidence(store: Store, row: Row) -> bool:
    """Return whether equal pictures in other directions say that the camera did not move."""
    if row.mode in ("lit", "object_mask"):
        return row.mode == "lit"
    pixels = _pixels(store, row)
    return bool((pixels != pixels[0, 0]).any())


def _pixels(store: Store, row: Row) -> NDArray[np.generic]:
    return next(store.rows([row.number])).capture().pixels


def _common_edges(store: Store, pair: dict[str, Row]) -> float:
    """Return the share of a mask's edges at which depth bends or jumps; NaN where there are few."""
    depth = _pixels(store, pair["depth"])
    mask = _pixels(store, pair["object_mask"])
    if depth.shape[:2] != mask.shape[:2]:
        return float("nan")
    borders = _borders(mask)
    if borders.sum() < _LEAST_EDGES:
        return float("nan")
    near = cv2.dilate(_bends(depth).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return float(near[borders].mean())


def _sampled(pixels: NDArray[np.generic]) -> NDArray[np.generic]:
    step = max(1, max(pixels.shape[:2]) // _PX)
    return pixels[step // 2 :: step, step // 2 :: step]


def _bends(depth: NDArray[np.generic]) -> NDArray[np.bool_]:
    """Return (h, w) where inverse depth, which is linear on planes, is not."""
    inverse = 1 / np.maximum(_sampled(depth).astype(np.float64), 1e-3)
    bends = np.zeros(inverse.shape, np.bool_)
    for values, out in ((inverse, bends), (inverse.T, bends.T)):
        before = values[:-2]
        here = values[1:-1]
        after = values[2:]
        out[1:-1] |= abs(before - 2 * here + after) > _BEND * np.minimum(np.minimum(before, here), after)
    return bends


def _borders(mask: NDArray[np.generic]) -> NDArray[np.bool_]:
    """Return (h, w) where the next pixel to the right or below has another colour or id."""
    sampled = _sampled(mask)
    codes = sampled.reshape(*sampled.shape[:2], -1)
    borders = np.zeros(codes.shape[:2], np.bool_)
    borders[:, :-1] |= (codes[:, 1:] != codes[:, :-1]).any(axis=2)
    borders[:-1] |= (codes[1:] != codes[:-1]).any(axis=2)
    return borders
