"""Views at an optical centre: cube faces, and strips, narrow views that hold just some rays.

Faces are aligned with the world, so that one set of captures serves every orientation of a camera there.

The rays of a panorama's column, or of a mirror's ring, lie on a circle of the sphere of directions: on a
plane or cone about an axis n, ``n . d = c``. A few views set around that circle, their rows along it,
hold it in a strip a few pixels high. All strips of a plan share one size, because changing the size is
slow on real servers; what differs is how many views a circle takes.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from omniscv.compiled import njit
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose, cube_rotations, pinhole
from omniscv.geometry.arrays import Mask, run
from omniscv.planning.plan import Plan
from omniscv.planning.rays import cross, looking
from omniscv.sources.base import Capabilities, View

ROTATIONS = tuple(R_w_c for _, R_w_c in cube_rotations())
"""(3, 3) each, camera to world, in the order of a capture."""

ALL_FACES = np.ones(6, np.bool_)

FACE_BORDER_PX = 4
"""The filter support beyond a ray's pixel, and two for good measure."""

_ALIGNED = 1 - 1e-9  # cosine between the axes of a face and of one that is aligned with the world

_ON_AN_EDGE = 1 + 1e-9
_EVERY = 101
"""One of so many rays is tested first: an image that looks everywhere hits all faces already with these."""

_MOST_VIEWS = 12
_ROUNDING = 1e-7
LEAST_HALF = np.tan(np.radians(0.5))  # engines take narrower views for 1 degree, in silence
STEEPEST = np.tan(np.radians(62.0))  # farther off a view's axis pixels are stretched more than four times
_SAMPLED_VIEWPOINTS = 24
_SAMPLED_RAYS = 192
PIXELS_PER_REQUEST = 300_000.0
"""How many pixels cost as much as one more request: a live engine answers once a tick, whatever the size."""

Size = tuple[int, int]


class CubeFaces:
    """Cube faces in the size and field of view that a plan's source can capture.

    Args:
        plan: the image.
        edge: wanted px of a 90 degree face.
        border_px: how much wider than 90 degrees faces should be on every side.

    Raises:
        ArgumentError: the source's pictures are narrower than 90 degrees, and it cannot widen them.
    """

    def __init__(self, plan: Plan, edge: int, border_px: int) -> None:
        self._plan = plan
        capabilities = plan.capabilities
        edge = max(edge, capabilities.min_size)
        width = height = edge + 2 * border_px if capabilities.can_set_fov else edge
        if not capabilities.can_set_size:
            if capabilities.image_size is None:
                expected = "expected the image_size of a source that cannot set it"
                raise ArgumentError(f"capabilities: {expected}, got None")
            width, height = capabilities.image_size
        if capabilities.can_set_fov and height > 2 * border_px:
            # The shorter side must see 90 degrees and the border.
            fov_deg = pinhole.fov_deg(width, height / 2 - border_px)
        else:
            fov_deg = 90.0 if capabilities.fov_deg is None else capabilities.fov_deg
            if height / 2 - pinhole.focal_px(width, fov_deg) < -1e-6:
                got = f"{width} x {height} of {fov_deg:g} degrees across"
                advice = "set the server to a square size and a field of view of 90"
                raise ArgumentError(
                    f"faces: expected pictures of at least 90 degrees both ways, got {got}; {advice}"
                )
        self._shape = fov_deg, width, height

    def views(self, center_w: Array, hit: Mask) -> tuple[View, ...]:
        """Return the views at a centre that show the faces that are hit, in the order of :func:`faces_hit`.

        Of a recording, faces of another size are taken where it lacks these, or all faces of a cube in
        another orientation.

        Args:
            center_w: (3,) the centre, metres.
            hit: (6,) bool.
        """
        six = tuple(View(Pose(center_w, R_w_c), *self._shape) for R_w_c in ROTATIONS)
        if self._plan.options.seams != "keep":
            hit = ALL_FACES  # a correction of one face depends on all
        recorded = self._plan.recorded
        if recorded is not None:
            six = recorded.faces(center_w, six, self._plan.options.truth_scale)
            for view, R_w_c in zip(six, ROTATIONS, strict=True):
                if view.pose.R_w_c[:, 2] @ R_w_c[:, 2] < _ALIGNED:
                    hit = ALL_FACES
        faces: list[View] = []
        beside: list[View] = []
        for view, is_hit in zip(six, hit, strict=True):
            if is_hit:
                first, *others = self._plan.cover(view)
                faces.append(first)
                beside += others
        return (*faces, *beside)


