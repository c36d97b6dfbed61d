"""Replay of a recording."""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

from omniscv import modalities, storage
from omniscv.arguments import shown
from omniscv.errors import MissingCaptureError
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
    View,
)
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


class RecordedSource(Source):
    """Replays a recording, without any network.

    Args:
        path: the file, or its URL: it is then fetched once into the local cache.
        state: of the world, in which images are planned; requests of any other are replayed too. If no
            capture is of the still world, the state that was found where none was to be set.

    Raises:
        RecordingError: the file is not there, is something else, newer, or damaged, or lacks the state.
    """

    def __init__(self, path: Path | str, state: str = "") -> None:
        # Of a URL, and not of the copy, so that it may be opened on another machine:
        self._where = path if storage.is_url(path) else Path(path).absolute()
        self._store, self._state, self._owner = Store(storage.fetch_file(path)), state, True
        self._shown = storage.without_secrets(path)
        modes: dict[str, dict[View, set[str]]] = defaultdict(lambda: defaultdict(set))
        for row in self._store.listing():
            modes[row.state][view_from_json(row.asked)].add(row.mode_name)
        self._views = {state: RecordedState(held) for state, held in modes.items()}
        known = self._store.states()
        # The last one counts of several states that the world was found in.
        self._found = {known[each].asked: each for each in modes if each and known[each].asked is not None}
        if state == "" and "" not in modes:
            self._state = self._found.get("", "")
        # Planned as on the server that was recorded: it may have made no view higher than wide.
        tall = any(view.height > view.width for held in modes.values() for view in held)
        every = frozenset().union(*(each for held in modes.values() for each in held.values()))
        self._capabilities = Capabilities(modes=every, can_set_tall=tall, dialect="recording")
        try:
            self._check_held(self._state)
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
        """As recorded with the state's first capture."""
        return (self._store.state(self._state) or HeldState()).object_poses()

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
        return sharing(self, _state=state, _owner=False)

    def close(self) -> None:
        if self._owner:
            self._store.close()

    def __reduce__(self) -> tuple[Any, ...]:
        return RecordedSource, (self._where, self._state)

    @property
    def _held(self) -> RecordedState:
        return self._views.get(self._state, NOTHING)

    def _check_held(self, state: str) -> None:
        if state and state not in self._views:
            wanted = f"expected captures of the world in state {shown(state)}"
            held = states_in_words(self._views)
            raise MissingCaptureError(f"{self._shown}: {wanted}, the recording holds {held}")

    def _replayed(self, request: Request) -> Capture:
        if capture := self._store.get(request):
            return capture
        raise MissingCaptureError(f"{self._shown}: {self._explain(request)}")

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
"""The opener of :mod:`omniscv.sources.registry` for addresses without a scheme, and with that of a store."""


def sharing(source: S, **changes: object) -> S:
    """Return another source of the same kind, which shares all but these attributes."""
    found = object.__new__(type(source))
    vars(found).update(vars(source), **changes)
    return found
