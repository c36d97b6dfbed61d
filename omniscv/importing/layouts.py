"""Layouts of six faces: their names in other tools, their places in one picture, and their seams.

A face is a letter, F R B L U D for front, right, back, left, up, down, and the quarter turns clockwise of its
picture: ``U2`` is an *up* turned by 180 degrees. A turn by k quarters is the view ``R_w_f Rz(-90 k)``. Names
are ambiguous, so the seams decide: all 122,880 arrangements that differ by more than a rotation of the cube
are tried.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import permutations, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from omniscv.errors import ArgumentError
from omniscv.geometry import Array, cube_rotations
from omniscv.pictures.forms import Pixels

LETTERS = "FRBLUD"
_SAMPLES = 128  # of an edge
_MOST_STEP = 48.0  # grey levels; a larger step between two pixels says no more
_SAME = 0.25  # grey levels: arrangements whose mean steps differ by less are told apart by names alone
_CLEAR = 1.5  # the second best has so many times the step of the best


class Face(NamedTuple):
    """One of six pictures: which face it shows (row of ``cube_rotations()``), and how it is turned."""

    row: int
    quarters: int = 0

    @classmethod
    def parse(cls, text: str) -> "Face":
        """Return the face of ``U2``, for example."""
        return cls(LETTERS.index(text[0]), int(text[1:] or 0))

    def __str__(self) -> str:
        turned = f" turned by {90 * self.quarters} degrees" if self.quarters else ""
        return cube_rotations()[self.row][0] + turned

    @property
    def R_w_c(self) -> Array:
        """(3, 3) rotation of its view, camera to world."""
        quarter = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])  # Rz(-90)
        return np.asarray(cube_rotations()[self.row][1] @ np.linalg.matrix_power(quarter, self.quarters))


Arrangement = tuple[Face, ...]
"""The faces that six pictures show, in the pictures' order."""


@dataclass(frozen=True)
class Layout:
    """A way to name or to place six faces."""

    name: str
    faces: str  # such as `F R B L U2 D`, in the order of the words or of the cells
    words: tuple[str, ...] = ()  # sets of six words that name files
    cells: str = ""  # rows of one picture, separated by `/`; a face in each `#`, in reading order
    centered: bool = False  # whether the outermost pixels' centres lie on the edges of the cube
    guessed: bool = True  # False if another layout is the same cube, turned

    @property
    def arrangement(self) -> Arrangement:
        """The faces in their order."""
        return tuple(map(Face.parse, self.faces.split()))


_OWN = "front right back left up down"
_NUMBERS = "0 1 2 3 4 5"
_AXES = ("posx negx posy negy posz negz", "px nx py ny pz nz", "+x -x +y -y +z -z")
LAYOUTS = {
    layout.name: layout
    for layout in (
        Layout("faces", "F R B L U D", (_OWN, "f r b l u d", _NUMBERS, "1 2 3 4 5 6")),
        Layout("top-bottom", "F R B L U D", ("front right back left top bottom",)),
        Layout("gl", "R L U D F B", (*_AXES, _NUMBERS)),
        Layout("unreal", "F3 B1 R2 L U3 D3", _AXES, guessed=False),
        Layout("unity", "F B L R U D", ("fronttex backtex lefttex righttex uptex downtex",)),
        Layout("matterport", "U F R B L D", ("skybox0 skybox1 skybox2 skybox3 skybox4 skybox5", _NUMBERS)),
        Layout("blender-addon", "F B L R U D", ("north south west east zenith nadir",)),
        Layout("strip", "F R B L U D", cells="######"),
        Layout("c6x1", "R L U D F B", cells="######"),
        Layout("c1x6", "R L U D F B", cells="#/#/#/#/#/#"),
        Layout("openexr", "L R U2 D2 F B", cells="#/#/#/#/#/#", centered=True),
        Layout("c3x2", "R L U D F B", cells="###/###"),
        Layout("dice", "U L F R B D", cells=".#../####/.#.."),
        Layout("cross", "U L F R D B2", cells=".#./###/.#./.#."),
    )
}  # fmt: skip
"""Layouts by name. Sources: the specifications and tools of docs/capture-folders.md."""


