"""Motion of a world, its pause, and the delay until captures show a move."""

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext

import numpy as np

from omniscv.diagnostics import Finding
from omniscv.diagnostics.server import RawCamera, largest_object
from omniscv.errors import ServerRefusedError
from omniscv.sources.unreal.client import Connection
from omniscv.sources.unreal.driver import SETTLED
from omniscv.sources.unreal.instants import clock_of, movable_objects, object_names, object_poses
from omniscv.sources.unreal.objects import colors
from omniscv.sources.unreal.protocol import IS_PAUSED, VERSION, numbers

_TICKS, _FRAMES = 6, 8  # for how long to watch objects, and frames after a move
_AWAY_CM = np.array([40.0, 30.0, 50.0])  # a move that changes the depth of nearly every surface
_NOISE = 0.01  # relative depth
_LISTED = 3  # objects that a finding names


class MovingWorld:
    """The objects and the clock of a game that the doctor examines; it is left as it was."""

    def __init__(self, connection: Connection, camera: RawCamera) -> None:
        self._connection, self._camera = connection, camera
        self._clock = clock_of(camera.driver)
        self._can_stop = False  # whether it moves, and can be paused

    def findings(self) -> list[Finding]:
        """Return three findings: the world moves, the world pauses, captures follow a move."""
        moving = self._moving()
        value = f"yes: {_listed(moving)}" if moving else "no"
        moves = Finding.unless(not moving, "world moves", value, "warning", "--set freeze=puppet, or pause")
        try:
            with self._paused():
                self._can_stop = bool(moving)
                return [moves, self._pauses(), self._follows()]
        except ServerRefusedError as refused:
            pauses = Finding("world pauses", f"no: {refused}", "warning", "--set freeze=batch, or none")
            return [moves, pauses, self._follows()]

    @contextmanager
    def still(self) -> Iterator[None]:
        """A context in which a moving world is paused, after :meth:`findings`."""
        with self._paused() if self._can_stop else nullcontext():
            yield

    def _pauses(self) -> Finding:
        moving = self._moving()
        if moving:
            self._can_stop = False
            value = f"no: {_listed(moving)} still moving"
            return Finding("world pauses", value, "bad", "--set freeze=batch, with branch 5.2; or stop them")
        how = "pauses" if self._connection.supports(IS_PAUSED) else "toggles"
        return Finding("world pauses", f"yes, by a command that {how}")

    def _follows(self) -> Finding:
        """Move the movable object with the most pixels, and count the frames that do not show it yet."""
        title = "captures follow a move"
        movable = movable_objects(self._connection)
        table = {name: color for name, color in colors(self._connection).items() if name in movable}
        name = largest_object(self._camera, table)
        if name is None:
            return Finding(title, "unknown: nothing in sight can be moved", "warning", "give --position")

        def move(*at_cm: float) -> None:
            self._connection.text(" ".join([f"vset {location}", *(f"{value:.6f}" for value in at_cm)]))

        location = f"/object/{name}/location"
        start = np.array(numbers(self._connection.text(f"vget {location}"), 3))
        before = self._camera.pixels("depth")
        try:
            move(*start + _AWAY_CM)
            frames = [self._camera.pixels("depth") for _ in range(_FRAMES)]
        finally:
            move(*start)
        changed = ~np.isclose(before, frames[-1], rtol=_NOISE)
        if not changed.any():
            return Finding(title, f"never: {name} stays", "warning", "set its mobility to Movable")
        late = [np.isclose(frame, frames[-1], rtol=_NOISE)[changed].mean() <= 0.5 for frame in frames]
        count = max((i + 1 for i, stale in enumerate(late) if stale), default=0)
        value = f"stale ticks: {count}" if count else "at once"
        remedy = f"at most {SETTLED} are waited for: raise the frame rate"
        return Finding.unless(count <= SETTLED, title, value, "bad", remedy)

    def _moving(self) -> list[str]:
        """Return the names of objects that move while some ticks go by."""
        names = object_names(self._connection)
        first = object_poses(self._connection, names)
        moving = set()
        for ticks in (_TICKS, 1):  # an object that swings may be back at its pose once, but not twice
            for _ in range(ticks):
                self._connection.text(VERSION)
            poses = object_poses(self._connection, names)
            moving |= {name for name in names if first[name].to_dict() != poses[name].to_dict()}
        return [name for name in names if name in moving]

    @contextmanager
    def _paused(self) -> Iterator[None]:
        before = self._clock.paused
        self._clock.set(True)
        try:
            yield
        finally:
            self._clock.set(before)


def _listed(names: list[str]) -> str:
    more = len(names) - _LISTED
    return ", ".join(names[:_LISTED]) + (f" and {more} more" if more > 0 else "")