def faces_hit(directions: Array, R_w_d: Array) -> Mask:
    """Return (6,) bool, the faces that rays hit, in the order of ``ROTATIONS``; on an edge both faces are
    hit.

    Args:
        directions: (N, 3) in a frame d; NaN for no ray.
        R_w_d: (3, 3) from that frame to the world.
    """
    axes_w = np.array([R_w_c[:, 2] for R_w_c in ROTATIONS])
    axes_d = np.ascontiguousarray(axes_w @ R_w_d)
    along = axes_d @ directions[::_EVERY].T
    hit_by_sample = (along > 0) & (along * _ON_AN_EDGE >= along.max(axis=0))
    if hit_by_sample.any(axis=1).all():
        return ALL_FACES
    hit = np.zeros(6, np.bool_)
    run(_faces_hit, (directions,), axes_d, hit)
    return hit


@njit("float64[:, ::1], float64[:, ::1], out bool[::1]", nogil=True)
def _faces_hit(directions: Array, axes_d: Array, hit: Mask) -> None:
    along = np.empty(6)
    for i in range(directions.shape[0]):
        x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
        most = 0.0
        for k in range(6):
            along[k] = x * axes_d[k, 0] + y * axes_d[k, 1] + z * axes_d[k, 2]
            most = max(most, along[k])
        for k in range(6):
            if along[k] > 0.0 and along[k] * _ON_AN_EDGE >= most:
                hit[k] = True


def straight(rays_w: Sequence[Array], focal_px: float) -> bool:
    """Return whether the rays of every viewpoint lie on a great circle, to half a pixel.

    Args:
        rays_w: for each viewpoint, (N, 3) unit directions.
        focal_px: px per radian.
    """
    for rays in _thinned(rays_w, _SAMPLED_VIEWPOINTS):
        axis, _ = _circle(rays)
        if np.abs(rays @ axis).max() * focal_px > 0.5:
            return False
    return True


def strip_size(
    rays_w: Sequence[Array],
    focal_px: float,
    border_px: int,
    capabilities: Capabilities,
    least_half: float = LEAST_HALF,
) -> Size:
    """Return the width and height that serve a plan's viewpoints for the least work.

    Args:
        rays_w: for each viewpoint, (N, 3) unit directions.
        focal_px: px per radian at a view's centre.
        border_px: what filters need around every ray.
        capabilities: of the source: its smallest views, and whether they may be higher than wide.
        least_half: tangent of half the narrowest field of view.
    """
    circles = []
    for rays in _thinned(rays_w, _SAMPLED_VIEWPOINTS):
        sample = np.array(_thinned(rays, _SAMPLED_RAYS))
        circles.append((sample, *_circle(sample)))
    best = (capabilities.min_size, capabilities.min_size)
    least = np.inf
    for count in range(1, _MOST_VIEWS + 1):
        strips = []
        for circle in circles:
            strips += _shares(*circle, count)
        if len(strips) >= least:  # too many, whatever their size
            continue
        half = np.max([looking(*strip)[1] for strip in strips], axis=0)
        if half[0] > STEEPEST:
            continue
        size = holding_size(np.maximum(half, (least_half, 0.0)), focal_px, border_px, capabilities)
        cost = len(strips) * (1 + size[0] * size[1] / PIXELS_PER_REQUEST)
        if cost < least:
            best = size
            least = cost
    return best