def named(stems: Sequence[str], layouts: Sequence[Layout]) -> list[tuple[Layout, list[int]]]:
    """Return those of the ``layouts`` whose words six names of files hold.

    Each has the indices of the names, which are ``stems`` of files, in its order.
    """
    words_of_stems = [_words_of(stem) for stem in stems]
    fits = []
    for layout in layouts:
        for words in layout.words:
            order = _order(words.split(), words_of_stems)
            if order:
                fits.append((layout, order))
    return fits


def _words_of(stem: str) -> set[str]:
    """Return the words in the name of a file, and the number at its end."""
    return {*re.split(r"[^a-z0-9+-]+", stem.lower()), *re.findall(r"\d+$", stem)}


def _order(words: Sequence[str], words_of_stems: Sequence[set[str]]) -> list[int]:
    """Return the index of the name that has each word; none unless each word has one name of its own."""
    order = []
    for word in words:
        indices = []
        for i, known in enumerate(words_of_stems):
            if word in known:
                indices.append(i)
        if len(indices) != 1:
            return []
        order += indices
    return order if len(set(order)) == len(order) else []


def cut(picture: Pixels, layout: Layout) -> list[Pixels] | None:
    """Return the six faces of one picture (H, W, ...), in the layout's order; None for another shape."""
    rows = layout.cells.split("/")
    edge = picture.shape[0] // len(rows)
    if picture.shape[:2] != (edge * len(rows), edge * len(rows[0])):
        return None
    faces = []
    for vertical, row in enumerate(rows):
        for horizontal, cell in enumerate(row):
            if cell == "#":
                top = edge * vertical
                left = edge * horizontal
                faces.append(picture[top : top + edge, left : left + edge])
    return faces


class FaceArranger:
    """Arranges six pictures (s, s, 3) of any type as the faces of a cube, by the steps across their edges."""

    def __init__(self, pictures: Sequence[Pixels]) -> None:
        sides = np.stack([_sides(grey_levels(picture)) for picture in pictures])
        # The face with the most texture stays in front: a plain one would fit in every turn.
        self._order = np.argsort(-sides.std(axis=2).sum(axis=(1, 2)), kind="stable")
        lines = sides.reshape(-1, _SAMPLES, 3)
        # Of the two lines on an edge, one runs backwards.
        step = np.abs(lines[:, None] - lines[None, :, ::-1]).mean(axis=-1)
        self._steps = np.minimum(step, _MOST_STEP).mean(axis=-1)

    def step(self, arrangement: Arrangement) -> float:
        """Return the mean step across the twelve edges, grey levels."""
        picture_of = {face.row: picture for picture, face in enumerate(arrangement)}
        total = 0.0
        for (a, side_a), (b, side_b) in edges():
            picture_a = picture_of[a]
            picture_b = picture_of[b]
            line_a = 4 * picture_a + (side_a + arrangement[picture_a].quarters) % 4
            line_b = 4 * picture_b + (side_b + arrangement[picture_b].quarters) % 4
            total += self._steps[line_a, line_b]
        return float(total / 12)

    def best(self) -> tuple[list[Arrangement], float, float]:
        """Return the arrangements of least step, that step, and the least with other faces in other places.

        Up to a rotation of the cube; several arrangements are alike where the turn of a plain face is
        unknown.
        """
        orders, turns = _all()
        pictures = self._order[orders]
        steps = np.zeros((len(pictures), len(turns)))
        for (a, side_a), (b, side_b) in edges():
            line_a = 4 * pictures[:, a, None] + (side_a + turns[None, :, a]) % 4
            line_b = 4 * pictures[:, b, None] + (side_b + turns[None, :, b]) % 4
            steps += self._steps[line_a, line_b] / 12
        least_steps = np.sort(steps.min(axis=1))  # by order of the pictures
        alike = []
        for order, turn in np.argwhere(steps <= least_steps[0] + _SAME):
            faces = [Face(row, int(turns[turn, row])) for row in np.argsort(pictures[order])]
            alike.append(tuple(faces))
        return alike, float(least_steps[0]), float(least_steps[1])


