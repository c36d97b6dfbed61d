"""Development of captures: turned faces are put straight, seams of colours mended, and the sky is marked.

Planner and composition take what is developed as captured, of a live source and of its recording alike.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import groupby
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from omniscv.geometry import Array, Pose, cube_rotations
from omniscv.geometry.arrays import Mask
from omniscv.render_options import RenderOptions
from omniscv.sources.base import (
    Capabilities,
    Capture,
    ObjectTable,
    Request,
    Source,
    SourceWrapper,
    View,
    known_objects,
)
from omniscv.sources.developing.cube import Cube
from omniscv.sources.developing.seams import mend
from omniscv.sources.developing.slips import POOLED, pooled_vignette, proven_turns, straightened
from omniscv.sources.labels import labels_of, labels_of_ids
from omniscv.sources.recorded_views import RecordedViews

_SAME = 1e-6  # entries of rotations


class _Waiting(NamedTuple):
    """A request that waits for captures.

    Attributes:
        request: the request.
        cube: the requests of the cube that it is a face of; else none.
        captures: what was captured at its centre.
        new: what must be captured for it, in this order.
    """

    request: Request
    cube: list[Request]
    captures: dict[Request, Capture]
    new: list[Request]


class Developed(SourceWrapper):
    """A source whose captures are developed as ``seams``, ``straighten`` and ``sky`` of the options say.

    A capture of colours that is one of six 8-bit faces of a cube is mended with the other five, which are
    captured with it; their masks, ``truth_scale`` times finer, keep outlines from being closed. Other
    captures of colours say why they are not mended. ``marks`` of captures tell what was changed, and what is
    sky.
    """

    def __init__(self, source: Source, options: RenderOptions) -> None:
        super().__init__(source)
        self._options = options

    @property
    def capabilities(self) -> Capabilities:
        """Those of the source, but for colours of rays where those of captures are mended."""
        can = self._source.capabilities
        return can if self._options.seams == "keep" else replace(can, shades=False)

    def around(self, source: Source) -> Source:
        return Developed(source, self._options)

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        if self._options.seams == "keep":
            yield from map(self._alone, self._source.capture(requests))
            return
        waiting: deque[_Waiting] = deque()
        arriving = self._source.capture(self._needed(requests, waiting))
        ahead: Capture | None = None  # of the next new request, read to know whether there is one
        while True:
            if not waiting:
                ahead = next(arriving, None)  # adds to those that wait
            if not waiting:
                return
            request, cube, captures, new = waiting.popleft()
            for new_request in new:
                capture = ahead or next(arriving, None)
                ahead = None
                if capture is None:
                    return
                captures[new_request] = self._alone(capture)
            if request.mode == "lit" and "relit" not in captures[request].marks and not request.again:
                self._mend(captures, cube or [request])
            yield captures[request]

    def _needed(self, requests: Iterable[Request], waiting: deque[_Waiting]) -> Iterator[Request]:
        """Yield what must be captured for requests, which are added to those that wait."""
        for _, group in groupby(requests, lambda request: request.view.key().position):
            here = list(group)
            captures: dict[Request, Capture] = {}
            claimed: set[Request] = set()
            for request in here:
                cube = self._cube(request, here)
                new = [needed for needed in dict.fromkeys((request, *cube)) if needed not in claimed]
                claimed.update(new)
                waiting.append(_Waiting(request, cube, captures, new))
                yield from new

    def _cube(self, request: Request, here: Sequence[Request]) -> list[Request]:
        """Return the six faces of the cube that a capture of colours is one of, then their masks; else none.

        Masks of a recording count if it has them, those of a live source if they are requested, too.
        """
        if request.mode != "lit" or request.again:
            return []
        six = self._faces_around(request.view)
        if request.view not in six or any(len(self._source.cover(face)) > 1 for face in six):
            return []
        scale = self._options.truth_scale
        faces = []
        masks = []
        for face in six:
            faces.append(replace(request, view=face))
            masks.append(Request(face.scaled(scale), "object_mask", request.state))
        if self._recorded_masks.issuperset(mask.view for mask in masks) or set(here).issuperset(masks):
            return faces + masks
        return faces

    def _faces_around(self, view: View) -> tuple[View, ...]:
        """Return the six faces of the cube around a view's centre; none if it shows less than a face."""
        sees_a_face = view.width == view.height and view.focal_px <= view.width / 2 * (1 + _SAME)
        if view.lens or not sees_a_face:
            return ()
        center_w = view.pose.t_w_c
        six = tuple(replace(view, pose=Pose(center_w, R_w_c)) for _, R_w_c in cube_rotations())
        if self._recorded is None:
            return six
        return self._recorded.faces(center_w, six, self._options.truth_scale)

    def _mend(self, captures: dict[Request, Capture], requests: Sequence[Request]) -> None:
        """Replace captures of colours by mended ones, with their masks among the captures."""
        faces = [captures[request] for request in requests if request.mode == "lit"]
        masks = [captures[request].pixels for request in requests if request.mode != "lit"]
        views = [face.view for face in faces]
        pixels = [face.pixels for face in faces]
        transfer = self._source.capabilities.transfer
        mended = mend(views, pixels, self._options.seams, transfer, masks, self._vignette)
        for face, colors, relit in zip(faces, mended.pixels, mended.relit, strict=True):
            captures[face.request] = replace(
                face,
                pixels=colors,
                payload=None,
                marks={"relit": relit},
                provenance={**face.provenance, "seams": mended.report},
            )

    def _alone(self, capture: Capture) -> Capture:
        """Return a capture, straight, and of masks with a mark where objects are that stand for the sky."""
        capture = self._straight(capture)
        if capture.mode != "object_mask" or not self._options.sky:
            return capture
        table = self._source.objects()
        if capture.pixels.ndim == 2:
            labels, _ = labels_of_ids(capture.pixels, table)
        else:
            labels, _ = labels_of(capture.pixels, table)
        sky = stands_for_sky(labels, table, self._options)
        return replace(capture, marks={"sky": np.where(sky, np.uint8(255), np.uint8(0))})

    def _straight(self, capture: Capture) -> Capture:
        """Return a capture of a face that is turned as it should be; others as they are."""
        if not self._options.straighten or self._recorded is None:
            return capture
        center_w = capture.view.pose.t_w_c
        key = center_w.tobytes()
        if key not in self._turns:
            cube = Cube.recorded(self._source, center_w, capture.request.state)
            self._turns[key] = [] if cube is None else _turned_faces(cube)
        for R_w_c, turn in self._turns[key]:
            if np.abs(R_w_c - capture.view.pose.R_w_c).max() < _SAME:
                return straightened(capture, turn)
        return capture

    @cached_property
    def _recorded(self) -> RecordedViews | None:
        return self._source.recorded()

    @cached_property
    def _recorded_masks(self) -> frozenset[View]:
        if "object_mask" not in self._source.capabilities.modes:
            return frozenset()
        return frozenset(self._source.recorded_in("object_mask"))

    @cached_property
    def _turns(self) -> dict[bytes, list[tuple[Array, Array]]]:
        """By centre, the rotations of the views that are turned, and by which rotation vector."""
        return {}

    @cached_property
    def _vignette(self) -> tuple[float, float] | None:
        """The vignette that several places of a recording show together."""
        transfer = self._source.capabilities.transfer
        if self._recorded is None or transfer == "unknown":
            return None
        return pooled_vignette(self._pooled_cubes(self._recorded.centers()), transfer)

    def _pooled_cubes(self, centers: Sequence[Sequence[float]]) -> Iterator[Cube]:
        """Yield the cubes at some of a recording's centres, spread evenly over their order."""
        chosen = np.unique(np.linspace(0, len(centers) - 1, min(len(centers), POOLED)).astype(int))
        for index in chosen:
            cube = Cube.recorded(self._source, np.array(centers[index]), self._source.state)
            if cube is not None:
                yield cube


def _turned_faces(cube: Cube) -> list[tuple[Array, Array]]:
    """Return the rotations ``R_w_c`` of faces that are turned, and by which rotation vector."""
    turned = []
    for face, turn in proven_turns(cube).items():
        turned.append((cube.views[face].pose.R_w_c, turn))
    return turned


def stands_for_sky(labels: NDArray[np.uint16], table: ObjectTable, options: RenderOptions) -> Mask:
    """Return (...) whether ``labels`` (...) of a ``table`` are of objects that stand for the sky.

    Raises:
        ArgumentError: the ``options`` name an object that the table lacks.
    """
    known_objects(options.sky, table.names(), "sky")
    return np.isin(labels, [table.label(name) for name in options.sky])


def develop(source: Source, options: RenderOptions) -> Source:
    """Return a source whose captures are developed; the source itself where options ask for nothing."""
    if options.seams != "keep" or options.straighten or options.sky:
        return Developed(source, options)
    return source
