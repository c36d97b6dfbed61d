"""Cube maps, six faces of a cube around the camera in one image; and the octahedral map.

Every face of a cube map is the image of a pinhole camera of 90 degrees in the cube; none is mirrored. Front,
right, back and left are upright; the lower edge of ``up`` and the upper edge of ``down`` touch ``front``.
"""

from typing import Any, ClassVar, Literal, get_args

import numpy as np

from omniscv.arguments import one_of, whole_number
from omniscv.cameras.base import Array, CentralCamera, Mask
from omniscv.cameras.registry import register

Layout = Literal["strip", "3x2", "cross", "dice"]
Slots = tuple[tuple[str, ...], ...]

LAYOUTS: dict[str, Slots] = {
    "strip": (("F0", "R0", "B0", "L0", "U0", "D0"),),  # py360convert's order; 0.1.0 mirrored R, B and U
    "3x2": (("R0", "L0", "U0"), ("D0", "F0", "B0")),  # FFmpeg v360 c3x2
    "cross": ((" ", "U0", " "), ("L0", "F0", "R0"), (" ", "D0", " "), (" ", "B2", " ")),  # vertical, of HDRI
    "dice": ((" ", "U0", " ", " "), ("L0", "F0", "R0", "B0"), (" ", "D0", " ", " ")),  # py360convert's dice
}
"""Rows of slots: a face (front, right, back, left, up, down) and its quarter turns clockwise in the image; a
blank slot shows nothing."""

