"""Sources around a recorded file: one that replays it, one that fills it."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path

import numpy as np

from omniscv.captures.source import Capabilities, ObjectTable, Source
from omniscv.captures.store import Row, Store, key_of
from omniscv.captures.view import Capture, Request, View
from omniscv.errors import MissingCapture, RecordNotWritable
from omniscv.parallel import side_by_side


class RecordedSource(Source):
    """Replays a recorded file; touches no network.

    Raises:
        RecordError: as :class:`omniscv.captures.store.Store`.
    """

    def __init__(self, path: Path | str) -> None:
        self._store = Store(path)
        views = list(self._store.views())
        self._views = tuple(dict.fromkeys(view for view, _ in views))
        self._capabilities = Capabilities(modes=frozenset(mode for _, mode in views), dialect="record")

    @property
    def capabilities(self) -> Capabilities:
        return self._capabilities

    def recorded_views(self) -> tuple[View, ...]:
        return self._views

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        for few in batched(requests, _READ_AHEAD):
            rows = [self._row(request) for request in few]
            decoded = side_by_side(
                lambda pair: self._store.capture_of(*pair), list(zip(few, rows, strict=True))
            )
            yield from decoded

    def objects(self) -> ObjectTable:
        return self._store.objects()

    def close(self) -> None:
        self._store.close()

    def _row(self, request: Request) -> Row:
        row = self._store.row(request)
        if row is None:
            raise MissingCapture(self._explain(request))
        return row

    def _explain(self, request: Request) -> str:
        """Which recorded view is nearest, and how it differs."""
        wanted = f"{self._store.path}: expected a {request.mode} capture of {_describe(request.view)}; "
        views = [view for view, _ in self._store.views(request.mode)]
        if not views:
            modes = ", ".join(sorted(self._capabilities.modes)) or "nothing"
            return wanted + f"the record holds no {request.mode}, only {modes}"
        nearest = min(views, key=lambda view: sum(_differences(view, request.view).values()))
        apart = [name for name, amount in _differences(nearest, request.view).items() if amount > 0]
        return wanted + f"the nearest recorded is {_describe(nearest)}, which differs in {', '.join(apart)}"


class Recording(Source):
    """Serves what a file holds from the file, and captures and keeps the rest.

    Args:
        source: where new captures come from; closed with this.
        path: the file; made if it is not there.
        anew: capture again what the file held before; the new capture takes the place of the old.
    """

    def __init__(self, source: Source, path: Path | str, *, anew: bool = False) -> None:
        self._source = source
        self._store = Store(path, write=True)
        self._known = set() if anew else self._store.keys()
        self._objects: ObjectTable | None = None

    @property
    def capabilities(self) -> Capabilities:
        return self._source.capabilities

    def recorded_views(self) -> tuple[View, ...] | None:
        return self._source.recorded_views()

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        """As :meth:`Source.capture`; what is new is in the file before it is handed out."""
        waiting: deque[Request] = deque()
        for fresh in self._source.capture(self._new(requests, waiting)):
            self._store.add(fresh)
            self._known.add(key_of(fresh.request))
            while (request := waiting.popleft()) != fresh.request:
                yield self._stored(request)
            yield fresh
        while waiting:
            yield self._stored(waiting.popleft())

    def objects(self) -> ObjectTable:
        """As :meth:`Source.objects`.

        Raises:
            RecordNotWritable: the file's object masks were captured with other colours.
        """
        if self._objects is None:
            objects = self._source.objects()
            self._refuse_other_colors(objects)
            self._store.set_objects(objects)
            self._objects = objects
        return self._objects

    def close(self) -> None:
        try:
            self._store.close()
        finally:
            self._source.close()

    def _refuse_other_colors(self, objects: ObjectTable) -> None:
        """One colour that means two objects, or the reverse, would spoil the labels of what is recorded."""
        if next(self._store.views("object_mask"), None) is None:
            return
        before = self._store.objects().colors
        names = {color: name for name, color in before.items()}
        for name, color in objects.colors.items():
            if name in before and before[name] != color:
                conflict = f"{name} is {color} and was {before[name]}"
            elif name not in before and color in names:
                conflict = f"{name} is {color}, which was {names[color]}"
            else:
                continue
            raise RecordNotWritable(
                f"{self._store.path}: expected the mask colours that its object masks have, but {conflict}; "
                "record into another file"
            )

    def _new(self, requests: Iterable[Request], waiting: deque[Request]) -> Iterator[Request]:
        """The requests that the file cannot answer, each once; all of them go to ``waiting``."""
        asked: set[str] = set()
        for request in requests:
            waiting.append(request)
            key = key_of(request)
            if key not in self._known and key not in asked:
                asked.add(key)
                yield request

    def _stored(self, request: Request) -> Capture:
        stored = self._store.get(request)
        if stored is None:
            raise MissingCapture(
                f"{self._store.path}: expected a capture that was just known; was it removed?"
            )
        return stored


_READ_AHEAD = 6
"""Captures decoded together: all faces of a centre in a mode."""


def batched(items: Iterable[Request], most: int) -> Iterator[list[Request]]:
    """Lists of so many items, read no further ahead."""
    source = iter(items)
    while batch := list(islice(source, most)):
        yield batch


def record(source: Source, path: Path | str) -> Source:
    """A source that records what it captures into a file, and takes from it what it already holds.

    Args:
        source: where new captures come from. It is closed with the recording.
        path: the file; made if it is not there. Recording again goes on where it stopped.

    Raises:
        RecordError: the file is something else, newer, damaged, or cannot be written.
    """
    return Recording(source, path)


def _describe(view: View) -> str:
    x, y, z = view.pose.t_w_c
    yaw, pitch, roll = view.pose.angles()
    return (
        f"{view.width} x {view.height}, fov {view.fov_deg:.4g} deg, at ({x:.4g}, {y:.4g}, {z:.4g}) m, "
        f"yaw {yaw:.4g}, pitch {pitch:.4g}, roll {roll:.4g} deg"
    )


def _differences(a: View, b: View) -> dict[str, float]:
    """How two views differ, in comparable amounts: metres, radians, ratios; 0 where they agree."""
    turn = (np.trace(a.pose.R_w_c.T @ b.pose.R_w_c) - 1) / 2
    amounts = {
        "position": float(np.linalg.norm(a.pose.t_w_c - b.pose.t_w_c)),
        "orientation": float(np.arccos(np.clip(turn, -1, 1))),
        "field of view": abs(np.radians(a.fov_deg - b.fov_deg)),
        "size": abs(np.log(a.width / b.width)) + abs(np.log(a.height / b.height)),
    }
    return {name: amount if amount > 1e-7 else 0.0 for name, amount in amounts.items()}
