"""The outline of a mask as one closed line, for formats whose objects are one polygon."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.int32]
"""(N, 2) x and y of pixels."""


def outline(mask: NDArray[np.uint8]) -> Points:
    """Return the line around the largest part of a mask (H, W), cut open to each of its holes.

    Filled with its border by the even-odd rule, it is that part. A cut goes from the leftmost point of a hole
    along its row to what borders the part there, and back; islands in holes are other parts.
    """
    _, part_of, parts, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    largest = 1 + parts[1:, cv2.CC_STAT_AREA].argmax()
    part = (part_of == largest).astype(np.uint8)
    contours, [tree] = cv2.findContours(part, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    outer = np.empty((0, 2), np.int32)
    holes = []
    for contour, (*_, parent) in zip(contours, tree, strict=True):
        line = contour[:, 0]
        if parent < 0:
            outer = line
        else:
            leftmost = int(line[:, 0].argmin())
            holes.append(np.roll(line, -leftmost, axis=0))
    holes.sort(key=lambda hole: int(hole[0, 0]))
    return _cut_open([outer, *holes])


def _cut_open(lines: Sequence[Points]) -> Points:
    """Return one line of several: the outer one, then holes in the order of their leftmost points, which they
    begin with."""
    places: dict[tuple[int, int], tuple[int, int]] = {}  # by pixel: its line, and its index there
    holes_at: dict[tuple[int, int], list[int]] = {}  # the holes to which a place is connected
    for number, line in enumerate(lines):
        if number:
            x, y = map(int, line[0])
            while (x, y) not in places:  # lines farther left are connected before
                x -= 1
            holes_at.setdefault(places[x, y], []).append(number)
        for index, (x, y) in enumerate(line.tolist()):
            places.setdefault((x, y), (number, index))
    return np.array(_walk(lines, holes_at), np.int32)


def _walk(lines: Sequence[Points], holes_at: dict[tuple[int, int], list[int]]) -> list[list[int]]:
    """Return the points of the first line, with a way to each hole and back where it is connected."""
    points: list[list[int]] = []
    ways: list[_Way] = [_Way(0, enumerate(lines[0].tolist()), [])]
    while ways:
        way = ways[-1]
        place, point = next(way.places, (-1, []))
        if place < 0:
            ways.pop()
            points += way.back
            continue
        points.append(point)
        for hole in holes_at.get((way.line, place), ()):
            around = lines[hole].tolist()
            ways.append(_Way(hole, enumerate(around), [around[0], point]))
    return points


class _Way(NamedTuple):
    """A line on which a walk is: its number, the places that are left, and the points from its end back."""

    line: int
    places: Iterator[tuple[int, list[int]]]
    back: list[list[int]]
