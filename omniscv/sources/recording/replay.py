"""Replay of a recording, and the views that it holds of each state of the world."""

import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from omniscv import modalities, storage
from omniscv.arguments import shown
from omniscv.errors import MissingCaptureError
from omniscv.geometry import Pose
from omniscv.geometry.instant import Instant
from omniscv.geometry.scene_geometry import SceneGeometry
from omniscv.modalities import TRANSFERS
from omniscv.parallel import side_by_side
from omniscv.sources.base import (
    STATIC_SETTINGS,
    Capabilities,
    Capture,
    ObjectTable,
    Request,
    SceneIdentity,
    Source,
    View,
    copy_with,
)
from omniscv.sources.recorded_views import RecordedViews
from omniscv.sources.recording.rows import Row, sizes_of, view_from_json
from omniscv.sources.recording.store import Store
from omniscv.sources.recording.world_rows import WorldState, object_from_json
from omniscv.sources.requests import Response, ViewKey, exposures_of, merge_exposures, response_of

_AXIS_DECIMALS = 6  # optical axes that agree to these decimals are the same
_MOST_SHOWN = 5  # states
_MOST_MODES = 20  # that are shown

_TRANSFER = re.compile(f'"transfer": ?"({"|".join(TRANSFERS)})"')
_READ_AHEAD = 6  # captures decoded together: all faces of an optical centre in a mode


class StateViews:
    """The requested views of a state of the world, of rows in the order of recording, parsed on first use."""

    def __init__(self, rows: Iterable[Row]) -> None:
        self._texts: dict[str, set[str]] = defaultdict(set)
        for row in rows:
            self._texts[row.asked].add(row.mode)

    def __len__(self) -> int:
        return len(self._texts)

    @cached_property
    def modes(self) -> frozenset[str]:
        """The modes of all views."""
        return frozenset().union(*self._texts.values())

    @cached_property
    def views(self) -> tuple[View, ...]:
        """All views, in the order of recording; DamagedRecordingError for what is no view."""
        return tuple(self._modes_of)

    def in_mode(self, mode: str) -> tuple[View, ...]:
        """Return the views that were recorded in a mode."""
        return tuple(view for view in self._modes_of if mode in self._modes_of[view])

    @cached_property
    def index(self) -> RecordedViews:
        """All views by centre, made once for all renderers."""
        return RecordedViews(self.views, self.in_mode)

    @cached_property
    def _modes_of(self) -> dict[View, set[str]]:
        modes: dict[View, set[str]] = defaultdict(set)
        for text, names in self._texts.items():
            modes[view_from_json(text)] |= names
        return modes

    @cached_property
    def _along(self) -> dict[ViewKey, list[View]]:
        along: dict[ViewKey, list[View]] = defaultdict(list)
        for view in self.views:
            along[_axis_key(view)].append(view)
        return along

    def turned(self, view: View) -> tuple[View, ...]:
        """Return other views along the same axis, in at least as many modes."""
        modes = self._modes_of.get(view, set())
        turned = []
        for other in self._along.get(_axis_key(view), ()):
            if other != view and self._modes_of[other] >= modes:
                turned.append(other)
        return tuple(turned)

    def nearest(self, request: Request) -> View | None:
        """Return the view in a request's mode that differs least; None where there is none in that mode."""
        views = self.in_mode(request.mode)
        return min(views, key=lambda view: sum(_distances(view, request.view)), default=None)


NO_VIEWS = StateViews(())


def states_in_words(states: Collection[str]) -> str:
    """Return which states a recording holds captures of."""
    if not states:
        return "no captures"
    names = []
    for state in list(states)[:_MOST_SHOWN]:
        names.append(shown(state) if state else "the still one")
    more = len(states) - len(names)
    return f"captures of the states {', '.join(names)}" + (f" and {more} more" if more else "")


def differences(recorded: View, requested: View) -> str:
    """Return in what a ``recorded`` and a ``requested`` view differ and by how much, with both values."""
    recorded_key = recorded.key()
    requested_key = requested.key()
    metres, turn, opening, _ = _distances(recorded, requested)
    parts = []
    if recorded_key.position != requested_key.position:
        positions = _both(recorded.pose.position, requested.pose.position)
        parts.append(f"position by {metres:.3g} m{positions}")
    if recorded_key.rotation != requested_key.rotation:
        angles = _both(recorded.pose.angles(), requested.pose.angles())
        parts.append(f"orientation by {np.degrees(turn):.3g} deg of yaw, pitch, roll{angles}")
    if recorded_key.fov_deg != requested_key.fov_deg:
        fovs = _both([recorded.fov_deg], [requested.fov_deg])
        parts.append(f"field of view by {np.degrees(opening):.3g} deg{fovs}")
    if recorded_key.lens != requested_key.lens:
        parts.append(f"lens: {recorded.lens} recorded, {requested.lens} requested")
    if (recorded.width, recorded.height) != (requested.width, requested.height):
        sizes = f"{recorded.width} x {recorded.height} recorded, {requested.width} x {requested.height} px"
        parts.append(f"size: {sizes} requested")
    return "; ".join(parts)


