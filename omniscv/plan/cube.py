"""Cube maps: faces aligned with the world at every optical centre, all six or those that rays hit.

World-aligned, so that one set of captures serves every orientation of a camera at that place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from omniscv.captures.source import Capabilities
from omniscv.captures.view import View
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose, cube_rotations
from omniscv.parallel import blocks

_FACES = tuple(R_w_c for _, R_w_c in cube_rotations())
ROTATIONS = (*_FACES, *(np.diag([-1.0, -1.0, 1.0]) @ R_w_c for R_w_c in _FACES[4:]))
"""(3, 3) each, camera to world: the six faces, then up and down turned half round."""


@dataclass(frozen=True)
class Face:
    """The size and field of view of a plan's faces.

    Attributes:
        width, height, fov_deg: of every view.
        border_px: how far they reach beyond 90 degrees.
        leaning: the source cannot look straight up and down. Its pictures lean to one side, and miss a sliver
            on the other; so there are two more, which lean to that side.
    """

    width: int
    height: int
    fov_deg: float
    border_px: int
    leaning: bool = False

    @classmethod
    def of(cls, edge: int, border_px: int) -> Face:
        """A face of ``edge`` px for 90 degrees, ``border_px`` wider on every side, same focal length."""
        width = edge + 2 * border_px
        fov_deg = 90.0 if border_px == 0 else float(np.degrees(2 * np.arctan(width / edge)))
        return cls(width, width, fov_deg, border_px)

    @classmethod
    def on(cls, capabilities: Capabilities, edge: int, border_px: int) -> Face:
        """The face that a source can capture, as near as it can to the one that is wanted.

        Raises:
            ArgumentError: the source's pictures are narrower than 90 degrees, and it cannot widen them.
        """
        upright = cls._upright_on(capabilities, edge, border_px)
        return replace(upright, leaning=not capabilities.can_look_vertical)

    @classmethod
    def _upright_on(cls, capabilities: Capabilities, edge: int, border_px: int) -> Face:
        if capabilities.can_set_size and capabilities.can_set_fov:
            return cls.of(max(edge, capabilities.min_size), border_px)
        if capabilities.can_set_size:
            width = height = max(edge, capabilities.min_size)
        elif capabilities.image_size is not None:
            width, height = capabilities.image_size
        else:
            raise ArgumentError(
                "capabilities: expected the image_size of a source that cannot set it, got None"
            )
        if capabilities.can_set_fov and height > 2 * border_px:
            # The shorter side must see 90 degrees and the border.
            tangent = height / (height - 2 * border_px) * width / height
            return cls(width, height, float(np.degrees(2 * np.arctan(tangent))), border_px)
        fov_deg = 90.0 if capabilities.fov_deg is None else capabilities.fov_deg
        focal = width / 2 / np.tan(np.radians(fov_deg) / 2)
        border = int(np.floor(height / 2 - focal + 1e-6))
        if border < 0:
            raise ArgumentError(
                f"faces: expected pictures of at least 90 degrees both ways, got {width} x {height} of "
                f"{fov_deg:g} degrees across; set the server to a square size and a field of view of 90"
            )
        return cls(width, height, fov_deg, border)

    def views(self, center_w: Array) -> tuple[View, ...]:
        """The views at a centre: six faces, then, of a source that leans, up and down turned half round."""
        return tuple(
            View(Pose(center_w, R_w_c), self.fov_deg, self.width, self.height)
            for R_w_c in ROTATIONS[: 8 if self.leaning else 6]
        )


def chosen(views: Sequence[View], hit: NDArray[np.bool_]) -> tuple[View, ...]:
    """The views, in the order of :meth:`Face.views`, whose faces are hit; ``hit`` as :func:`faces_hit`."""
    return tuple(view for view, wanted in zip(views, [*hit, *hit[4:]], strict=False) if wanted)


def faces_hit(directions: Array, R_w_d: Array) -> NDArray[np.bool_]:
    """(6,) the faces that rays hit, in the order of ``cube_rotations``; rays on an edge hit both sides.

    Args:
        directions: (N, 3) in a frame d.
        R_w_d: (3, 3) from that frame to the world.
    """
    axes_w = np.array([R_w_c[:, 2] for R_w_c in _FACES])

    def part(rows: slice) -> NDArray[np.bool_]:
        return np.asarray(_faces_hit(directions[rows], np.ascontiguousarray(axes_w @ R_w_d)))

    return np.asarray(np.any(blocks(part, len(directions)), axis=0))


@njit(cache=True, nogil=True)
def _faces_hit(directions: Array, axes_d: Array) -> NDArray[np.bool_]:
    hit = np.zeros(6, np.bool_)
    along = np.empty(6)
    for i in range(directions.shape[0]):
        most = 0.0
        for k in range(6):
            along[k] = (
                directions[i, 0] * axes_d[k, 0]
                + directions[i, 1] * axes_d[k, 1]
                + directions[i, 2] * axes_d[k, 2]
            )
            most = max(most, along[k])
        for k in range(6):
            if along[k] > 0.0 and along[k] * (1.0 + 1e-9) >= most:
                hit[k] = True
    return hit
