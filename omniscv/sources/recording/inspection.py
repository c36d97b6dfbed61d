"""What a recording holds, and whether it is undamaged."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from omniscv import storage
from omniscv.errors import RecordingError
from omniscv.geometry.instant import Instant
from omniscv.sources.base import View
from omniscv.sources.recording.rows import Row, object_from_json, view_from_json
from omniscv.sources.recording.state_table import HeldState
from omniscv.sources.recording.store import ADVICE, Store


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

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)


def info(path: Path | str) -> Info:
    """What a recording holds, without its pixels; RecordingError if it cannot be read."""
    with closing(Store(storage.fetch_file(path))) as store:
        rows = store.listing()
        views = [view_from_json(row.captured) for row in rows]
        origins = [object_from_json(row.provenance) for row in rows]
        times = [time for each in origins if (time := _time(each)) is not None]

        def known(key: str) -> list[str]:
            return sorted({str(each[key]) for each in origins if key in each})

        return Info(
            file=storage.without_secrets(path),
            bytes=store.path.stat().st_size,
            schema_version=store.version,
            captures=dict(sorted(Counter(row.mode_name for row in rows).items())),
            centers=len({view.key().position for view in views}),
            sizes=dict(Counter(f"{view.width}x{view.height}" for view in views).most_common()),
            servers=known("server"),
            scenes=known("scene"),
            dialects=known("dialect"),
            first=_iso(min(times, default=None)),
            last=_iso(max(times, default=None)),
            objects=len(store.objects().colors),
            states=_states(rows, store.states()),
        )


def _states(rows: list[Row], known: dict[str, HeldState]) -> dict[str, dict[str, Any]]:
    instants = {name: state.instant for name, state in known.items()} | {"": Instant()}
    return {
        state: {"captures": count, "instant": each.to_dict() if (each := instants[state]) else None}
        for state, count in Counter(row.state for row in rows).items()
    }


@dataclass(frozen=True)
class Place:
    """An optical centre of a recording.

    Attributes:
        center: metres, world frame.
        state: of the world; empty for the still one.
        captures: number of captures by mode.
        fov_deg: the least and the greatest field of view of a view.
        last: when it was captured last, ISO 8601, UTC; empty where that is not recorded.
    """

    center: tuple[float, ...]
    state: str
    captures: dict[str, int]
    fov_deg: tuple[float, float]
    last: str


def places(path: Path | str) -> list[Place]:
    """Return the optical centres of a recording, in the order of their first captures, without its pixels.

    Raises:
        RecordingError: it cannot be read.
    """
    with closing(Store(storage.fetch_file(path))) as store:
        found: dict[tuple[object, ...], list[tuple[View, Row]]] = {}
        for row in store.listing():
            view = view_from_json(row.captured)
            found.setdefault((view.key().position, row.state), []).append((view, row))
    return [_place(each) for each in found.values()]


def _place(captures: list[tuple[View, Row]]) -> Place:
    views, rows = zip(*captures, strict=True)
    times = [_time(object_from_json(row.provenance)) for row in rows]
    return Place(
        center=tuple(views[0].pose.position.tolist()),
        state=rows[0].state,
        captures=dict(sorted(Counter(row.mode_name for row in rows).items())),
        fov_deg=(min(view.fov_deg for view in views), max(view.fov_deg for view in views)),
        last=_iso(max((time for time in times if time is not None), default=None)),
    )


def _time(origin: Mapping[str, Any]) -> float | None:
    time = origin.get("time")
    return time if isinstance(time, int | float) else None


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
    """Check the structure, the object table, that no capture is lost, and each capture.

    Raises:
        RecordingError: the file cannot be read, or has other tables than a recording.
    """
    shown = storage.without_secrets(path)
    with closing(Store(storage.fetch_file(path))) as store:
        faults = store.structural_faults()

        def check(what: Callable[[], object]) -> None:
            try:
                what()
            except RecordingError as cause:
                faults.append(str(cause).removeprefix(f"{store.path}: ").removesuffix(ADVICE))

        check(store.objects)
        check(store.geometry)
        check(store.states)
        check(store.listing)
        captures = 0
        for row in store.rows():
            captures += 1
            check(row.capture)
        return Verification(shown, captures, [f"{shown}: {fault}" for fault in faults])


def _iso(seconds: float | None) -> str:
    try:
        return "" if seconds is None else datetime.fromtimestamp(seconds, UTC).isoformat(timespec="seconds")
    except (OverflowError, ValueError, OSError):  # anything may be written in a file
        return ""
