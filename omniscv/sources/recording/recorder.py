"""A source that records what another one captures."""

import contextlib
import logging
import threading
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NoReturn

import numpy as np

from omniscv.errors import ArgumentError, MissingCaptureError, OtherMomentError, OtherSceneError, SourceError
from omniscv.geometry.instant import Instant
from omniscv.geometry.scene_geometry import SceneGeometry
from omniscv.sources.base import (
    Capabilities,
    Capture,
    ObjectTable,
    Request,
    Source,
    SourceWrapper,
    copy_with,
    not_picklable,
)
from omniscv.sources.recording.rows import labelled_modes
from omniscv.sources.recording.store import Store
from omniscv.sources.recording.world_rows import WorldState
from omniscv.sources.requests import Held, in_order
from omniscv.sources.world import SharedExposure

_log = logging.getLogger("omniscv")


class Recording(SourceWrapper):
    """Replays what a file holds; captures the rest from another source and writes it to the file.

    New colours are exposed as those that the file holds, if cameras find their exposure.

    Args:
        source: where new captures come from; closed with this.
        path: the file; created if there is none.
        anew: capture again what the file held before; the new capture replaces the old one.

    Raises RecordingError if the file is something else, newer, damaged, cannot be written, or is of another
    scene.
    """

    def __init__(self, source: Source, path: Path | str, *, anew: bool = False) -> None:
        if not isinstance(source, Source):
            raise ArgumentError(f"source: expected an open source, got {source!r}; open it with open_source")
        super().__init__(source)
        self._store = Store(path, write=True)
        try:
            self._scene = source.scene_identity
            self._store.set_scene(self._scene)
        except BaseException:
            self._store.close()
            raise
        # Requests captured again so far; None where the file's captures are replayed.
        self._captured_anew: set[Request] | None = set() if anew else None
        self._objects: tuple[str, ObjectTable] | None = None  # with the state in which they were read
        self._described_state = ""  # the last one that was written to the file
        self._requested: Instant | None = None
        self._owns_store = True
        self._dialect: object = None  # of the file, once a capture is written
        self._made: set[Request] = set()  # captured since the file was opened
        self._new = 0  # captures of the instant that the file did not hold
        self._lock = threading.RLock()
        self.share_exposure(SharedExposure())

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        """As :meth:`Source.capture`; a new capture is in the file before it is yielded.

        A repeated one is read from the file, too, while all others of its instant are: nothing new has to
        show the same.
        """
        requested: set[Request] = set()

        def find(request: Request) -> Held | None:
            anew = self._captured_anew
            once = replace(request, again=False)
            is_held = self._store.holds(once) if anew is None else once in anew
            if request.again and is_held and not self._new and once not in self._made:
                return partial(self._read, request)
            if request.again or not (is_held or request in requested):
                requested.add(request)
                if not request.again:
                    self._new += 1
                return None
            return partial(self._read, request)

        return in_order(requests, find, self._capture_and_write)

    @property
    def capabilities(self) -> Capabilities:
        """Those of the source, but for single rays, which no recording holds."""
        return replace(self._source.capabilities, traces=False, shades=False)

    def objects(self) -> ObjectTable:
        """The objects, with those that the file held before; all are written to the file, with the shapes."""
        with self._lock:
            state = self._source.state
            if self._objects is None or self._objects[0] != state:
                self._store.set_objects(self._source.objects())
                if not state and (self._captured_anew is not None or not self._store.geometry()):
                    self._store.set_geometry(self._source_geometry())
                self._objects = (state, self._store.objects())
            return self._objects[1]

    def geometry(self) -> SceneGeometry:
        """What is known of shapes, as written to the file."""
        self.objects()
        still = self._store.geometry()
        state = self._source.state
        if not state:
            return still
        self._write_state(state)
        return (self._store.state(state) or WorldState()).geometry(still)

    @property
    def instant(self) -> Instant:
        for instant in (self._source.instant, self._requested):
            if instant is not None and instant.state == self.state:
                return instant
        return Instant()

    def at(self, instant: Instant) -> Source:
        """As :meth:`Source.at`; records into the same file. What is known of shapes is read before."""
        objects = self.objects()
        source = self._source.at(instant)
        known = (source.state, objects)  # the objects are the same, elsewhere
        return copy_with(self, _source=source, _requested=instant, _objects=known, _owns_store=False)

    @contextlib.contextmanager
    def one_instant(self) -> Iterator[None]:
        """As :meth:`Source.one_instant`: one change of the file, which other processes wait for."""
        renewed = None if self._captured_anew is None else set(self._captured_anew)
        self._new = 0
        with self._lock, self._source.one_instant(), self._store.transaction():
            try:
                yield
            except BaseException:
                self._captured_anew = renewed
                self._objects = None
                self._described_state = ""
                raise

    def share_exposure(self, shared: SharedExposure) -> None:
        if self._captured_anew is None:
            shared.value = self._store.exposure() or shared.value
        super().share_exposure(shared)

    def close(self) -> None:
        self._objects = None
        try:
            if self._owns_store:
                self._store.close()
        finally:
            super().close()

    def __reduce__(self) -> NoReturn:
        raise not_picklable(str(self._store.path))

    def _read(self, request: Request) -> Capture:
        if capture := self._store.get(replace(request, again=False)):
            return replace(capture, request=request)
        raise MissingCaptureError("a capture was removed while recording", self._store.path)

    def _capture_and_write(self, requests: Iterable[Request]) -> Iterator[Capture]:
        for capture in map(self._source.stated, self._source.capture(requests)):
            if capture.request.again:
                self._compare(capture)
            else:
                self._write(capture)
            yield capture

    def _compare(self, again: Capture) -> None:
        """Refuse new captures beside recorded ones of the same state that show another world."""
        once = replace(again.request, again=False)
        if once in self._made or self._captured_anew is not None:
            return
        recorded = self._store.get(once)
        if recorded is not None and not np.array_equal(recorded.pixels, again.pixels):
            expected = f"{self._store.path}: expected a world that stands still, as the recording shows it"
            actual = f"got another {once.mode}: what moves by itself is elsewhere now"
            raise OtherMomentError(f"{expected}, {actual}; record into a new file")

    def _write(self, capture: Capture) -> None:
        """Write a new capture, and before it what it depends on; RecordingError if it is of another scene."""
        scene = self._source.scene_identity
        if scene != self._scene:  # a game may have left the level
            self._store.set_scene(scene)
            self._scene = scene
        self._check_dialect(capture)
        if capture.mode in labelled_modes():
            self.objects()  # a mask without them would take the names of others
        if capture.request.state:
            self._write_state(capture.request.state)
        self._store.add(capture)
        self._made.add(capture.request)
        if self._captured_anew is not None:
            self._captured_anew.add(capture.request)

    def _check_dialect(self, capture: Capture) -> None:
        """Raise OtherSceneError if a capture's dialect differs from that of the file's captures.

        A dialect is the commands and replies of one kind of server (docs/glossary.md), and depth, masks or
        colours of two dialects may mean different things. ``scene`` fits all dialects: its captures are
        traced in this process. The first capture sets the dialect of a file that has none.
        """
        dialect = capture.provenance.get("dialect")
        if self._dialect is None:
            self._dialect = self._store.dialect() or dialect
        server_dialects = {dialect, self._dialect} - {None, "scene"}
        if len(server_dialects) > 1:
            expected = f"expected captures of dialect {self._dialect}, as those in it"
            raise OtherSceneError(f"{expected}, got {dialect}; record into another file", self._store.path)

    def _write_state(self, state: str) -> None:
        """Write what is known of a state, once."""
        if self._described_state == state:
            return
        if self._captured_anew is not None or self._store.state(state) is None:
            self._store.set_state(state, self._world_state(state))
        self._described_state = state

    def _world_state(self, state: str) -> WorldState:
        """Return what the source knows of a state, with the boxes that are not as in the still world."""
        still = self._store.geometry().to_dict()["boxes"]
        moved = {}
        for name, box in self._source_geometry().boxes.items():
            if box.to_dict() != still.get(name):
                moved[name] = box
        instant = self.instant if self.instant.state == state else None
        poses = dict(self._source.poses())  # without those that were set
        for name in instant.poses if instant else ():
            poses.pop(name, None)
        requested = None if self._requested is None else self._requested.state
        return WorldState(instant, moved, None if requested == state else requested, poses)

    def _source_geometry(self) -> SceneGeometry:
        """Return what the source knows of shapes; empty after a fault, which does not end the recording."""
        try:
            return self._source.geometry()
        except SourceError as fault:
            _log.warning("%s: no boxes of objects are recorded: %s", self._store.path, fault)
            return SceneGeometry()


record = Recording
"""``record(source, path)``: record what a source captures into a file, and replay what the file holds."""
