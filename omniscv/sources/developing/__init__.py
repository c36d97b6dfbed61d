"""Development of captures: turned faces are put straight, seams of colours mended, and the sky is marked.

Planner and composition take what is developed as captured, of a live source and of its recording alike.
"""

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from omniscv.geometry import Array, Pose, cube_rotations
from omniscv.geometry.arrays import Mask
from omniscv.render_options import RenderOptions
from omniscv.sources.base import Capture, ObjectTable, Request, Source, SourceWrapper, View, known_objects
from omniscv.sources.developing.cube import Cube
from omniscv.sources.developing.seams import mend
from omniscv.sources.developing.slips import POOLED, pooled_vignette, proven_turns, straightened
from omniscv.sources.labels import labels_of, labels_of_ids
from omniscv.sources.recorded_views import RecordedViews

_SAME = 1e-6  # entries of rotations


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

    def around(self, source: Source) -> Source:
        return Developed(source, self._options)

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        if self._options.seams == "keep":
            yield from map(self._alone, self._source.capture(requests))
            return
        # By request: those of its cube, what was captured of its place, and what is asked for now.
        asked: deque[tuple[Request, list[Request], dict[Request, Capture], list[Request]]] = deque()

        def needed() -> Iterator[Request]:
            for _, at in groupby(requests, lambda request: request.view.key().position):
                here = list(at)
                place = dict[Request, Capture]()
                claimed = set[Request]()
                for request in here:
                    cube = self._cube(request, here)
                    new = [each for each in dict.fromkeys((request, *cube)) if each not in claimed]
                    claimed.update(new)
                    asked.append((request, cube, place, new))
                    yield from new

        arriving = self._source.capture(needed())
        ahead = None
        while asked or (ahead := next(arriving, None)) is not None or asked:
            request, cube, place, new = asked.popleft()
            for each in new:
                capture = ahead or next(arriving, None)
                ahead = None
                if capture is None:
                    return
                place[each] = self._alone(capture)
            if request.mode == "lit" and "relit" not in place[request].marks and not request.again:
                self._mend(place, cube or [request])
            yield place[request]

    def _cube(self, request: Request, here: Sequence[Request]) -> list[Request]:
        """Return the six faces of the cube that a capture of colours is one of, then their masks; else none.

        Masks of a recording count if it has them, those of a live source if they are requested, too.
        """
        view = request.view
        scale = self._options.truth_scale
        sees_a_face = view.width == view.height and view.focal_px <= view.width / 2 * (1 + _SAME)
        if request.mode != "lit" or request.again or view.lens or not sees_a_face:
            return []
        six = tuple(replace(view, pose=Pose(view.pose.t_w_c, R_w_c)) for _, R_w_c in cube_rotations())
        if self._recorded is not None:
            six = self._recorded.faces(view.pose.t_w_c, six, scale)
        if view not in six or any(len(self._source.cover(face)) > 1 for face in six):
            return []
        faces = [replace(request, view=face) for face in six]
        masks = [Request(face.scaled(scale), "object_mask", request.state) for face in six]
        known = self._recorded_masks.issuperset(mask.view for mask in masks) or set(here).issuperset(masks)
        return faces + masks if known else faces

    def _mend(self, place: dict[Request, Capture], requests: Sequence[Request]) -> None:
        """Replace captures of colours by mended ones, with their masks among the captures."""
        faces = [place[request] for request in requests if request.mode == "lit"]
        masks = [place[request].pixels for request in requests if request.mode != "lit"]
        views = [face.view for face in faces]
        pixels = [face.pixels for face in faces]
        transfer = self._source.capabilities.transfer
        mended = mend(views, pixels, self._options.seams, transfer, masks, self._vignette)
        for face, colors, relit in zip(faces, mended.pixels, mended.relit, strict=True):
            provenance = {**face.provenance, "seams": mended.report}
            mark = {"relit": relit}
            place[face.request] = replace(
                face, pixels=colors, payload=None, marks=mark, provenance=provenance
            )

    def _alone(self, capture: Capture) -> Capture:
        """Return a capture, straight, and of masks with a mark where objects are that stand for the sky."""
        capture = self._straight(capture)
        if capture.mode != "object_mask" or not self._options.sky:
            return capture
        table = self._source.objects()
        labels, _ = (labels_of_ids if capture.pixels.ndim == 2 else labels_of)(capture.pixels, table)
        sky = stands_for_sky(labels, table, self._options)
        return replace(capture, marks={"sky": np.where(sky, np.uint8(255), np.uint8(0))})

    def _straight(self, capture: Capture) -> Capture:
        """Return a capture of a face that is turned as it should be; others as they are."""
        if not self._options.straighten or self._recorded is None:
            return capture
        center_w = capture.view.pose.t_w_c
        R_w_c = capture.view.pose.R_w_c
        if (at := center_w.tobytes()) not in self._turns:
            cube = Cube.recorded(self._source, center_w, capture.request.state)
            turns = {} if cube is None else proven_turns(cube)
            views = () if cube is None else cube.views
            self._turns[at] = [(views[face].pose.R_w_c, turn) for face, turn in turns.items()]
        turn = next((turn for R, turn in self._turns[at] if np.abs(R - R_w_c).max() < _SAME), None)
        return capture if turn is None else straightened(capture, turn)

    @cached_property
    def _recorded(self) -> RecordedViews | None:
        return self._source.recorded()

    @cached_property
    def _recorded_masks(self) -> frozenset[View]:
        modes = self._source.capabilities.modes
        return frozenset(self._source.recorded_in("object_mask") if "object_mask" in modes else ())

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
        centers = self._recorded.centers()
        some = np.unique(np.linspace(0, len(centers) - 1, min(len(centers), POOLED)).astype(int))
        places = (np.array(centers[i]) for i in some)
        cubes = (Cube.recorded(self._source, at, self._source.state) for at in places)
        return pooled_vignette((cube for cube in cubes if cube is not None), transfer)


def stands_for_sky(labels: NDArray[np.uint16], table: ObjectTable, options: RenderOptions) -> Mask:
    """Return (...) whether labels (...) are of objects that stand for the sky; ArgumentError for an unknown
    name."""
    known_objects(options.sky, table.names(), "sky")
    return np.isin(labels, [table.label(name) for name in options.sky])


def develop(source: Source, options: RenderOptions) -> Source:
    """Return a source whose captures are developed; the source itself where options ask for nothing."""
    asked = options.seams != "keep" or options.straighten or options.sky
    return Developed(source, options) if asked else source
