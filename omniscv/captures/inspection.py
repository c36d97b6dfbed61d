"""What a recorded file holds, and whether it is whole."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from omniscv.captures.decode import decode
from omniscv.captures.store import SCHEMA_VERSION, Store, checksum_of, object_from_json, view_from_json
from omniscv.errors import BadReply, DamagedRecord


@dataclass(frozen=True)
class Info:
    """A recorded file in numbers.

    Attributes:
        captures: number of captures by mode.
        centers: number of optical centres.
        sizes: number of captures by size in px, as ``WIDTHxHEIGHT``.
        servers, scenes, dialects: where the captures came from.
        first, last: when they were captured, ISO 8601, UTC; empty if nothing says.
        objects: number of objects whose mask colour is known.
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

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)


def info(path: Path | str) -> Info:
    """Looks into a recorded file; reads no pixels.

    Raises:
        RecordError: as :class:`omniscv.captures.store.Store`.
    """
    store = Store(path)
    try:
        modes: Counter[str] = Counter()
        sizes: Counter[str] = Counter()
        centers = set()
        origins: dict[str, set[str]] = {"server": set(), "scene": set(), "dialect": set()}
        times = []
        for view, mode, provenance in store.entries():
            modes[mode] += 1
            sizes[f"{view.width}x{view.height}"] += 1
            centers.add(tuple(view.pose.position.round(7)))
            for key, seen in origins.items():
                if key in provenance:
                    seen.add(str(provenance[key]))
            if isinstance(provenance.get("time"), int | float):
                times.append(float(provenance["time"]))
        return Info(
            file=str(store.path),
            bytes=store.path.stat().st_size,
            schema_version=SCHEMA_VERSION,
            captures=dict(sorted(modes.items())),
            centers=len(centers),
            sizes=dict(sizes.most_common()),
            servers=sorted(origins["server"]),
            scenes=sorted(origins["scene"]),
            dialects=sorted(origins["dialect"]),
            first=_when(min(times, default=None)),
            last=_when(max(times, default=None)),
            objects=len(store.objects().colors),
        )
    finally:
        store.close()


@dataclass
class Verification:
    """What a check of a recorded file found."""

    file: str
    captures: int = 0
    faults: list[str] = field(default_factory=list)

    @property
    def ok(self) -> bool:
        """Whether every capture is as it was recorded."""
        return not self.faults

    def lines(self) -> Iterator[str]:
        """One line for each fault, then the sum."""
        yield from self.faults
        state = "all as recorded" if self.ok else f"{len(self.faults)} damaged"
        yield f"{self.file}: {self.captures} captures, {state}"


def verify(path: Path | str) -> Verification:
    """Checks every capture of a recorded file: checksum, and that it decodes to the size it claims.

    Raises:
        RecordError: as :class:`omniscv.captures.store.Store`.
    """
    store = Store(path)
    try:
        report = Verification(str(store.path))
        report.faults += [f"{store.path}: {fault}" for fault in store.structural_faults()]
        for row in store.rows():
            report.captures += 1
            if fault := _fault(row):
                report.faults.append(f"{store.path}: capture {row.key}: {fault}")
        return report
    finally:
        store.close()


def _fault(row: Any) -> str | None:
    try:
        if (found := checksum_of(row.payload)) != row.checksum:
            return f"expected checksum {row.checksum!r}, got {found}"
        object_from_json(row.provenance)
        view_from_json(row.asked)
        decode(row.payload, row.encoding, row.mode, view_from_json(row.captured))
    except (BadReply, DamagedRecord) as cause:
        return str(cause)
    return None


def _when(seconds: float | None) -> str:
    if seconds is None:
        return ""
    try:
        return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="seconds")
    except (OverflowError, ValueError, OSError):  # anything may be written in a file
        return ""