def strip_views(
    center_w: Array, rays_w: Array, focal_px: float, border_px: int, size: Size
) -> tuple[View, ...] | None:
    """Return the fewest views of a size that hold a viewpoint's rays; None where they do not fit.

    Args:
        center_w: (3,) optical centre.
        rays_w: (N, 3) unit directions.
        focal_px, border_px, size: as :func:`strip_size`.
    """
    limit = (np.array(size) / 2 - border_px) / focal_px
    fov_deg = pinhole.fov_deg(size[0], focal_px)
    circle = _circle(rays_w)
    for count in range(1, _MOST_VIEWS + 1):
        views = []
        fits = True
        for strip in _shares(rays_w, *circle, count):
            R_w_c, half = looking(*strip)
            views.append(View(Pose(center_w, R_w_c), fov_deg, *size))
            fits = fits and bool((half <= limit + _ROUNDING).all())
        if fits:
            return tuple(views)
    return None


def holding_size(half: Array, focal_px: float, border_px: int, capabilities: Capabilities) -> Size:
    """Return the least width and height of a view: even wide, odd high, so that a straight strip of rays runs
    through the middle of a row of pixels.

    Args:
        half: (2,) tangents from its axis to its sides.
        focal_px: of the view.
        border_px: how much wider it is on every side.
        capabilities: of the source: its smallest views, and whether they may be higher than wide.
    """
    width = 2 * int(np.ceil(focal_px * half[0] + border_px - _ROUNDING))
    height = 2 * int(np.ceil(focal_px * half[1] + border_px - 0.5 - _ROUNDING)) + 1
    height = max(height, capabilities.min_size)
    least_width = 1 if capabilities.can_set_tall else height
    return max(width, least_width, capabilities.min_size), height


def holding_view(plan: Plan, pose: Pose, half: Array, focal_px: float) -> View | None:
    """Return the least view that holds rays; None where a recording holds none.

    Args:
        plan: the image.
        pose: of the view, world frame.
        half: (2,) tangents from its axis to its sides.
        focal_px: of the view.
    """
    # A recording may have been made of a source that captures no view higher than wide.
    for capabilities in (plan.capabilities, replace(plan.capabilities, can_set_tall=False)):
        size = holding_size(half, focal_px, plan.border(FACE_BORDER_PX), capabilities)
        view = View(pose, pinhole.fov_deg(size[0], focal_px), *size)
        if plan.available((view,)):
            return view
    return None


def _thinned(items: Any, count: int) -> Any:
    """Return about ``count`` of the items, the first and the last among them."""
    return [*items[:: max(1, len(items) // count)], items[-1]]


def _shares(rays: Array, axis: Array, azimuth: Array, count: int) -> list[tuple[Array, Array, Array]]:
    """Return up to ``count`` arcs of the circle that rays lie on: rays, their mean, and the circle's axis."""
    span = azimuth.max() * (1 + 1e-12) + 1e-12
    share = np.minimum((azimuth / span * count).astype(int), count - 1)
    shares = []
    for k in range(count):
        arc = rays if count == 1 else rays[share == k]
        if len(arc):
            shares.append((arc, arc.mean(axis=0), axis))
    return shares


def _circle(rays: Array) -> tuple[Array, Array]:
    """Return the axis of the circle that rays lie on, and their azimuths about it, from its largest gap."""
    if len(rays) < 3:
        axis = cross(rays[0], np.eye(3)[np.argmin(np.abs(rays[0]))])
    else:
        centered = rays - rays.mean(axis=0)
        axis = np.linalg.eigh(centered.T @ centered)[1][:, 0]
    axis = axis / np.linalg.norm(axis)
    across = cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    across /= np.linalg.norm(across)
    azimuth = np.arctan2(rays @ cross(axis, across), rays @ across)
    ordered = np.sort(azimuth)
    gaps = np.diff(ordered, append=ordered[0] + 2 * np.pi)
    start = ordered[(np.argmax(gaps) + 1) % len(ordered)]
    return axis, (azimuth - start) % (2 * np.pi)
