"""Cube maps: faces aligned with the world at an optical centre.

They are world-aligned, so that one set of captures serves every orientation of a camera at that centre.
"""

import numpy as np
from numpy.typing import NDArray

from omniscv.compiled import njit
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose, cube_rotations, pinhole
from omniscv.parallel import blocks
from omniscv.planning.strategy import Task
from omniscv.sources.base import View

ROTATIONS = tuple(R_w_c for _, R_w_c in cube_rotations())
"""(3, 3) each, camera to world, in the order of a capture."""

ALL_FACES = np.ones(6, np.bool_)

FACE_BORDER_PX = 4
"""The filter support beyond a ray's pixel, and two for good measure."""

_ALIGNED = 1 - 1e-9  # cosine between the axes of a face and of one that is aligned with the world

_ON_AN_EDGE = 1 + 1e-9
_EVERY = 101
"""One of so many rays is tested first: an image that looks everywhere hits all faces already with these."""


class CubeFaces:
    """Cube faces in the size and field of view that a task's source can capture.

    Args:
        task: the image.
        edge: wanted px of a 90 degree face.
        border_px: how much wider than 90 degrees faces should be on every side.

    Raises:
        ArgumentError: the source's pictures are narrower than 90 degrees, and it cannot widen them, or it
            captures through a lens of its own.
    """

    def __init__(self, task: Task, edge: int, border_px: int) -> None:
        self._task = task
        capabilities = task.capabilities
        if capabilities.lens is not None:
            raise ArgumentError(
                f"faces: expected square pixels around the optical axis, got {capabilities.lens} of the "
                "source; take another camera, or an image whose rays fit into one of its pictures"
            )
        edge = max(edge, capabilities.min_size)
        width = height = edge + 2 * border_px if capabilities.can_set_fov else edge
        if not capabilities.can_set_size:
            if capabilities.image_size is None:
                raise ArgumentError(
                    "capabilities: expected the image_size of a source that cannot set it, got None"
                )
            width, height = capabilities.image_size
        if capabilities.can_set_fov and height > 2 * border_px:
            # The shorter side must see 90 degrees and the border.
            fov_deg = pinhole.fov_deg(width, height / 2 - border_px)
        else:
            fov_deg = 90.0 if capabilities.fov_deg is None else capabilities.fov_deg
            if height / 2 - pinhole.focal_px(width, fov_deg) < -1e-6:
                raise ArgumentError(
                    f"faces: expected pictures of at least 90 degrees both ways, got {width} x {height} of "
                    f"{fov_deg:g} degrees across; set the server to a square size and a field of view of 90"
                )
        self._shape = fov_deg, width, height

    def views(self, center_w: Array, hit: NDArray[np.bool_]) -> tuple[View, ...]:
        """Return the views at a centre that show the faces that are hit, in the order of :func:`faces_hit`.

        Of a recording, faces of another size are taken where it lacks these, or all faces of a cube in
        another orientation.
        """
        six = tuple(View(Pose(center_w, R_w_c), *self._shape) for R_w_c in ROTATIONS)
        if self._task.options.seams != "keep":
            hit = ALL_FACES  # a correction of one face depends on all
        recorded = self._task.recorded
        if recorded is not None:
            six = recorded.faces(center_w, six, self._task.options.truth_scale)
            if any(
                view.pose.R_w_c[:, 2] @ R[:, 2] < _ALIGNED for view, R in zip(six, ROTATIONS, strict=True)
            ):
                hit = ALL_FACES
        covers = [self._task.cover(view) for view, is_hit in zip(six, hit, strict=True) if is_hit]
        return (*(cover[0] for cover in covers), *(view for cover in covers for view in cover[1:]))


def faces_hit(directions: Array, R_w_d: Array) -> NDArray[np.bool_]:
    """Return (6,) bool, the faces that rays hit, in the order of ``ROTATIONS``; on an edge both faces are
    hit.

    Args:
        directions: (N, 3) in a frame d; NaN for no ray.
        R_w_d: (3, 3) from that frame to the world.
    """
    axes_w = np.array([R_w_c[:, 2] for R_w_c in ROTATIONS])
    axes_d = np.ascontiguousarray(axes_w @ R_w_d)
    along = axes_d @ directions[::_EVERY].T
    some = (along > 0) & (along * _ON_AN_EDGE >= along.max(axis=0))
    if some.any(axis=1).all():  # not by the kernel, which then need not be compiled
        return ALL_FACES
    parts = blocks(lambda rows: _faces_hit(directions[rows], axes_d), len(directions))
    return np.asarray(np.any(parts, axis=0))


@njit(cache=True, nogil=True)
def _faces_hit(directions: Array, axes_d: Array) -> NDArray[np.bool_]:
    hit = np.zeros(6, np.bool_)
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
    return hit
