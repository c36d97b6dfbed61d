"""A source that records what another one captures."""

import contextlib
import logging
import threading
from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import NoReturn

from omniscv.errors import ArgumentError, MissingCaptureError, SourceError
from omniscv.geometry.instant import Instant
from omniscv.geometry.scene_geometry import SceneGeometry
from omniscv.sources.base import Capture, ObjectTable, Request, Source, SourceWrapper, not_picklable
from omniscv.sources.ordered import Held, in_order
from omniscv.sources.recording.object_tables import labelled_modes
from omniscv.sources.recording.replay import sharing
from omniscv.sources.recording.state_table import HeldState
from omniscv.sources.recording.store import Store

_log = logging.getLogger("omniscv")


class Recording(SourceWrapper):
    """Replays what a file holds; captures the rest from another source and writes it to the file.

    Args:
        source: where new captures come from; closed with this.
        path: the file; created if there is none.
        anew: capture again what the file held before; the new capture replaces the old one.

    Raises:
        ArgumentError: ``source`` is no source.
        RecordingError: the file is something else, newer, damaged, cannot be written, or holds captures of
            another scene.
    """

    def __init__(self, source: Source, path: Path | str, *, anew: bool = False) -> None:
        if not isinstance(source, Source):
            raise ArgumentError(f"source: expected an open source, got {source!r}; open it with open_source")
        super().__init__(source)
        self._store = Store(path, write=True)
        try:
            self._store.set_scene(source.scene_identity)
        except BaseException:
            self._store.close()
            raise
        self._renewed: set[Request] | None = set() if anew else None
        self._objects: tuple[str, ObjectTable] | None = None  # and the state in which they were read
        self._noted = ""  # the state of which the file has what is known
        self._instant: Instant | None = None  # that was to be set
        self._owner = True
        self._labelled = set(labelled_modes())
        self._lock = threading.RLock()

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        """As :meth:`Source.capture`; a new capture is in the file before it is yielded."""
        captured: set[Request] = set()

        def find(request: Request) -> Held | None:
            if request.again or not (request in captured or self._holds(request)):
                captured.add(request)
                return None
            return partial(self._stored, request)

        return in_order(requests, find, self._capture_and_add)

    def objects(self) -> ObjectTable:
        """The objects, with those that the file had before; written to it by :meth:`Store.set_objects`, and
        with them what is known of shapes."""
        with self._lock:
            state = self._source.state
            if self._objects is None or self._objects[0] != state:
                self._store.set_objects(self._source.objects())
                if not state and (self._renewed is not None or not self._store.geometry()):
                    self._store.set_geometry(self._known_geometry())
                self._objects = state, self._store.objects()
            return self._objects[1]

    def geometry(self) -> SceneGeometry:
        """What is known of shapes, as written to the file."""
        self.objects()
        still, state = self._store.geometry(), self._source.state
        if not state:
            return still
        self._note_state(state)
        return (self._store.state(state) or HeldState()).geometry(still)

    @property
    def instant(self) -> Instant:
        known = (self._source.instant, self._instant or Instant())
        return next((each for each in known if each.state == self.state), Instant())

    def at(self, instant: Instant) -> Source:
        """As :meth:`Source.at`; records into the same file. What is known of shapes is read before."""
        objects = self.objects()
        source = self._source.at(instant)
        known = source.state, objects  # which are the same, elsewhere
        return sharing(self, _source=source, _instant=instant, _objects=known, _owner=False)

    @contextlib.contextmanager
    def one_instant(self) -> Iterator[None]:
        """As :meth:`Source.one_instant`: one change of the file, which others wait for."""
        renewed = None if self._renewed is None else set(self._renewed)
        with self._lock, self._source.one_instant(), self._store.all_or_none():
            try:
                yield
            except BaseException:
                self._renewed, self._objects, self._noted = renewed, None, ""
                raise

    def _capture_and_add(self, requests: Iterable[Request]) -> Iterator[Capture]:
        self._store.set_scene(self._source.scene_identity)  # which a game may have left
        for capture in self._source.capture(requests):
            self._add(capture)
            yield capture

    def _add(self, fresh: Capture) -> None:
        """Write a new capture, and before it what it depends on."""
        if fresh.request.again:
            return
        if fresh.mode in self._labelled:
            self.objects()  # a mask without them would take the names of others
        if fresh.request.state:
            self._note_state(fresh.request.state)
        self._store.add(fresh)
        if self._renewed is not None:
            self._renewed.add(fresh.request)

    def _note_state(self, state: str) -> None:
        """Write what is known of a state, once: the boxes of all objects that are elsewhere too."""
        if self._noted == state:
            return
        if self._renewed is not None or self._store.state(state) is None:
            still = self._store.geometry().to_dict()["boxes"]
            boxes = self._known_geometry().boxes
            moved = {name: box for name, box in boxes.items() if box.to_dict() != still.get(name)}
            known = self.instant if self.instant.state == state else None
            asked = None if self._instant is None or self._instant.state == state else self._instant.state
            set_ = known.poses if known else {}
            poses = {name: each for name, each in self._source.object_poses().items() if name not in set_}
            self._store.set_state(state, HeldState(known, moved, asked, poses))
        self._noted = state

    def _known_geometry(self) -> SceneGeometry:
        """What the source knows of shapes; a fault is no reason not to record captures."""
        try:
            return self._source.geometry()
        except SourceError as fault:
            _log.warning("%s: no boxes of objects are recorded: %s", self._store.path, fault)
            return SceneGeometry()

    def close(self) -> None:
        try:
            if self._owner:
                self._store.close()
        finally:
            super().close()

    def __reduce__(self) -> NoReturn:
        raise not_picklable(str(self._store.path))

    def _holds(self, request: Request) -> bool:
        return self._store.holds(request) if self._renewed is None else request in self._renewed

    def _stored(self, request: Request) -> Capture:
        if stored := self._store.get(request):
            return stored
        raise MissingCaptureError(f"{self._store.path}: a capture was removed while recording")


record = Recording
"""``record(source, path)``: record what a source captures into a file, and replay what the file holds."""