def in_words(view: View) -> str:
    """Return a view in a few words."""
    size = f"{view.width} x {view.height} px, fov {view.fov_deg:.6g} deg"
    if view.lens:
        size += f", {view.lens}"
    position = "at ({:.6g}, {:.6g}, {:.6g}) m".format(*view.pose.position)
    angles = [angle + 0.0 for angle in view.pose.angles()]  # no negative zero
    return f"{size}, {position}, " + "yaw {:.6g}, pitch {:.6g}, roll {:.6g} deg".format(*angles)


def _axis_key(view: View) -> ViewKey:
    axis = np.round(view.pose.R_w_c[:, 2], _AXIS_DECIMALS) + 0.0
    return view.key()._replace(rotation=tuple(axis.tolist()))


def _distances(a: View, b: View) -> tuple[float, float, float, float]:
    """Return the distance in metres, in orientation and field of view in radians, in size as a log ratio."""
    chord = float(np.linalg.norm(a.pose.R_w_c - b.pose.R_w_c)) / np.sqrt(8)
    return (
        float(np.linalg.norm(a.pose.position - b.pose.position)),
        2 * float(np.arcsin(min(chord, 1.0))),
        abs(float(np.radians(a.fov_deg - b.fov_deg))),
        float(np.abs(np.log([a.width / b.width, a.height / b.height])).sum()),
    )


def _both(recorded: Iterable[float], requested: Iterable[float]) -> str:
    return f": ({_digits(recorded)}) recorded, ({_digits(requested)}) requested"


def _digits(values: Iterable[float]) -> str:
    return ", ".join(f"{value + 0.0:.10g}" for value in values)  # no negative zero


