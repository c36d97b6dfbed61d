"""Replay of a recording, and a source that records what it captures."""

import logging
import threading
from collections import defaultdict, deque
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from omniscv import modalities
from omniscv.arguments import shown
from omniscv.errors import ArgumentError, MissingCaptureError, SourceError
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
from omniscv.sources.recording.rows import view_from_json
from omniscv.sources.recording.store import Store

_READ_AHEAD = 6  # captures decoded together: all faces of an optical centre in a mode
_AXIS_DECIMALS = 6  # optical axes that agree to these decimals are the same
_log = logging.getLogger("omniscv")
_RECORDED_AHEAD = 24  # requests in a row that the file holds, which are replayed before more are read


class RecordedSource(Source):
    """Replays a recording, without any network.

    Raises:
        RecordingError: the file is not there, is something else, newer, or damaged.
    """

    def __init__(self, path: Path | str) -> None:
        self._store = Store(path)
        modes: dict[View, set[str]] = defaultdict(set)
        for row in self._store.listing():
            modes[view_from_json(row.asked)].add(row.mode_name)
        self._modes = dict(modes)
        self._along: dict[tuple[Any, ...], list[View]] = defaultdict(list)
        for view in self._modes:
            self._along[_axis_key(view)].append(view)
        # Planned as on the server that was recorded: it may have made no view higher than wide.
        tall = any(view.height > view.width for view in self._modes)
        self._capabilities = Capabilities(
            modes=frozenset().union(*modes.values()), can_set_tall=tall, dialect="recording"
        )

    @property
    def capabilities(self) -> Capabilities:
        return self._capabilities

    def recorded_views(self) -> tuple[View, ...]:
        return tuple(self._modes)

    @property
    def scene_identity(self) -> SceneIdentity:
        return self._store.scene_identity

    def cover(self, view: View) -> tuple[View, ...]:
        """The view, then recorded ones of the same centre, field of view and size, turned about its axis.

        Servers that cannot capture straight up and down are recorded in two such views. Views that were
        recorded in fewer modes than this one are left out.
        """
        wanted = self._modes.get(view, set())
        turned = (each for each in self._along.get(_axis_key(view), ()) if each != view)
        return (view, *(each for each in turned if self._modes[each] >= wanted))

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        coming = iter(requests)
        while batch := list(islice(coming, _READ_AHEAD)):
            yield from side_by_side(self._replayed, batch)

    def objects(self) -> ObjectTable:
        return self._store.objects()

    def geometry(self) -> SceneGeometry:
        """As recorded with the objects; empty in files of omniscv 0.1, and of sources that know no shapes."""
        return self._store.geometry()

    def close(self) -> None:
        self._store.close()

    def __reduce__(self) -> tuple[Any, ...]:
        return RecordedSource, (self._store.path.absolute(),)

    def _replayed(self, request: Request) -> Capture:
        if capture := self._store.get(request):
            return capture
        raise MissingCaptureError(f"{self._store.path}: {self._explain(request)}")

    def _explain(self, request: Request) -> str:
        wanted = f"expected a {request.mode} capture of {_describe(request.view)}"
        views = [view for view, modes in self._modes.items() if request.mode in modes]
        if not views:
            known = modalities.names()
            modes = ", ".join(
                mode if mode in known else shown(mode) for mode in sorted(self._capabilities.modes)[:20]
            )
            modes = modes or "nothing"
            return f"{wanted}; the recording holds no {request.mode}, only {modes}"
        nearest = min(views, key=lambda view: sum(_distances(view, request.view)))
        return f"{wanted}; the nearest recorded view differs in {_differences(nearest, request.view)}"


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
        self._objects: ObjectTable | None = None
        self._labelled = set(labelled_modes())
        self._lock = threading.Lock()

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        """As :meth:`Source.capture`; a new capture is in the file before it is yielded."""
        coming = iter(requests)
        self._store.set_scene(self._source.scene_identity)  # which a game may have left
        while True:
            waiting: deque[Request] = deque()
            for fresh in self._source.capture(self._missing(coming, waiting)):
                if fresh.mode in self._labelled:
                    self.objects()  # a mask without them would take the names of others
                self._store.add(fresh)
                if self._renewed is not None:
                    self._renewed.add(fresh.request)
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
            if self._objects is None:
                self._store.set_objects(self._source.objects())
                if self._renewed is not None or not self._store.geometry():
                    self._store.set_geometry(self._known_geometry())
                self._objects = self._store.objects()
            return self._objects

    def geometry(self) -> SceneGeometry:
        """What is known of shapes, as written to the file."""
        self.objects()
        return self._store.geometry()

    def _known_geometry(self) -> SceneGeometry:
        """What the source knows of shapes; a fault is no reason not to record captures."""
        try:
            return self._source.geometry()
        except SourceError as fault:
            _log.warning("%s: no boxes of objects are recorded: %s", self._store.path, fault)
            return SceneGeometry()

    def close(self) -> None:
        try:
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
            held = self._store.holds(request) if self._renewed is None else request in self._renewed
            if held or request in captured:
                in_a_row += 1
                if in_a_row == _RECORDED_AHEAD:
                    return
            else:
                in_a_row = 0
                captured.add(request)
                yield request

    def _stored(self, request: Request) -> Capture:
        if stored := self._store.get(request):
            return stored
        raise MissingCaptureError(f"{self._store.path}: a capture was removed while recording")