_FACES = "FRBLUD"
# Columns: the face's x (right), y (down) and z (outward) axes in the camera frame.
_AXES = np.array([
    [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
    [[-1, 0, 0], [0, 1, 0], [0, 0, -1]],
    [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
    [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
    [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
], dtype=np.float64)  # fmt: skip
# A quarter turn clockwise in the image.
_TURN = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


class CubeLayout(CentralCamera):
    """Six faces in slots of a grid, their pixels equally spaced on the face's plane or by equal angles."""

    _layouts: ClassVar[dict[str, Slots]] = LAYOUTS
    _equiangular: ClassVar = False
    typical: ClassVar = {"layout": "dice"}
    typical_aspect = 0.75

    def __init__(self, width: int, height: int, layout: Layout = "3x2", padding_px: int = 0) -> None:
        super().__init__(width, height)
        self.layout: Layout = one_of("layout", layout, get_args(Layout))
        rows = self._layouts[self.layout]
        most = (min(self.width, self.height // len(rows)) - 1) // 2
        self.padding_px = whole_number("padding_px", padding_px, "pixels", least=0, most=max(most, 0))
        self._grid = np.array([len(rows[0]), len(rows)])
        room = np.array([self.width, self.height]) - 2 * self.padding_px * np.array([1, len(rows)])
        self._slot_px = room / self._grid
        # By slot, row-major: the face, -1 for none, and its axes; by face: its slot.
        slots = [slot for row in rows for slot in row]
        self._face = np.array([_FACES.find(slot[0]) for slot in slots])
        self._slot_axes = np.array([_axes(slot) for slot in slots])
        self._slot_of = np.array([np.flatnonzero(self._face == face)[0] for face in range(6)])

    def _directions(self, pixels: Array) -> tuple[Array, Mask]:
        from omniscv.cameras.camera_kernels import cast  # slow to load

        flat = pixels.reshape(-1, 2)
        rays, valid = np.empty((len(flat), 3)), np.empty(len(flat), np.bool_)
        spacing = self._slot_px, self.padding_px, self._equiangular
        cast(flat, (self._grid, *spacing, self._face, self._slot_axes), rays, valid)
        return rays.reshape(*pixels.shape[:-1], 3), valid.reshape(pixels.shape[:-1])

    def _project(self, points: Array) -> tuple[Array, bool]:
        along = np.abs(points)
        axis = np.argmax(along, axis=-1)
        ahead = np.take_along_axis(points, axis[..., None], axis=-1)[..., 0]
        face = np.array([[3, 1], [4, 5], [2, 0]])[axis, (ahead > 0).astype(np.int64)]
        slot = self._slot_of[face]
        scaled = points / np.abs(ahead)[..., None]
        xy = np.stack([(self._slot_axes[slot, :, k] * scaled).sum(axis=-1) for k in (0, 1)], axis=-1)
        edge = 1 - 1e-13  # keeps the pixel in its slot
        a = np.clip(4 / np.pi * np.arctan(xy) if self._equiangular else xy, -edge, edge)
        cell = np.stack([slot % self._grid[0], slot // self._grid[0]], axis=-1)
        gap = self.padding_px * np.stack([np.ones_like(slot), 2 * cell[..., 1] + 1], axis=-1)
        return (cell + (a + 1) / 2) * self._slot_px + gap, True


def _axes(slot: str) -> Any:
    """Return a slot's x, y and z axes in the camera frame, the columns of (3, 3)."""
    if slot == " ":
        return np.eye(3)
    return _AXES[_FACES.index(slot[0])] @ np.linalg.matrix_power(_TURN, int(slot[1]))


@register
class CubeMap(CubeLayout):
    """The six 90 degree faces of a cube in one image: in a face ``a = X / Z``, -1 to 1 from edge to edge.

    ``layout`` (F front, R right, B back, L left, U up, D down; a number: quarter turns clockwise):
        ``strip``  F R B L U D        ``3x2``  R L U / D F B
        ``cross``  . U . / L F R / . D . / . B2 .        ``dice``  . U . . / L F R B / . D . .
    Parameters: ``layout`` (default "3x2", FFmpeg's c3x2); ``padding_px`` around each row of faces, px.
    Domain: every pixel of a face, every direction; a direction on an edge of the cube projects to one of
    its faces. Faces continue in the padding; ``project`` returns no pixel there.
    Source: Greene 1986; the orders are those of FFmpeg's v360 and py360convert (strip, dice).
    """

    name = "cube-map"


@register
class EquiangularCube(CubeLayout):
    """A cube map whose pixels are spaced by equal angles: in a face ``a = (4 / pi) atan(X / Z)``, both axes.

    The largest pixel spans 1.4 times the solid angle of the smallest, in a plain cube map 5.2 times.
    Parameters: ``layout`` as in ``cube-map``, but ``3x2`` (default) is that of YouTube and of FFmpeg's eac,
    L F R / D3 B1 U3, in which faces go on across the edges within each row; ``padding_px`` around each
    row of faces, px, in which the faces at its ends go on (FFmpeg: 2).
    Domain: as ``cube-map``.
    Source: Brown 2017, Bringing pixels front and center in VR video; FFmpeg's v360.
    """

    name = "equiangular-cube"
    _equiangular = True
    _layouts: ClassVar[dict[str, Slots]] = {**LAYOUTS, "3x2": (("L0", "F0", "R0"), ("D3", "B1", "U3"))}


_SQUARE_EDGE = 1 - 2e-15  # keeps rays off the square's edge, where two pixels see them


@register
class Octahedral(CentralCamera):
    """The whole sphere on a square: an octahedron unfolded, forward in the middle, backward at the corners.

    With (a, b) = ``(2u/W - 1, 2v/H - 1)``: where ``|a| + |b| <= 1`` the ray is ``(a, b, 1 - |a| - |b|)``,
    normalised; beyond, the back half folds out: ``(sgn a (1 - |b|), sgn b (1 - |a|), 1 - |a| - |b|)``.
    Domain: every pixel, every direction; each edge of the image shows its own half of the great circle
    there twice, about its middle: ``project`` returns the side of the sign of x or y.
    Source: Cigolle et al. 2014, A survey of efficient representations for independent unit vectors.
    """

    name = "octahedral"

    def __init__(self, width: int, height: int) -> None:
        super().__init__(width, height)
        self._size = np.array([self.width, self.height])

    def _directions(self, pixels: Array) -> tuple[Array, bool]:
        x, y = (
            np.clip(2 * pixels[..., i] / size - 1, -_SQUARE_EDGE, _SQUARE_EDGE)
            for i, size in enumerate(self._size)
        )
        z = 1 - np.abs(x) - np.abs(y)
        x, y = _fold(x, y, z)
        scale = 1 / np.sqrt(x * x + y * y + z * z)
        return np.stack([x * scale, y * scale, z * scale], axis=-1), True

    def _project(self, points: Array) -> tuple[Array, bool]:
        n = points / np.abs(points).sum(axis=-1, keepdims=True)
        ab = np.stack(_fold(n[..., 0], n[..., 1], n[..., 2]), axis=-1)
        return (ab + 1) / 2 * self._size, True


def _fold(x: Array, y: Array, z: Array) -> tuple[Array, Array]:
    """Return x and y, mirrored at the edges of the inner diamond where z < 0."""
    back = z < 0
    folded = np.copysign(1 - np.abs(y), x), np.copysign(1 - np.abs(x), y)
    return np.where(back, folded[0], x), np.where(back, folded[1], y)
