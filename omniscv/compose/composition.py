"""One image, from the rounds of its plan to its layers."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from omniscv import modalities
from omniscv.cameras import Camera
from omniscv.compose.canvas import Canvas
from omniscv.compose.depth import NEAR_PLANE_M
from omniscv.compose.image import OmniImage, layers_of, mark_beyond_reach
from omniscv.compose.kernels import Floats
from omniscv.compose.ray_bundle import ImageRays, RayBundle
from omniscv.compose.samplers import Sampler
from omniscv.errors import BadReplyError, MissingCaptureError
from omniscv.geometry import Array
from omniscv.planning import Kept, Round, Task, Viewpoint, captured, captured_progress, sampled
from omniscv.progress import Progress, Report
from omniscv.sources.base import Capture, Source, View

_SAME_M = 1e-9
"""Optical centres nearer to each other than this are one."""


class Composition:
    """One image while it is captured and composed.

    Args:
        task: what is rendered.
        rays: of its camera.
        modes: what is captured.
        source: where captures come from.
        sampler_of: makes a sampler of rays, (3, 3) from their frame to the world, views, and the camera whose
            whole image they are, else None.
        report: called after each viewpoint, and when the image is done.
    """

    def __init__(
        self,
        task: Task,
        rays: ImageRays,
        modes: tuple[str, ...],
        source: Source,
        sampler_of: Callable[[RayBundle, Array, tuple[View, ...], Camera | None], Sampler],
        report: Report,
    ) -> None:
        self._task, self._rays, self._source = task, rays, source
        self._modes = sampled(modes, task.options)
        self._make_sampler, self._report = sampler_of, report
        self._valid_count = int(np.count_nonzero(task.rays.valid))
        self._canvas: Canvas | None = None
        self._filter: str = task.options.filter
        self._progress = Progress(of_images=1)
        self._last: tuple[Viewpoint, tuple[View, ...], Sampler] | None = None
        self._provenance: Mapping[str, Any] = {}

    def capture(self, round_: Round) -> Kept:
        """Capture a round, compose what it serves viewpoint by viewpoint, and return what is kept."""
        serving = [viewpoint for viewpoint in round_.viewpoints if len(viewpoint.pixels)]
        if serving and self._canvas is None:
            whole = len(serving) == 1 and len(serving[0].pixels) == self._valid_count
            self._canvas = Canvas(self._rays, whole and serving[0].toward_w is None)
            self._filter = self._filter_for(serving[len(serving) // 2])
        kept = []
        self._progress += Progress(of_captures=len(round_.requests(self._modes)))
        for viewpoint, captures in captured(round_, self._source, self._modes):
            if len(viewpoint.pixels):
                self._compose(viewpoint, captures)
            if viewpoint.keep:
                kept.append(captures)
            self._progress += captured_progress(captures)
            self._report(self._progress)
        return kept

    def image(self) -> OmniImage:
        """Return the image."""
        valid, canvas = self._rays.valid, self._canvas or Canvas(self._rays, whole=False)
        found = canvas.layers()
        modes = {mode: found.pop(mode) for mode in self._modes if mode in found}
        if "normals_from_depth" in modes:
            modes["normals"] = modes.pop("normals_from_depth")
        layers, objects, unknown = layers_of(modes, self._source, valid, self._task.pose.R_w_c)
        marks = {"unsure", "occluded", *(modalities.get(mode).marked_by for mode in self._modes)}
        layers["unsure"] = np.zeros(valid.shape, np.bool_)
        layers |= {name: layer for name, layer in found.items() if name in marks}
        mark_beyond_reach(layers, valid)
        task, provenance = self._task, self._provenance
        self._report(self._progress + Progress(images=1))
        return OmniImage(
            camera=task.rays.camera, pose=task.pose, valid=valid, layers=layers,
            centers_w=canvas.centers_w, objects=objects, unknown_colors=unknown,
            provenance=provenance, options=task.options,
        )  # fmt: skip

    def _filter_for(self, viewpoint: Viewpoint) -> str:
        """One filter for the whole image: what its middle viewpoint needs."""
        if self._filter != "auto":
            return self._filter
        blended = any(modalities.get(mode).interpolation == "blended" for mode in self._modes)
        if not blended or viewpoint.toward_w is not None:
            return "bilinear"
        return "area" if self._sampler_of(viewpoint, viewpoint.views).minifies else "bilinear"

    def _compose(self, viewpoint: Viewpoint, captures: Mapping[str, Sequence[Capture]]) -> None:
        canvas = self._canvas
        assert canvas is not None
        offsets_w = self._offsets_w(viewpoint)
        origins_w = viewpoint.center_w
        if viewpoint.found is not None and offsets_w is not None:  # found depth starts at the rays' origins
            origins_w = origins_w + offsets_w
        canvas.add_viewpoint(viewpoint, origins_w)
        parallax = self._parallax(viewpoint, offsets_w)
        rows = [modalities.get(mode) for mode in self._modes]
        for row in sorted(rows, key=lambda row: row.interpolation != "surface"):  # it says where labels are
            mode, mine = row.name, captures.get(row.captured_as or row.name)
            if mine is None or (row.interpolation == "surface" and viewpoint.found is not None):
                continue
            views = tuple(capture.view for capture in mine)
            faces = [capture.pixels for capture in mine]
            kinds = {(pixels.shape, pixels.dtype.name) for pixels in faces}
            if len(kinds) != 1:
                raise BadReplyError(
                    f"expected captures of one size and type at a centre, got {sorted(kinds)}"
                )
            sampler = self._sampler_of(viewpoint, views)
            self._check_seen(viewpoint.views_of(mode)[0], viewpoint, sampler, views)
            if row.interpolation == "surface":
                depth = canvas.sample_depth(viewpoint, sampler, self._filter, mine, offsets_w)
                parallax = depth.parallax
            else:
                canvas.sample(mode, viewpoint, sampler, self._filter, faces)
                if row.marked_by:
                    canvas.mark_edges(mode, viewpoint, sampler, faces, parallax)
            self._provenance = mine[0].provenance

    def _sampler_of(self, viewpoint: Viewpoint, views: tuple[View, ...]) -> Sampler:
        """The sampler of the captured views; the last one again for the next mode, if that came with the same
        views (masks may come from elsewhere than colours)."""
        if self._last is None or self._last[0] is not viewpoint or self._last[1] != views:
            self._last = viewpoint, views, self._new_sampler(viewpoint, views)
        return self._last[2]

    def _new_sampler(self, viewpoint: Viewpoint, views: tuple[View, ...]) -> Sampler:
        assert self._canvas is not None
        R_w_c = self._task.pose.R_w_c
        if viewpoint.toward_w is not None:
            toward = self._rays.toward(viewpoint.toward_w, viewpoint.pixels)
            return self._make_sampler(toward, np.eye(3), views, None)
        if self._canvas.whole:
            return self._make_sampler(self._rays.whole, R_w_c, views, self._task.rays.camera)
        return self._make_sampler(self._rays.of(viewpoint.pixels), R_w_c, views, None)

    def _offsets_w(self, viewpoint: Viewpoint) -> Array | None:
        """(N, 3) from the viewpoint's centre to the pixels' own, world frame; None where they coincide."""
        origins = self._task.rays.origins
        if origins is None:
            return None
        offsets_w = self._task.pose.to_world(origins.reshape(-1, 3)[viewpoint.pixels]) - viewpoint.center_w
        return offsets_w if np.abs(offsets_w).max() > _SAME_M else None

    def _parallax(self, viewpoint: Viewpoint, offsets_w: Array | None) -> Floats | None:
        """(N,) radians, how far from its ray a pixel's surface may show, before its depth is known."""
        if viewpoint.found is not None:
            return viewpoint.found.direction_error
        if offsets_w is None:
            return None
        return np.asarray(np.linalg.norm(offsets_w, axis=-1) / NEAR_PLANE_M, np.float32)

    def _check_seen(
        self, wanted: View, viewpoint: Viewpoint, sampler: Sampler, views: Sequence[View]
    ) -> None:
        if not sampler.unseen:
            return
        came = views[0]
        same = [(v.fov_deg, v.width, v.height) for v in (wanted, came)]
        advice = "capture with strategy 'cube'" if same[0] == same[1] else (
            f"they came as {came.width} x {came.height} of {came.fov_deg:g} degrees; make the source deliver "
            "square pictures of 90 degrees ('omniscv doctor' measures what a server delivers)"
        )  # fmt: skip
        raise MissingCaptureError(
            f"expected {len(views)} views at {viewpoint.center_w.tolist()} m to see all "
            f"{len(viewpoint.pixels)} rays, but {sampler.unseen} are seen by none; {advice}"
        )
