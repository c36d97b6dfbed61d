"""Panoramas: azimuth across, elevation down; cube maps, and the octahedral map.

Every face of a cube map is the image of a pinhole camera of 90 degrees in the cube; none is mirrored. Front,
right, back and left are upright; the lower edge of ``up`` and the upper edge of ``down`` touch ``front``.
"""

from collections.abc import Callable
from itertools import chain
from typing import Any, ClassVar, Literal, NamedTuple, get_args

import numpy as np

from omniscv.arguments import number, one_of, whole_number
from omniscv.cameras.base import Array, Camera, CentralCamera, Mask, grid_axes, sin_cos_of_half, vectors
from omniscv.cameras.lens_parameters import Parameters
from omniscv.cameras.registry import register

Profile = Literal["angular", "perspective", "mercator", "miller", "equal-area"]


class AngularGrid(Camera):
    """Azimuth by column and elevation by row, in equal steps, to half the field of view on either side."""

    _half = np.array([np.pi, np.pi / 2])
    typical_aspect = 0.5

    def __init__(self, width: int, height: int) -> None:
        super().__init__(width, height)

    def _angles(self, pixels: Array) -> tuple[Array, Array]:
        """Return azimuth and elevation of pixels; of a grid only those of its columns and rows."""
        u, v = grid_axes(pixels)
        across = 2 * u / self.width - 1
        up = 1 - 2 * v / self.height
        return across * self._half[0], up * self._half[1]

    def _directions(self, pixels: Array) -> tuple[Array, bool]:
        theta, phi = self._angles(pixels)
        level = np.cos(phi)
        return vectors(level * np.sin(theta), -np.sin(phi), level * np.cos(theta)), True

    def _pixels_at(self, theta: Array, up: Array) -> Array:
        """Return the pixels at azimuths and at fractions ``up`` of the image's upper half."""
        across = theta / self._half[0]
        return np.stack([(across + 1) * self.width / 2, (1 - up) * self.height / 2], axis=-1)

    def _project(self, points: Array) -> tuple[Array, Mask | bool]:
        x = points[..., 0]
        y = points[..., 1]
        z = points[..., 2]
        return self._pixels_at(np.arctan2(x, z), np.arctan2(-y, np.hypot(x, z)) / self._half[1]), True


@register
class Equirectangular(AngularGrid, CentralCamera):
    """The whole sphere in a rectangle of angles.

    ``theta = (2u/W - 1) pi`` to the right, ``phi = (1/2 - v/H) pi`` up; direction
    ``(cos phi sin theta, -sin phi, cos phi cos theta)``. Domain: every pixel, every direction; at the
    poles, where all columns meet, ``project`` returns the middle column, and at the seam at +-180
    degrees u = 0 or u = W by the sign of x. Source: OmniSCV, eq. 1.
    """

    name = "equirectangular"
    lens = Parameters()


class _Rows(NamedTuple):
    """The heights of a cylinder's rows, in units in which rows are equally spaced.

    Attributes:
        height: by the slope tan phi.
        level_and_up: cos phi and sin phi by the height.
        to_pole: whether the height of the pole is finite.
    """

    height: Callable[[Array], Array]
    level_and_up: Callable[[Array], tuple[Array, Array]]
    to_pole: bool


# Functions of the slope tan phi: near the pole phi has lost the digits of the height.
_ROWS: dict[str, _Rows] = {
    "perspective": _Rows(lambda slope: slope, lambda h: (1 / np.hypot(1.0, h), h / np.hypot(1.0, h)), False),
    "mercator": _Rows(np.arcsinh, lambda h: (1 / np.cosh(h), np.tanh(h)), False),
    "miller": _Rows(
        lambda slope: 1.25 * np.arcsinh(np.tan(0.8 * np.arctan(slope))),
        lambda h: (np.cos(phi := 1.25 * np.arctan(np.sinh(0.8 * h))), np.sin(phi)),
        True,
    ),
    "equal-area": _Rows(lambda k: np.sin(np.arctan(k)), lambda h: (np.sqrt((1 - h) * (1 + h)), h), True),
}
_LEAST_LEVEL = 1e-17  # keeps the azimuth of rays straight up


