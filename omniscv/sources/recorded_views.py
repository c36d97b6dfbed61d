"""The views of a recording, the cubes among them (six views along three axes, in any orientation), and the
view at a centre that serves each ray best."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from omniscv.geometry import Array, cube_rotations
from omniscv.geometry.arrays import Ints
from omniscv.sources.requests import View

_POSITION_DECIMALS = 6  # a micrometre
_SAME = 1e-6  # matrix entries, and relative to the focal length
_AXES = np.array([R_w_c[:, 2] for _, R_w_c in cube_rotations()])
_R_D_FRONT = cube_rotations()[0][1]
_SAME_CENTER_M = 1e-3  # recorded views so near to a position serve as views from it
_SUPPORT_PX = 2.0  # between a ray's pixel and the edge of its view, for every filter

_BEAT = 1.37
"""How many times finer views of ``checks: beat`` are: no simple fraction, so that a structure that meets all
pixels of one picture at nearly the same phase does not do so in the other."""

Position = tuple[float, ...]


class Shape(NamedTuple):
    """Size in px and horizontal field of view in degrees."""

    width: int
    height: int
    fov_deg: float

    @classmethod
    def of(cls, view: View) -> "Shape":
        """Return the shape of a view."""
        return cls(view.width, view.height, round(view.fov_deg, 6))

    def scaled(self, factor: int) -> "Shape":
        """Return the shape with ``factor`` times as many pixels each way."""
        return self._replace(width=factor * self.width, height=factor * self.height)

    def coarser(self, factor: int) -> "Shape":
        """Return the shape with a ``factor`` fewer pixels each way, rounded down."""
        return self._replace(width=self.width // factor, height=self.height // factor)

    def finer(self) -> "Shape":
        """Return the shape of views that ``checks: beat`` compares with those of this one; they show at least
        as much."""
        width = max(self.width + 1, round(_BEAT * self.width))
        return self._replace(width=width, height=-(-self.height * width // self.width))


@dataclass(frozen=True, eq=False)
class _Cube:
    """Views at one centre along the axes of a frame d, ``R_w_d`` (3, 3).

    ``faces`` are by shape and by row of ``cube_rotations()``; each may be turned by quarters about its axis.
    """

    R_w_d: Array
    faces: dict[Shape, dict[int, View]] = field(default_factory=lambda: defaultdict(dict))

    @property
    def aligned(self) -> bool:
        """Whether it is aligned with the world."""
        return bool(np.abs(self.R_w_d - np.eye(3)).max() < _SAME)

    def is_whole(self) -> bool:
        """Return whether all six faces are recorded in one shape."""
        return any(len(faces) == len(_AXES) for faces in self.faces.values())

    def add(self, view: View) -> bool:
        """Add a view if it is a face; return whether it is."""
        off = np.abs(_AXES - view.pose.R_w_c[:, 2] @ self.R_w_d).max(axis=1)
        across = np.abs(view.pose.R_w_c[:, 0] @ self.R_w_d)
        is_face = bool(off.min() < _SAME and across.max() > 1 - _SAME)
        if is_face:
            self.faces[Shape.of(view)].setdefault(int(off.argmin()), view)
        return is_face

    def coarse_shapes(self, requested: Shape, truth_scale: int) -> list[Shape]:
        """Return the shapes in which colours can be had.

        The ``requested`` one alone, if its faces or those of ground truth, ``truth_scale`` times as fine, are
        recorded; else those that are recorded both ways; else those whose ground truth is recorded.
        """
        if requested in self.faces or requested.scaled(truth_scale) in self.faces:
            return [requested]
        twice = [shape for shape in self.faces if shape.scaled(truth_scale) in self.faces]
        if twice:
            return twice
        return [shape.coarser(truth_scale) for shape in self.faces]


class RecordedViews:
    """A recording's views, of all modes or those that ``of_mode`` returns; cubes by position and shape."""

    def __init__(self, views: Sequence[View], of_mode: Callable[[str], Sequence[View]] | None = None) -> None:
        self.views = views
        self._of_mode = of_mode
        self._recorded = frozenset(views)
        self._at: dict[Position, list[View]] = defaultdict(list)
        for view, position in zip(views, _positions([view.pose.t_w_c for view in views]), strict=True):
            self._at[position].append(view)
        self._cubes: dict[Position, list[_Cube]] = {}

    def hold(self, views: Iterable[View]) -> bool:
        """Return whether all of these views are recorded."""
        return self._recorded.issuperset(views)

    def centers(self) -> tuple[Position, ...]:
        """Return the centres (x, y, z), metres, at which all faces are recorded, in their order."""
        return tuple(center for center in self._at if any(map(_Cube.is_whole, self._cubes_at(center))))

    def faces(self, center_w: Array, six: Sequence[View], truth_scale: int = 1) -> tuple[View, ...]:
        """Return the six views at a centre: the given ones if recorded, else the fullest, finest cube.

        Missing faces of that cube are the given ones: requesting them shows what is missing.

        Args:
            center_w: (3,) the centre.
            six: views of a cube aligned with the world, in the order of ``cube_rotations()``.
            truth_scale: how many times finer ground truth is requested. First come cubes that ``checks:
                beat`` recorded in a second size, then those recorded both ways; one recorded once is taken
                for ground truth.
        """
        (at,) = _positions([center_w])
        requested = Shape.of(six[0])
        best = tuple(six)
        most = (False, False, 0, 0, 0)
        for cube in self._cubes_at(at):
            for shape in cube.coarse_shapes(requested, truth_scale):
                recorded = cube.faces.get(shape.scaled(truth_scale), {})
                if not cube.aligned and len(recorded) < len(_AXES):
                    continue
                twice = truth_scale > 1 and shape in cube.faces
                compared = shape.scaled(truth_scale).finer() in cube.faces
                is_requested = shape == requested and cube.aligned
                rank = (is_requested, compared, int(twice), len(recorded), shape.width)
                if rank > most:
                    most = rank
                    best = _shaped(six, recorded, shape)
        return best

    def at(self, center_w: Array, mode: str) -> tuple[View, ...]:
        """Return the views in a ``mode`` at the recorded centre that is nearest to ``center_w``.

        ``center_w`` is (3,) metres, world frame. There are none if no centre is within a millimetre.
        """
        centers = np.array(list(self._at)).reshape(-1, 3)
        away = np.linalg.norm(centers - center_w, axis=-1)
        if not len(away) or away.min() > _SAME_CENTER_M:
            return ()
        in_mode = self._recorded if self._of_mode is None else frozenset(self._of_mode(mode))
        nearest = tuple(centers[away.argmin()])
        return tuple(view for view in self._at[nearest] if view in in_mode)

    def _cubes_at(self, at: Position) -> list[_Cube]:
        """The cubes at a position, of views that see 90 degrees both ways."""
        if at not in self._cubes:
            cubes = [_Cube(np.eye(3))]
            for view in self._at.get(at, ()):
                sees_a_face = min(view.width, view.height) / 2 >= view.focal_px * (1 - _SAME)
                if sees_a_face and not view.lens and not any(cube.add(view) for cube in cubes):
                    cubes.append(_Cube(view.pose.R_w_c @ _R_D_FRONT.T))
                    cubes[-1].add(view)
            self._cubes[at] = cubes
        return self._cubes[at]


