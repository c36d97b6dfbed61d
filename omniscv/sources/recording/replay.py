"""Replay of a recording, and a source that records what it captures."""

import contextlib
import logging
import threading
from collections import defaultdict, deque
from collections.abc import Iterable, Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from omniscv import modalities
from omniscv.arguments import shown
from omniscv.errors import ArgumentError, MissingCaptureError, SourceError
from omniscv.geometry import Pose
from omniscv.geometry.instant import Instant
from omniscv.geometry.scene_geometry import SceneGeometry
from omniscv.parallel import side_by_side
from omniscv.sources.base import (
    Capabilities,
    Capture,
    ObjectTable,
    Request,
    SceneIdentity,
    Source,
    SourceWrapper,
    View,
    not_picklable,
)
from omniscv.sources.recording.object_tables import labelled_modes
from omniscv.sources.recording.recorded_views import (
    NOTHING,
    RecordedState,
    differences,
    in_words,
    states_in_words,
)
from omniscv.sources.recording.rows import view_from_json
from omniscv.sources.recording.state_table import HeldState
from omniscv.sources.recording.store import Store

S = TypeVar("S", bound=Source)

_READ_AHEAD = 6  # captures decoded together: all faces of an optical centre in a mode
_log = logging.getLogger("omniscv")
_RECORDED_AHEAD = 24  # requests in a row that the file holds, which are replayed before more are read


class RecordedSource(Source):
    """Replays a recording, without any network.

    Args:
        path: the file.
        state: of the world, in which images are planned; requests of any other are replayed too.

    Raises:
        RecordingError: the file is not there, is something else, newer, or damaged, or lacks the state.
    """

    def __init__(self, path: Path | str, state: str = "") -> None:
        self._store, self._state, self._owner = Store(path), state, True
        modes: dict[str, dict[View, set[str]]] = defaultdict(lambda: defaultdict(set))
        for row in self._store.listing():
            modes[row.state][view_from_json(row.asked)].add(row.mode_name)
        self._views = {state: RecordedState(held) for state, held in modes.items()}
        known = self._store.states()
        # The last one counts of several states that the world was found in.
        self._found = {known[each].asked: each for each in modes if each and known[each].asked is not None}
        # Planned as on the server that was recorded: it may have made no view higher than wide.
        tall = any(view.height > view.width for held in modes.values() for view in held)
        every = frozenset().union(*(each for held in modes.values() for each in held.values()))
        self._capabilities = Capabilities(modes=every, can_set_tall=tall, dialect="recording")
        try:
            self._check_held(state)
        except MissingCaptureError:
            self._store.close()
            raise

    @property
    def capabilities(self) -> Capabilities:
        return self._capabilities

    def recorded_views(self) -> tuple[View, ...]:
        """The views of the state that is replayed."""
        return self._held.views

    @property
    def scene_identity(self) -> SceneIdentity:
        return self._store.scene_identity

    def cover(self, view: View) -> tuple[View, ...]:
        """The view, then recorded ones of the same centre, field of view and size, turned about its axis.

        Servers that cannot capture straight up and down are recorded in two such views. Views that were
        recorded in fewer modes than this one are left out.
        """
        return (view, *self._held.turned(view))

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        coming = iter(requests)
        while batch := list(islice(coming, _READ_AHEAD)):
            yield from side_by_side(self._replayed, batch)

    def objects(self) -> ObjectTable:
        return self._store.objects()

    def geometry(self) -> SceneGeometry:
        """As recorded with the objects, and with the state; empty in files of omniscv 0.1, and of sources
        that know no shapes."""
        still = self._store.geometry()
        return (self._store.state(self._state) or HeldState()).geometry(still)

    @property
    def state(self) -> str:
        return self._state

    @property
    def instant(self) -> Instant:
        held = self._store.state(self._state)
        return held.instant if held and held.instant else Instant()

    def object_poses(self) -> Mapping[str, Pose]:
        return (self._store.state(self._state) or HeldState()).poses

    def states(self) -> tuple[str, ...]:
        """The states that captures show, in the order of recording; the still one is empty."""
        return tuple(self._views)

    def at(self, instant: Instant) -> "RecordedSource":
        """As :meth:`Source.at`; several may be used at the same time, as long as this source is open.

        Where poses were not set but read when it was recorded, it is the state that was found then.
        """
        state = instant.state
        if state not in self._views:
            state = self._found.get(state, state)
        self._check_held(state)
        return _with(self, _state=state, _owner=False)

    def close(self) -> None:
        if self._owner:
            self._store.close()

    def __reduce__(self) -> tuple[Any, ...]:
        return RecordedSource, (self._store.path.absolute(), self._state)

    @property
    def _held(self) -> RecordedState:
        return self._views.get(self._state, NOTHING)

    def _check_held(self, state: str) -> None:
        if state and state not in self._views:
            wanted = f"expected captures of the world in state {shown(state)}"
            held = states_in_words(self._views)
            raise MissingCaptureError(f"{self._store.path}: {wanted}, the recording holds {held}")

    def _replayed(self, request: Request) -> Capture:
        if capture := self._store.get(request):
            return capture
        raise MissingCaptureError(f"{self._store.path}: {self._explain(request)}")

    def _explain(self, request: Request) -> str:
        """What is not there, and what is."""
        wanted = f"expected a {request.mode} capture of {in_words(request.view)}"
        held = self._views.get(request.state)
        if held is None:
            of = f" in state {shown(request.state)}" if request.state else ""
            return f"{wanted}{of}; the recording holds {states_in_words(self._views)}"
        nearest = held.nearest(request)
        if nearest is None:
            known = modalities.names()
            modes = (mode if mode in known else shown(mode) for mode in sorted(held.modes)[:20])
            return f"{wanted}; the recording holds no {request.mode}, only {', '.join(modes)}"
        return f"{wanted}; the nearest recorded view differs in {differences(nearest, request.view)}"


open_recording = RecordedSource
"""The opener of :mod:`omniscv.sources.registry` for addresses without a scheme."""


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
        coming = iter(requests)
        self._store.set_scene(self._source.scene_identity)  # which a game may have left
        while True:
            waiting: deque[Request] = deque()
            for fresh in self._source.capture(self._missing(coming, waiting)):
                self._add(fresh)
                while (request := waiting.popleft()) != fresh.request:
                    yield self._stored(request)
                yield fresh
            if not waiting:
                return
            while waiting:
                yield self._stored(waiting.popleft())

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
        return _with(self, _source=source, _instant=instant, _objects=known, _owner=False)

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
            poses = self._source.object_poses()
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

    def _missing(self, coming: Iterator[Request], waiting: deque[Request]) -> Iterator[Request]:
        """The requests that the file does not hold, each once; all that are read go to ``waiting``."""
        captured: set[Request] = set()
        in_a_row = 0
        for request in coming:
            waiting.append(request)
            if not request.again and (request in captured or self._holds(request)):
                in_a_row += 1
                if in_a_row == _RECORDED_AHEAD:
                    return
            else:
                in_a_row = 0
                captured.add(request)
                yield request

    def _holds(self, request: Request) -> bool:
        return self._store.holds(request) if self._renewed is None else request in self._renewed

    def _stored(self, request: Request) -> Capture:
        if stored := self._store.get(request):
            return stored
        raise MissingCaptureError(f"{self._store.path}: a capture was removed while recording")


record = Recording
"""``record(source, path)``: record what a source captures into a file, and replay what the file holds."""


def _with(source: S, **changes: object) -> S:
    """The same source, which shares all else."""
    found = object.__new__(type(source))
    vars(found).update(vars(source), **changes)
    return found
