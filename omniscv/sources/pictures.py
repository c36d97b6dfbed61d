"""Six faces in memory as a source."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv import modalities
from omniscv.arguments import number, numbers, shown
from omniscv.errors import ArgumentError, MissingCaptureError
from omniscv.geometry import Pose, cube_rotations
from omniscv.modalities import Transfer
from omniscv.sources.base import Capabilities, Capture, ObjectTable, Request, Source, View

NAMES = tuple(name for name, _ in cube_rotations())


class PictureSource(Source):
    """Pictures that are there, replayed as a recording's are.

    Args:
        captures: of one scene.
        objects: as masks show them.
        transfer: of colours.
    """

    def __init__(
        self, captures: Sequence[Capture], objects: ObjectTable | None = None, transfer: Transfer = "unknown"
    ) -> None:
        self._captures = {capture.request: capture for capture in captures}
        self._views = tuple(dict.fromkeys(capture.view for capture in captures))
        self._objects = objects or ObjectTable({})
        modes = frozenset(capture.mode for capture in captures)
        self._capabilities = Capabilities(modes=modes, dialect="pictures", transfer=transfer)

    @property
    def capabilities(self) -> Capabilities:
        return self._capabilities

    def recorded_views(self) -> tuple[View, ...]:
        return self._views

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        for request in requests:
            if request not in self._captures:
                raise MissingCaptureError(f"expected one of {len(self._captures)} pictures, got {request}")
            yield self._captures[request]

    def objects(self) -> ObjectTable:
        return self._objects


def from_faces(
    faces: Mapping[str, ArrayLike],
    *,
    position: ArrayLike = (0.0, 0.0, 0.0),
    yaw_deg: float = 0.0,
    fov_deg: float = 90.0,
    objects: ObjectTable | None = None,
    transfer: Transfer = "unknown",
    **modes: Mapping[str, ArrayLike],
) -> PictureSource:
    """Return a source of six faces around one optical centre.

    Args:
        faces: colours by name (front, right, back, left, up, down): (s, s, 3) uint8 or float32. The lower
            edge of up and the upper edge of down touch front.
        position: (3,) of the centre, world frame, metres.
        yaw_deg: of the front face, to the left.
        fov_deg: of every face, at least 90.
        objects: of masks.
        transfer: of colours.
        modes: the same faces in other modes, such as ``depth`` ((s, s), planar metres) and ``object_mask``.

    Raises:
        ArgumentError: other names, or faces that are not square and of one size and type.
    """
    number("fov_deg", fov_deg, least=90, below=180)
    center_w = numbers("position", position, (3,))
    turn_w = Pose.from_angles(center_w, yaw_deg=yaw_deg).R_w_c @ Pose.from_angles(center_w).R_w_c.T
    captures = []
    for mode, named in {"lit": faces, **modes}.items():
        row = modalities.get(mode)
        if set(named) != set(NAMES):
            raise ArgumentError(f"{mode}: expected faces {', '.join(NAMES)}; got {shown(', '.join(named))}")
        arrays: dict[str, NDArray[Any]] = {name: np.asarray(named[name]) for name in NAMES}
        kinds = {(array.shape, array.dtype.name) for array in arrays.values()}
        edges = {shape[:2] for shape, _ in kinds}
        if len(kinds) > 1 or len(set(*edges)) > 1 or not all(map(row.fits, arrays.values())):
            wanted = f"six square faces of one size, {' or '.join(row.dtypes)}"
            raise ArgumentError(f"{mode}: expected {wanted}, got {shown(sorted(kinds))}")
        for name, R_w_c in cube_rotations():
            edge = arrays[name].shape[0]
            view = View(Pose(center_w, turn_w @ R_w_c), fov_deg, edge, edge)
            captures.append(Capture(Request(view, row.name), view, arrays[name]))
    return PictureSource(captures, objects, transfer)
