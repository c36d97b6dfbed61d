"""The views that a recording holds of each state of the world: which are near each other, how they differ."""

from collections import defaultdict
from collections.abc import Collection, Iterable, Sequence
from functools import cached_property

import numpy as np

from omniscv.arguments import shown
from omniscv.sources.base import Request, View
from omniscv.sources.recording.rows import Row, view_from_json
from omniscv.sources.requests import ViewKey

_AXIS_DECIMALS = 6  # optical axes that agree to these decimals are the same
_MOST_SHOWN = 5  # states


class RecordedViews:
    """The requested views of a state of the world, parsed on first use.

    Args:
        rows: captures of the state, in the order of recording.
    """

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
        others = (other for other in self._along.get(_axis_key(view), ()) if other != view)
        return tuple(other for other in others if self._modes_of[other] >= modes)

    def nearest(self, request: Request) -> View | None:
        """Return the view in a request's mode that differs least; None where there is none in that mode."""
        views = [view for view in self.views if request.mode in self._modes_of[view]]
        return min(views, key=lambda view: sum(_distances(view, request.view)), default=None)


NO_VIEWS = RecordedViews(())


def views_by_state(rows: Sequence[Row]) -> dict[str, RecordedViews]:
    """Return the requested views of captures, by state in the order of recording."""
    of_state: dict[str, list[Row]] = defaultdict(list)
    for row in rows:
        of_state[row.state].append(row)
    return {state: RecordedViews(group) for state, group in of_state.items()}


def states_in_words(states: Collection[str]) -> str:
    """Return which states a recording holds captures of."""
    if not states:
        return "no captures"
    names = [shown(state) if state else "the still one" for state in list(states)[:_MOST_SHOWN]]
    more = len(states) - len(names)
    return f"captures of the states {', '.join(names)}" + (f" and {more} more" if more else "")


def differences(recorded: View, requested: View) -> str:
    """Return in what two views differ and by how much, with both values."""
    a, b = recorded.key(), requested.key()
    metres, *radians, _ = _distances(recorded, requested)
    turn_deg, opening_deg = np.degrees(radians)
    parts = []
    if a.position != b.position:
        positions = recorded.pose.position, requested.pose.position
        parts.append(f"position by {metres:.3g} m{_both(*positions)}")
    if a.rotation != b.rotation:
        angles = recorded.pose.angles(), requested.pose.angles()
        parts.append(f"orientation by {turn_deg:.3g} deg of yaw, pitch, roll{_both(*angles)}")
    if a.fov_deg != b.fov_deg:
        angles_deg = (recorded.fov_deg,), (requested.fov_deg,)
        parts.append(f"field of view by {opening_deg:.3g} deg{_both(*angles_deg)}")
    if a.lens != b.lens:
        parts.append(f"lens: {recorded.lens} recorded, {requested.lens} requested")
    if (a.width, a.height) != (b.width, b.height):
        parts.append(f"size: {a.width} x {a.height} recorded, {b.width} x {b.height} px requested")
    return "; ".join(parts)


def in_words(view: View) -> str:
    """Return a view in a few words."""
    size = f"{view.width} x {view.height} px, fov {view.fov_deg:.6g} deg"
    size += f", {view.lens}" if view.lens else ""
    position = "at ({:.6g}, {:.6g}, {:.6g}) m".format(*view.pose.position)
    angles = (angle + 0.0 for angle in view.pose.angles())  # no negative zero
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
    """Return two tuples of numbers with as few digits as show a difference; nothing if none do."""
    for digits in range(4, 18):
        a, b = (
            ", ".join(f"{value + 0.0:.{digits}g}" for value in values) for values in (recorded, requested)
        )
        if a != b:
            return f": ({a}) recorded, ({b}) requested"
    return ""
