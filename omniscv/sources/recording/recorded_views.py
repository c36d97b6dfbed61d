"""The views that a recording holds of a state of the world: which are near each other, how they differ."""

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping
from typing import Any

import numpy as np

from omniscv.arguments import shown
from omniscv.sources.base import Request, View

_AXIS_DECIMALS = 6  # optical axes that agree to these decimals are the same
_MOST_SHOWN = 5  # states


class RecordedState:
    """What a recording holds of a state of the world.

    Args:
        modes: by view, in the order of recording.

    Attributes:
        views: all of them.
        modes: of all of them.
    """

    def __init__(self, modes: Mapping[View, Collection[str]]) -> None:
        self.views, self.modes = tuple(modes), frozenset().union(*modes.values())
        self._of = {view: frozenset(each) for view, each in modes.items()}
        self._along: dict[tuple[Any, ...], list[View]] = defaultdict(list)
        for view in self.views:
            self._along[_axis_key(view)].append(view)

    def turned(self, view: View) -> tuple[View, ...]:
        """Return other views along the same axis, in as many modes at least."""
        wanted = self._of.get(view, frozenset())
        turned = (each for each in self._along.get(_axis_key(view), ()) if each != view)
        return tuple(each for each in turned if self._of[each] >= wanted)

    def nearest(self, request: Request) -> View | None:
        """Return the view in a request's mode that differs least; None where there is none in that mode."""
        views = [view for view in self.views if request.mode in self._of[view]]
        return min(views, key=lambda view: sum(_distances(view, request.view)), default=None)


NOTHING = RecordedState({})


def states_in_words(states: Collection[str]) -> str:
    """Return which states a recording holds captures of."""
    if not states:
        return "no captures"
    some = [shown(state) if state else "the still one" for state in list(states)[:_MOST_SHOWN]]
    more = len(states) - len(some)
    return f"captures of the states {', '.join(some)}" + (f" and {more} more" if more else "")


def _axis_key(view: View) -> tuple[Any, ...]:
    axis = np.round(view.pose.R_w_c[:, 2], _AXIS_DECIMALS) + 0.0
    return view.key()._replace(rotation=tuple(axis.tolist()))


def _distances(a: View, b: View) -> tuple[float, float, float, float]:
    """Of position in metres, orientation and field of view in radians, size as a log ratio."""
    chord = float(np.linalg.norm(a.pose.R_w_c - b.pose.R_w_c)) / np.sqrt(8)
    return (
        float(np.linalg.norm(a.pose.position - b.pose.position)),
        2 * float(np.arcsin(min(chord, 1.0))),
        abs(float(np.radians(a.fov_deg - b.fov_deg))),
        float(np.abs(np.log([a.width / b.width, a.height / b.height])).sum()),
    )


def differences(a: View, b: View) -> str:
    """Return what differs of a recorded and a requested view: by how much, and both values."""
    metres, *radians, _ = _distances(a, b)
    angle, opening = np.degrees(radians)
    angles = a.pose.angles(), b.pose.angles()
    parts = (
        ("position", f"position by {metres:.3g} m", (a.pose.position, b.pose.position)),
        ("rotation", f"orientation by {angle:.3g} deg of yaw, pitch, roll", angles),
        ("fov_deg", f"field of view by {opening:.3g} deg", ((a.fov_deg,), (b.fov_deg,))),
    )
    found = [
        text + _both(*both) for part, text, both in parts if getattr(a.key(), part) != getattr(b.key(), part)
    ]
    if (a.width, a.height) != (b.width, b.height):
        found.append(f"size: {a.width} x {a.height} recorded, {b.width} x {b.height} px requested")
    return "; ".join(found)


def _both(recorded: Iterable[float], requested: Iterable[float]) -> str:
    """Two tuples of numbers with as few digits as tell them apart; empty where no digits do."""
    for digits in range(4, 18):
        a, b = (", ".join(f"{number + 0.0:.{digits}g}" for number in each) for each in (recorded, requested))
        if a != b:
            return f": ({a}) recorded, ({b}) requested"
    return ""


def in_words(view: View) -> str:
    """Return a view in a few words."""
    size = f"{view.width} x {view.height} px, fov {view.fov_deg:.6g} deg"
    place = "at ({:.6g}, {:.6g}, {:.6g}) m".format(*view.pose.position)
    angles = (angle + 0.0 for angle in view.pose.angles())  # no negative zero
    return f"{size}, {place}, " + "yaw {:.6g}, pitch {:.6g}, roll {:.6g} deg".format(*angles)