@register
class Cylindrical(AngularGrid, CentralCamera):
    """A band around the horizon: ``theta = (2u/W - 1) fov_h / 2`` to the right; rows by ``profile``:
    their height h(phi) falls evenly from ``h(fov_v / 2)`` in the first row to ``-h(fov_v / 2)``.

    ``angular``: ``h = phi``, the paper's, a cropped equirectangular image; ``perspective``: ``h = tan phi``,
    a picture on the cylinder's wall; ``mercator``: ``h = asinh(tan phi)``, no shape is distorted, a square
    image at fov_v = 2 x 85.051; ``miller``: ``h = 1.25 asinh(tan(0.8 phi))``; ``equal-area``: ``h = sin phi``
    (Lambert), every pixel spans the same solid angle.
    Parameters: ``fov_h_deg`` <= 360 (default 360), ``fov_v_deg`` <= 180 (perspective, mercator: < 180;
    default 90). Domain: every pixel; directions within the field of view.
    Source: OmniSCV, eq. 2; Snyder, Map Projections (1987), for mercator, miller and equal-area.
    """

    name = "cylindrical"
    typical: ClassVar = {"fov_v_deg": 120}

    def __init__(
        self,
        width: int,
        height: int,
        fov_h_deg: float = 360.0,
        fov_v_deg: float = 90.0,
        profile: Profile = "angular",
    ) -> None:
        super().__init__(width, height)
        self.profile: Profile = one_of("profile", profile, get_args(Profile))
        rows = _ROWS.get(self.profile)
        self.fov_h_deg = number("fov_h_deg", fov_h_deg, above=0, most=360)
        limit = {"most" if rows is None or rows.to_pole else "below": 180.0}
        self.fov_v_deg = number("fov_v_deg", fov_v_deg, above=0, **limit)
        self._half = np.radians([self.fov_h_deg / 2, self.fov_v_deg / 2])
        if rows is not None:
            across, along = sin_cos_of_half(self.fov_v_deg)
            self._top = rows.height(across / along)

    def _directions(self, pixels: Array) -> tuple[Array, bool]:
        if self.profile == "angular":
            return super()._directions(pixels)
        theta, _ = self._angles(pixels)
        level, up = _ROWS[self.profile].level_and_up((1 - 2 * pixels[..., 1] / self.height) * self._top)
        level = np.maximum(level, _LEAST_LEVEL)
        return vectors(level * np.sin(theta), -up, level * np.cos(theta)), True

    def _project(self, points: Array) -> tuple[Array, Mask | bool]:
        if self.profile == "angular":
            return super()._project(points)
        x = points[..., 0]
        y = points[..., 1]
        z = points[..., 2]
        height = _ROWS[self.profile].height(-y / np.hypot(x, z))
        return self._pixels_at(np.arctan2(x, z), height / self._top), True


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
        faces = []
        axes = []
        for slot in chain(*rows):
            faces.append(_FACES.find(slot[0]))
            axes.append(_axes(slot))
        self._face = np.array(faces)
        self._slot_axes = np.array(axes)
        self._slot_of = np.array([faces.index(face) for face in range(6)])

    def _directions(self, pixels: Array) -> tuple[Array, Mask]:
        from omniscv.cameras.camera_kernels import cast  # slow to load

        flat = pixels.reshape(-1, 2)
        rays = np.empty((len(flat), 3))
        valid = np.empty(len(flat), np.bool_)
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
        across = (self._slot_axes[slot, :, 0] * scaled).sum(axis=-1)
        down = (self._slot_axes[slot, :, 1] * scaled).sum(axis=-1)
        xy = np.stack([across, down], axis=-1)
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
        x = np.clip(2 * pixels[..., 0] / self._size[0] - 1, -_SQUARE_EDGE, _SQUARE_EDGE)
        y = np.clip(2 * pixels[..., 1] / self._size[1] - 1, -_SQUARE_EDGE, _SQUARE_EDGE)
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
    folded_x = np.copysign(1 - np.abs(y), x)
    folded_y = np.copysign(1 - np.abs(x), y)
    return np.where(back, folded_x, x), np.where(back, folded_y, y)
