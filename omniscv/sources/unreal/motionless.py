"""Evidence against a camera that a server says it has moved: where it is, and pictures that stay the same."""

from collections import defaultdict
from collections.abc import Hashable, Sequence
from itertools import groupby
from typing import Any

import numpy as np

from omniscv.errors import MisplacedCameraError
from omniscv.geometry import Array
from omniscv.geometry.unreal_frame import position_from_unreal
from omniscv.sources.base import Capture, View
from omniscv.sources.unreal.protocol import numbers

# How far a camera may be from where it was set:
_OFF_CM = 1.0
_SINGLE = 2.0**-22  # a share of its coordinates, for single precision
_DIRECTIONS = 4
"""Directions of views that stand alone at their places, from which on equal pictures are evidence: two may
look alike. Views of one direction that pass along a plain wall are equal and right."""


def check_location(address: str, view: View, reply: str) -> None:
    """Raise MisplacedCameraError for a camera that is not where a view has it.

    Args:
        address: of the server, for the message.
        view: what is captured.
        reply: the location that the server reports, cm; an error if it cannot report it, which is accepted.
    """
    if reply.startswith("error"):
        return
    expected_cm, _ = view.pose.to_unreal()
    actual_cm = np.array(numbers(reply, 3))
    if np.abs(actual_cm - expected_cm).max() <= _OFF_CM + _SINGLE * np.abs(expected_cm).max():
        return
    expected = f"expected a camera at {_metres(view.pose.position)}"
    away_m = np.linalg.norm(actual_cm - expected_cm) / 100
    actual = f"got {away_m:.3g} m away, at {_metres(position_from_unreal(actual_cm))}"
    why = "a collision, or the game itself, moves it, or keeps it where it was"
    raise MisplacedCameraError(f"{address}: {expected}, {actual}: {why}")


class Unmoved:
    """Finds a camera whose pictures do not change though it is aimed elsewhere."""

    def __init__(self, address: str) -> None:
        self._address = address
        self._first: list[Capture] = []  # of a row of views that stand alone at their places
        self._directions: set[Hashable] = set()

    def check(self, captures: Sequence[Capture]) -> None:
        """Refuse captures that show a place in several directions with equal pictures in all modes; and equal
        pictures in many directions, each from a place of its own."""
        for center, group in groupby(captures, lambda capture: capture.view.key().position):
            here = list(group)
            directions: set[Hashable] = {capture.view.key().rotation for capture in here}
            if len(directions) > 1:
                self._first = []
                if all_alike(here):
                    raise self._refused(len(directions), f"directions at {_metres(np.array(center))}")
                continue
            if not self._first or not all_alike([*self._first, *here]):
                self._first = here
                self._directions = set()
            self._directions |= directions
            if len(self._directions) >= _DIRECTIONS:
                raise self._refused(len(self._directions), "directions")

    def _refused(self, count: int, what: str) -> MisplacedCameraError:
        expected = f"expected other pictures in {count} {what}, got the same to the byte in all modes"
        why = "the camera does not move, or there is nothing to see, as in a dark and empty level"
        return MisplacedCameraError(f"{self._address}: {expected}: {why}")


def all_alike(captures: Sequence[Capture]) -> bool:
    """Return whether captures have the same picture of different views in each mode.

    Masks alone are no evidence, as one object may be all around, nor is depth of the sky alone.
    """
    telling_modes: set[str] = set()
    pictures: dict[tuple[Any, ...], set[bytes]] = defaultdict(set)
    poses: dict[tuple[Any, ...], set[Hashable]] = defaultdict(set)
    for capture in captures:
        if capture.mode == "lit" or _has_shapes(capture):
            telling_modes.add(capture.mode)
        view = capture.view
        kind = (capture.mode, view.width, view.height, view.fov_deg, capture.request.stops)
        pictures[kind].add(capture.payload or capture.pixels.tobytes())
        poses[kind].add((view.key().position, view.key().rotation))
    is_evidence = False
    for kind, shown in pictures.items():
        if len(poses[kind]) == 1:
            continue
        if len(shown) > 1:
            return False
        is_evidence |= kind[0] in telling_modes
    return is_evidence


def _has_shapes(capture: Capture) -> bool:
    """Return whether a capture of another mode than masks differs from pixel to pixel."""
    return capture.mode != "object_mask" and bool((capture.pixels != capture.pixels[0, 0]).any())


def _metres(position: Array) -> str:
    return f"({', '.join(f'{value:.4g}' for value in position)}) m"