def finest(views: Sequence[View], directions_w: Array) -> tuple[Ints, Array]:
    """Return the view that serves each ray from the views' centre, and how far within it the ray lies.

    It is the one with the most px per radian there, among those that also see the support of filters around
    the ray, else among those that see the ray; of equal ones the first.

    Args:
        views: at one centre.
        directions_w: (N, 3) of the rays, world frame, of any length.

    Returns:
        (N,) index of the view, -1 where none sees the ray; (N,) px from the ray to the view's edge.
    """
    index = np.full(len(directions_w), -1)
    edge_px = np.full(len(directions_w), -1.0)
    most = np.zeros(len(directions_w))
    for number, view in enumerate(views):
        u, v, z = view.project(view.pose.t_w_c + directions_w).T
        fx, fy, cx, cy = view.projection
        tangents = ((u - cx) / fx) ** 2 + ((v - cy) / fy) ** 2
        # The mean of the scale along (1 / cos^2) and across (1 / cos) the way to the principal point:
        density = np.sqrt(fx * fy) * (1 + tangents) ** 0.75
        margin = np.minimum(np.minimum(u, view.width - u), np.minimum(v, view.height - v))
        supported = margin >= _SUPPORT_PX
        before = edge_px >= _SUPPORT_PX
        finer = density > most * (1 + _SAME)
        better = (z > 0) & (margin >= 0) & np.where(supported == before, finer, supported)
        index[better] = number
        edge_px[better] = margin[better]
        most[better] = density[better]
    return index, edge_px


def _shaped(six: Sequence[View], recorded: Mapping[int, View], shape: Shape) -> tuple[View, ...]:
    """Return six faces, each as recorded or else as given, with the size of a shape."""
    faces = []
    for face, view in enumerate(six):
        faces.append(replace(recorded.get(face, view), width=shape.width, height=shape.height))
    return tuple(faces)


def _positions(positions: Sequence[Array]) -> list[Position]:
    rounded = np.round(np.reshape(positions, (-1, 3)), _POSITION_DECIMALS) + 0.0  # no negative zero
    return list(map(tuple, rounded.tolist()))