@dataclass(frozen=True)
class Choice:
    """What six pictures, in the order of a layout, show."""

    layout: Layout  # by names or shape
    pictures: Sequence[Pixels]
    arrangement: Arrangement  # differs from the layout's where the seams say so
    step: float  # mean step across the edges, grey levels
    alternative: str  # the next best reading, in words

    def lines(self, names: Sequence[str]) -> list[str]:
        """Return what was chosen, in lines for people; ``names`` of the pictures, in the layout's order."""
        lines = [f"layout {self.layout.name}: step across edges {self.step:.2f} levels; {self.alternative}"]
        for name, due, face in zip(names, self.layout.arrangement, self.arrangement, strict=True):
            if face != due:
                lines.append(f"{name} shows {face}, not {due}: put right")
        return lines


class _Reading(NamedTuple):
    """Six pictures by a layout, and how well they fit so.

    Attributes:
        step: mean step across the edges, grey levels.
        layout: by names or shape.
        pictures: in the layout's order.
        arranger: of the pictures.
    """

    step: float
    layout: Layout
    pictures: Sequence[Pixels]
    arranger: FaceArranger


def choose(readings: Sequence[tuple[Layout, Sequence[Pixels]]], is_given: bool) -> Choice:
    """Return the reading of six pictures whose edges fit.

    Args:
        readings: layouts that names or shape allow, each with the pictures in its order.
        is_given: whether the user named the first layout: then its steps are reported, and no other reading
            is taken.

    Raises:
        ArgumentError: no reading fits, or several do and their edges cannot tell them apart.
    """
    candidates = _scored(readings)
    chosen = candidates[0] if is_given else min(candidates, key=lambda reading: reading.step)
    layout = chosen.layout
    choice = Choice(layout, chosen.pictures, layout.arrangement, chosen.step, "")
    best, least, second = chosen.arranger.best()
    if is_given:
        return replace(choice, alternative=f"the best arrangement: {least:.2f}")
    if chosen.step <= least + _SAME:
        return replace(choice, alternative=f"next best: {_next_best(chosen, candidates, second)}")
    if second < _CLEAR * least + _SAME:
        expected = "expected six faces that fit together, got none that do clearly"
        steps = f"steps of {chosen.step:.2f} levels, other arrangements {least:.2f} and {second:.2f}"
        raise ArgumentError(f"layout: {expected}: {layout.name} has {steps}")
    flipped = FaceArranger([picture[:, ::-1] for picture in chosen.pictures]).step(layout.arrangement)
    mirrored = ""
    if flipped <= least + _SAME:
        mirrored = ", and so it is if all pictures are mirrored (--mirrored)"
    alternative = f"as the layout says: {chosen.step:.2f}{mirrored}"
    arrangement = _most_alike(best, layout.arrangement)
    return replace(choice, arrangement=arrangement, step=least, alternative=alternative)


def _scored(readings: Sequence[tuple[Layout, Sequence[Pixels]]]) -> list[_Reading]:
    """Return how well each reading fits; an order of the pictures is looked at once."""
    arrangers: dict[tuple[int, ...], FaceArranger] = {}
    scored = []
    for layout, pictures in readings:
        order = tuple(map(id, pictures))
        if order not in arrangers:
            arrangers[order] = FaceArranger(pictures)
        step = arrangers[order].step(layout.arrangement)
        scored.append(_Reading(step, layout, pictures, arrangers[order]))
    return scored