record = Recording
"""``record(source, path)``: record what a source captures into a file, and replay what the file holds."""


def _axis_key(view: View) -> tuple[Any, ...]:
    width, height, *numbers, fov_deg = view.key()
    axis = np.round(view.pose.R_w_c[:, 2], _AXIS_DECIMALS) + 0.0
    return (width, height, fov_deg, *numbers[:3], *axis.tolist())


def _distances(a: View, b: View) -> tuple[float, float, float, float]:
    """Of position in metres, orientation and field of view in radians, size as a log ratio."""
    chord = float(np.linalg.norm(a.pose.R_w_c - b.pose.R_w_c)) / np.sqrt(8)
    return (
        float(np.linalg.norm(a.pose.position - b.pose.position)),
        2 * float(np.arcsin(min(chord, 1.0))),
        abs(float(np.radians(a.fov_deg - b.fov_deg))),
        float(np.abs(np.log([a.width / b.width, a.height / b.height])).sum()),
    )


def _differences(a: View, b: View) -> str:
    """What differs of a recorded and a requested view: by how much, and both values."""
    metres, *radians, _ = _distances(a, b)
    angle, opening = np.degrees(radians)
    angles = a.pose.angles(), b.pose.angles()
    parts = (
        (slice(2, 5), f"position by {metres:.3g} m", (a.pose.position, b.pose.position)),
        (slice(5, 14), f"orientation by {angle:.3g} deg of yaw, pitch, roll", angles),
        (slice(14, 15), f"field of view by {opening:.3g} deg", ((a.fov_deg,), (b.fov_deg,))),
    )
    found = [text + _both(*both) for part, text, both in parts if a.key()[part] != b.key()[part]]
    if a.key()[:2] != b.key()[:2]:
        found.append(f"size: {a.width} x {a.height} recorded, {b.width} x {b.height} px requested")
    return "; ".join(found)


def _both(recorded: Iterable[float], requested: Iterable[float]) -> str:
    """Two tuples of numbers with as few digits as tell them apart; empty where no digits do."""
    for digits in range(4, 18):
        a, b = (", ".join(f"{number + 0.0:.{digits}g}" for number in each) for each in (recorded, requested))
        if a != b:
            return f": ({a}) recorded, ({b}) requested"
    return ""


def _describe(view: View) -> str:
    size = f"{view.width} x {view.height} px, fov {view.fov_deg:.6g} deg"
    place = "at ({:.6g}, {:.6g}, {:.6g}) m".format(*view.pose.position)
    angles = (angle + 0.0 for angle in view.pose.angles())  # no negative zero
    return f"{size}, {place}, " + "yaw {:.6g}, pitch {:.6g}, roll {:.6g} deg".format(*angles)