class RecordedSource(Source):
    """Replays a recording, without any network.

    Args:
        path: the file, or its URL: it is then fetched once into the local cache.
        state: of the world, for which images are planned; requests of other states are replayed too. If no
            capture shows the still world, it is the state that was read in its place.

    Attributes:
        stops: of the exposures that colours are merged from; empty where they are replayed as captured.

    Raises RecordingError if the file is not there, is something else, newer, or damaged, or lacks the state.
    """

    def __init__(self, path: Path | str, state: str = "") -> None:
        # The URL, not its local copy, so that the source can be pickled for another machine:
        self._address = path if storage.is_url(path) else Path(path).absolute()
        self._name = storage.without_secrets(path)
        self._store = Store(storage.fetch_file(path))
        self._owns_store = True
        try:
            rows = self._store.listing()
            rows_of: dict[str, list[Row]] = defaultdict(list)  # by state
            for row in rows:
                rows_of[row.state].append(row)
            self._views = {state: StateViews(rows_of[state]) for state in rows_of}
            self._state = state
            if state == "" and "" not in self._views:
                self._state = self._actual_states.get("", "")
            self._check_holds(self._state)
            # Planned as on the server that was recorded: it may have made no view higher than wide.
            tall = any(height > width for width, height in sizes_of(rows))
        except BaseException:
            self._store.close()
            raise
        stops: set[float] = set()
        self._first_exposure = "{}"  # provenance
        for row in rows:
            row_stops = row.stops
            if row_stops is not None:
                if not stops:
                    self._first_exposure = row.provenance
                stops.add(row_stops)
        self.stops = tuple(sorted(stops))
        modes: set[str] = set()
        for views in self._views.values():
            modes |= views.modes
        self._capabilities = Capabilities(
            modes=frozenset(modes),
            can_set_tall=tall,
            can_set_exposure=bool(stops),
            dialect="recording",
            transfer="linear" if stops else _transfer_of(rows),
            varies=frozenset(("objects", "lights", "materials", "commands")),
        )

    def __repr__(self) -> str:
        count = sum(map(len, self._views.values()))
        name = str(self._name).rpartition("/")[2]
        return f"<RecordedSource {name}: {count} views, {' '.join(sorted(self._capabilities.modes))}>"

    @property
    def capabilities(self) -> Capabilities:
        return self._capabilities

    def response(self) -> Response:
        """Return what the codes of the exposures say of light; ArgumentError if they do not say it."""
        return response_of(object_from_json(self._first_exposure))

    def recorded_views(self) -> tuple[View, ...]:
        """The views of the state that is replayed."""
        return self._views.get(self._state, NO_VIEWS).views

    def recorded(self) -> RecordedViews:
        return self._views.get(self._state, NO_VIEWS).index

    def recorded_in(self, mode: str) -> tuple[View, ...]:
        return self._views.get(self._state, NO_VIEWS).in_mode(mode)

    @property
    def scene_identity(self) -> SceneIdentity:
        return self._store.scene_identity

    @property
    def recorded_origin(self) -> Mapping[str, Any] | None:
        return self._store.origin()

    @property
    def world_digest(self) -> str:
        """The content of the scene that was recorded; the recording's own id where it does not say that."""
        return self.scene_identity.content or self._store.head().id

    def cover(self, view: View) -> tuple[View, ...]:
        """The view, then recorded ones of the same centre, field of view and size, turned about its axis.

        Servers that cannot capture straight up and down are recorded in two such views, in the same modes.
        """
        return (view, *self._views.get(self._state, NO_VIEWS).turned(view))

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        remaining = iter(requests)
        while batch := list(islice(remaining, _READ_AHEAD)):
            yield from side_by_side(self._replay, batch)

    def objects(self) -> ObjectTable:
        return self._store.objects()

    def geometry(self) -> SceneGeometry:
        """As recorded with the objects and the state; empty for sources that know no shapes."""
        return self._world_state.geometry(self._store.geometry())

    @property
    def state(self) -> str:
        return self._state

    @property
    def instant(self) -> Instant:
        return self._world_state.instant or Instant()

    def poses(self, objects: Collection[str] | None = None) -> Mapping[str, Pose]:
        """Of objects that move, as recorded with the state's first capture."""
        return self._world_state.object_poses() if objects is None else {}

    def own_poses(self, time_s: float) -> Mapping[str, Pose] | None:
        return None if any(self._store.states()) else {}

    def variable(self, kind: str) -> Mapping[str, Mapping[str, int]]:
        """What was varied when it was recorded."""
        varied: dict[str, dict[str, int]] = {}
        moved: set[str] = set()  # objects that were not shown and hidden alone
        for state in self._store.states().values():
            if not state.instant:
                continue
            for name, settings in state.instant.varied.get(kind, {}).items():
                varied[name] = {key: np.size(settings[key]) for key in settings}
                if settings.keys() - STATIC_SETTINGS:
                    moved.add(name)
        if kind != "objects":
            return varied
        known = dict(super().variable(kind))
        for name in known:
            if moved and name not in moved:
                known[name] = STATIC_SETTINGS
        return known

    def states(self) -> tuple[str, ...]:
        """The states that captures show, in the order of recording; the still one is empty."""
        return tuple(self._views)

    def at(self, instant: Instant) -> "RecordedSource":
        """As :meth:`Source.at`; several may be used at the same time, as long as this source is open.

        Where poses were not set but read when it was recorded, it is the state that was found then.
        """
        state = instant.state
        if state not in self._views:
            state = self._actual_states.get(state, state)
        self._check_holds(state)
        return copy_with(self, _state=state, _owns_store=False)

    def close(self) -> None:
        if self._owns_store:
            self._store.close()

    def __reduce__(self) -> tuple[Any, ...]:
        return RecordedSource, (self._address, self._state)

    @property
    def _world_state(self) -> WorldState:
        """What is known of the state that is replayed; nothing of the still one."""
        return self._store.state(self._state) or WorldState()

    @cached_property
    def _actual_states(self) -> dict[str, str]:
        """By the state that was to be set, the last one in which the world was found."""
        known = self._store.states()
        actual = {}
        for state in self._views:
            requested = known[state].asked if state else None
            if requested is not None:
                actual[requested] = state
        return actual

    def _check_holds(self, state: str) -> None:
        if state and state not in self._views:
            expected = f"expected captures of the world in state {shown(state)}"
            recorded = states_in_words(self._views)
            raise MissingCaptureError(f"{expected}, the recording holds {recorded}", self._name)

    def _replay(self, request: Request) -> Capture:
        if self.stops:
            exposures = exposures_of(request, self.stops)
            if exposures != [request]:
                return merge_exposures(request, list(map(self._replay, exposures)))
        if capture := self._store.get(request):
            return capture
        there = f"'omniscv recording places {self._name}' lists what is there"
        advice = f"{there}, 'omniscv record' adds captures"
        raise MissingCaptureError(self._explain(request), self._name, advice)

    def _explain(self, request: Request) -> str:
        """Return what is missing, and what is there."""
        at = "" if request.stops is None else f" at {request.stops:+g} stops"
        expected = f"expected a {request.mode} capture{at} of {in_words(request.view)}"
        views = self._views.get(request.state)
        if views is None:
            state = f" in state {shown(request.state)}" if request.state else ""
            return f"{expected}{state}; the recording holds {states_in_words(self._views)}"
        nearest = views.nearest(request)
        if nearest is None:
            modes = []
            for mode in sorted(views.modes)[:_MOST_MODES]:
                modes.append(mode if mode in modalities.names() else shown(mode))
            return f"{expected}; the recording holds no {request.mode}, only {', '.join(modes)}"
        return f"{expected}; the nearest recorded view differs in {differences(nearest, request.view)}"


def _transfer_of(rows: Iterable[Row]) -> Any:
    """Return the transfer that the provenance of all colours names; ``unknown`` where they differ."""
    transfers = set()
    for row in rows:
        if row.mode == "lit":
            match = _TRANSFER.search(row.provenance)
            transfers.add(match[1] if match else "unknown")
    return transfers.pop() if len(transfers) == 1 else "unknown"