def _next_best(chosen: _Reading, candidates: Sequence[_Reading], other_faces_step: float) -> str:
    """Return the reading after the chosen one, in words.

    Args:
        chosen: the reading of least step.
        candidates: all readings.
        other_faces_step: the least step with other faces in other places, grey levels.

    Raises:
        ArgumentError: another layout fits as well.
    """
    same_cube = _rotations(chosen.layout.arrangement)
    others = []
    for other in candidates:
        is_same = other.arranger is chosen.arranger and other.layout.arrangement in same_cube
        if other.layout is not chosen.layout and not is_same:
            others.append((other.step, other.layout.name))
    others.sort()
    tied = [chosen.layout.name]
    for step, name in others:
        if step <= chosen.step + _SAME:
            tied.append(name)
    if len(tied) > 1:
        advice = " or ".join(f"--layout {name}" for name in tied)
        why = f"seams cannot tell {' and '.join(tied)} apart ({chosen.step:.2f} levels)"
        raise ArgumentError(f"layout: {why}: expected {advice}")
    step, name = others[0] if others else (other_faces_step, "other faces")
    return f"{name}, {step:.2f}"


def _most_alike(arrangements: Sequence[Arrangement], expected: Arrangement) -> Arrangement:
    """Return the arrangement, in any orientation of the cube, with the most faces as expected."""

    def agreement(arrangement: Arrangement) -> int:
        count = 0
        for face, due in zip(arrangement, expected, strict=True):
            count += (face == due) + (face.row == due.row)
        return count

    turned: list[Arrangement] = []
    for arrangement in arrangements:
        turned += _rotations(arrangement)
    return max(turned, key=agreement)


def _rotations(arrangement: Arrangement) -> list[Arrangement]:
    """The arrangement in all 24 orientations of the cube, itself first."""
    faces = [Face(row, quarters) for row, quarters in product(range(6), range(4))]
    known = {_bytes_of(face.R_w_c): face for face in faces}
    turned = []
    for front in faces:
        R = front.R_w_c @ Face(0).R_w_c.T
        turned.append(tuple(known[_bytes_of(R @ face.R_w_c)] for face in arrangement))
    return turned


def _bytes_of(whole: Array) -> bytes:
    """Return the bytes of an array of whole numbers, rounding aside."""
    return np.round(whole).astype(int).tobytes()


def grey_levels(picture: Pixels) -> Array:
    """(H, W, 3) 0 to 255, of colours of any type; of depth (H, W) its inverse, of ids their low bytes."""
    if picture.ndim == 2:
        is_depth = picture.dtype.kind == "f"
        picture = np.asarray(1 / (1 + picture) if is_depth else picture & 255, np.float32)
        picture = np.repeat(picture[..., None], 3, axis=-1) / (255 if picture.max() > 1 else 1)
    white = 1.0 if picture.dtype.kind == "f" else np.iinfo(picture.dtype).max
    colors = np.asarray(picture, np.float64).reshape(*picture.shape[:2], -1)[..., :3]
    return np.clip(colors * (255.0 / white), 0, 255)


def _sides(picture: Array) -> Array:
    """(4, n, 3) the outermost lines at the top, right, bottom and left, clockwise, averaged to n samples."""
    lines = np.stack([np.rot90(picture, k)[0] for k in range(4)])
    count = lines.shape[1]
    if count < _SAMPLES:
        return lines[:, np.arange(_SAMPLES) * count // _SAMPLES]
    starts = np.arange(_SAMPLES) * count // _SAMPLES
    return np.asarray(np.add.reduceat(lines, starts, axis=1) / np.diff([*starts, count])[:, None])


@cache
def edges() -> tuple[tuple[tuple[int, int], tuple[int, int]], ...]:
    """The twelve edges of the cube: row and side (top, right, bottom, left) of both faces."""
    sides = np.array([(0, -1, 0), (1, 0, 0), (0, 1, 0), (-1, 0, 0)])
    places: dict[bytes, list[tuple[int, int]]] = {}
    for row in range(6):
        for side in range(4):
            place = Face(row).R_w_c @ (sides[side] + (0, 0, 1))
            places.setdefault(_bytes_of(place), []).append((row, side))
    return tuple((first, second) for first, second in places.values())


@cache
def _all() -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(120, 6) the picture of each face, the first one in front, and (1024, 6) their quarter turns."""
    pictures = [(0, *order) for order in permutations(range(1, 6))]
    turns = [(0, *others) for others in product(range(4), repeat=5)]
    return np.array(pictures), np.array(turns)
