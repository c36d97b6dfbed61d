"""Compose one image, from the rounds of its plan to its layers."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from omniscv import light, modalities
from omniscv.compose.cache import Once
from omniscv.compose.image import Effort, OmniImage
from omniscv.compose.layers import Canvas, derived_layers, mark_beyond_reach, round_depth
from omniscv.compose.light_checks import BITS, compare
from omniscv.compose.samplers import SAMPLE, Blocks, Sampler
from omniscv.compose.seen_points import SeenPoints
from omniscv.depth.depth_pictures import DepthPictures
from omniscv.depth.nearest import boundaries
from omniscv.depth.relief import depth_relief, planar_errors
from omniscv.errors import BadReplyError, MissingCaptureError
from omniscv.geometry import Array
from omniscv.geometry.arrays import Faces, Floats, Ints, Mask, reads_few, stacked
from omniscv.planning import Captures, KnownDepth, Plan, Round, Viewpoint, captured, captured_progress, drive
from omniscv.planning.plan import Doubted
from omniscv.planning.rounds import FINER, pixels_of
from omniscv.planning.viewpoints import SAME_M
from omniscv.progress import Progress, Report
from omniscv.render_options import COMPARED
from omniscv.sources import codecs
from omniscv.sources.base import Capture, Source, Traced, View
from omniscv.sources.developing import stands_for_sky

_FLOAT32 = 2.0**-23
"""Relative error of a distance that is stored as float32, and of its ray's digits."""


class Composing:
    """An image while it is captured and composed.

    Args:
        plan: of the image; its ``modes`` are those that are sampled.
        source: where captures come from.
        sampler_of: makes a sampler of rays, (3, 3) from their frame to the world, views, and whether they are
            the rays of the whole image.
        once: makes what may serve several images.
        report: called after each viewpoint, and when the image is done.
    """

    def __init__(
        self,
        plan: Plan,
        source: Source,
        sampler_of: Callable[[Blocks, Array, tuple[View, ...], bool], Sampler],
        once: Once,
        report: Report,
    ) -> None:
        self._plan = plan
        self._source = source
        self._modes = plan.modes
        self._shown = plan.modes  # and what is traced in the end
        self._make_sampler = sampler_of
        self._once = once
        self._report = report
        track = self._modes if plan.options.unseen == "blank" else ()
        self._canvas = Canvas(plan.rays.valid, plan.rays.origins is None, track)
        self._finer = Canvas(plan.rays.valid, plan.rays.origins is None)
        self._filter: str = plan.options.filter
        self._progress = Progress(of_images=1)
        self._viewpoint: Viewpoint | None = None
        self._samplers: dict[tuple[View, ...], Sampler] = {}
        self._provenance: Mapping[str, Any] = {}
        self._seams: list[dict[str, Any]] = []
        self._pixels = 0
        self._stopped = ""
        self._strategy = plan.options.strategy
        self._largest_m = np.inf  # that captures of depth store

    def compose(self) -> tuple[OmniImage, Mask | None]:
        """Return the image, and (H, W) where masks show objects that stand for the sky; None if none were
        looked for."""
        drive(replace(self._plan, doubt=self._doubted).rounds(), self._capture)
        if self._plan.traced:
            self._trace()
        if self._plan.shaded:
            self._shade()
        self._report(self._progress + Progress(images=1))
        return self._image(), self._canvas.sky

    def _trace(self) -> None:
        """Put the ground truth that comes by one ray a pixel, exact but for the digits of float32."""
        plan = self._plan
        for pixels, origins_w, directions_w in plan.world_rays():
            self._put_traced(pixels, self._source.trace(origins_w, directions_w))
            self._canvas.put_centers(pixels, origins_w)
            if not plan.rays.one_center:
                self._mark_occluded(pixels, origins_w)
        self._shown = (*self._shown, *plan.traced)
        self._provenance = {**self._provenance, "traced": list(plan.traced)}

    def _shade(self) -> None:
        """Put colours that are the mean light of several rays of each pixel."""
        plan = self._plan
        can = self._source.capabilities
        for pixels, origins_w, directions_w in plan.color_rays():
            count = len(pixels)
            shades = self._source.shade(origins_w.reshape(-1, 3), directions_w.reshape(-1, 3))
            shades = shades.reshape(plan.shaded, count, 3)
            if plan.options.checks == "light" and not can.float_colors:
                codes = np.round(255 * shades)
                clipped = ((codes <= 0) | (codes >= 255)).any(axis=(0, 2))
                self._canvas.put_part("light", pixels, np.asarray(clipped * np.uint8(BITS["clipped"])))
            if can.float_colors:
                colors = shades.mean(axis=0, dtype=np.float32)
            else:
                mean = light.light_of_codes(255 * shades, can.transfer).mean(axis=0)
                colors = light.encode(mean.astype(np.float32), can.transfer)
            self._canvas.put_part("lit", pixels, colors)
            if not plan.traced and not plan.modes:  # as ground truth would
                own_w = plan.origins_w(pixels)
                self._canvas.put_centers(pixels, own_w)
                if can.traces and not plan.rays.one_center:
                    self._mark_occluded(pixels, own_w)
        self._shown = (*self._shown, "lit")
        self._provenance = {**self._provenance, "color_rays": plan.shaded}

    def _put_traced(self, pixels: Ints, traced: Traced) -> None:
        """Put what the rays of (N,) pixels meet, and its marks."""
        plan = self._plan
        distance, label, normal = traced
        objects = self._source.objects() if plan.options.sky or "object_mask" in plan.traced else None
        if plan.options.sky and objects is not None:
            self._canvas.put_part("sky", pixels, stands_for_sky(label, objects, plan.options))
        error = np.where(np.isfinite(distance), distance * _FLOAT32, 0).astype(np.float32)
        masks = label if objects is None else objects.mask_values()[label]
        values = {"depth": distance.astype(np.float32), "object_mask": masks}
        marks = {"depth_error": error, "label_edge": np.zeros(len(pixels), np.bool_)}
        for mode in plan.traced:
            self._canvas.put_part(mode, pixels, values.get(mode, normal.astype(np.float32)))
            if mark := modalities.get(mode).marked_by:
                self._canvas.put_part(mark, pixels, marks[mark])

    def _mark_occluded(self, pixels: Ints, origins_w: Array) -> None:
        """Mark the pixels whose optical centres (N, 3) the camera's position does not see."""
        center_w = self._plan.pose.t_w_c
        away = np.linalg.norm(origins_w - center_w, axis=-1)
        apart = np.flatnonzero(away > SAME_M)
        toward = (origins_w[apart] - center_w) / away[apart, None]
        hidden = self._source.trace(center_w, toward).distance < away[apart] * (1 - SAME_M)
        self._canvas.put_part("occluded", pixels[apart], hidden)

    def _capture(self, round_: Round) -> Captures:
        """Capture a round, compose viewpoint by viewpoint, and return the kept captures."""
        serving = [viewpoint for viewpoint in round_.viewpoints if len(viewpoint.pixels)]
        if round_.stopped:
            self._stopped = round_.stopped
        if round_.instead:
            self._strategy = round_.instead
        if serving and self._filter == "auto":
            self._filter = self._filter_for(serving[len(serving) // 2])
        kept: Captures = []
        requests = round_.requests(self._modes)
        self._pixels += pixels_of(request.view for request in requests)
        self._progress += Progress(of_captures=len(requests))
        self._require_second_size(serving)
        for viewpoint, captures in captured(round_, self._source, self._modes):
            if len(viewpoint.pixels):
                self._compose(viewpoint, captures)
                self._compare(viewpoint, captures)
            if "depth" in captures:
                self._largest_m = codecs.precision(captures["depth"][0]).largest_m
            if viewpoint.keep:
                kept.append(captures)
            self._progress += captured_progress(captures)
            self._report(self._progress)
        return kept

    def _require_second_size(self, viewpoints: Sequence[Viewpoint]) -> None:
        """Raise MissingCaptureError if a recording has one size of ground truth and ``beat`` needs two."""
        if self._plan.recorded is None:
            return
        for viewpoint in viewpoints:
            compared = [request.view for request in viewpoint.finer(self._modes)]
            if self._plan.recorded.hold(compared) or not self._plan.available(viewpoint.views):
                continue
            expected = "checks: expected a recording with ground truth in a second size for 'beat'"
            raise MissingCaptureError(f"{expected}, got one size", None, "record with checks=beat")

    def _image(self) -> OmniImage:
        """Return the image as far as it is composed."""
        plan = self._plan
        valid = self._canvas.valid
        sampled = self._canvas.layers()
        shown = {mode: sampled[mode] for mode in self._shown if mode in sampled}
        layers, objects, unknown = derived_layers(shown, valid, plan.pose.R_w_c, self._source.objects)
        marks = {"unsure", "occluded", "relit", "light"}
        marks |= {modalities.get(mode).marked_by for mode in self._shown}
        layers["unsure"] = np.zeros(valid.shape, np.bool_)
        layers |= {name: layer for name, layer in sampled.items() if name in marks}
        if plan.options.unseen == "blank":
            layers["unseen"] = plan.rays.valid & ~valid
        mark_beyond_reach(layers, valid)
        if "depth" in layers and "depth_error" in layers:
            layers["depth"], layers["depth_error"] = round_depth(layers["depth"], layers["depth_error"])
        return OmniImage(
            camera=plan.rays.camera, pose=plan.pose, valid=valid, layers=layers,
            centers_w=self._canvas.centers_w, objects=objects, unknown_colors=unknown,
            transfer=self._source.capabilities.transfer,
            provenance={**self._provenance, "seams": self._seams} if self._seams else self._provenance,
            options=plan.options,
            effort=Effort(
                self._progress.captures, self._pixels / 1e6, self._stopped, self._strategy, plan.by_ray
            ),
        )  # fmt: skip

    def _doubted(self) -> Doubted:
        """Return what the image doubts, as far as it is composed."""
        image = self._image()
        doubt = image.doubt
        beyond = np.zeros(image.valid.shape, np.bool_)
        if image.depth is not None and self._largest_m < np.inf:
            beyond = doubt & np.isinf(image.depth)
            beyond &= True if image.labels is None else image.labels > 0
        return Doubted(doubt & ~beyond, int(np.count_nonzero(beyond)), self._largest_m)

    def _filter_for(self, viewpoint: Viewpoint) -> str:
        """Return the filter of the whole image, where it is ``auto``: what its middle viewpoint needs."""
        blended = any(modalities.get(mode).interpolation == "blended" for mode in self._modes)
        if not blended or viewpoint.toward_w is not None:
            return "bilinear"
        return "area" if self._sampler(viewpoint, viewpoint.views).minifies else "bilinear"

    def _compare(self, viewpoint: Viewpoint, captures: Mapping[str, Sequence[Capture]]) -> None:
        """Compose captures of another size apart, and compare them with what the image has."""
        finer = {mode: captures[FINER + mode] for mode in COMPARED if FINER + mode in captures}
        if not finer:
            return
        canvas = self._canvas
        known = viewpoint.known_depth
        toward_w = viewpoint.toward_w
        self._canvas = self._finer
        self._compose(replace(viewpoint, known_depth=None), finer)
        self._canvas = canvas
        if known is not None and toward_w is not None and "depth" in finer:
            # Captured along other directions, and from the centre.
            nearer = known.distance - np.linalg.norm(toward_w, axis=-1)
            self._finer.flat["depth"][viewpoint.pixels] += np.where(np.isfinite(nearer), nearer, 0)
        compare(finer, canvas.flat, self._finer.flat, viewpoint.pixels, self._plan.rays.valid.shape)

    def _compose(self, viewpoint: Viewpoint, captures: Mapping[str, Sequence[Capture]]) -> None:
        offsets_w = self._offsets_w(viewpoint)
        self._put_known(viewpoint, offsets_w)
        known: KnownDepth | SeenPoints | None = viewpoint.known_depth
        if known is None:  # before depth is sampled
            near_m = self._source.capabilities.near_m
            unknown = np.zeros(0, np.float32)
            off = None if offsets_w is None else np.linalg.norm(offsets_w, axis=-1) / near_m
            known = KnownDepth(unknown, unknown, None if off is None else off.astype(np.float32))
        rows = [modalities.get(mode) for mode in self._modes]
        for row in sorted(rows, key=lambda row: row.interpolation != "surface"):  # depth gives the parallax
            of_mode = captures.get(row.captured_as or row.name)
            is_surface = row.interpolation == "surface"
            if of_mode is None or (is_surface and viewpoint.known_depth is not None):
                continue
            sampler = self._checked_sampler(row.name, viewpoint, of_mode)
            if is_surface:
                known = self._put_depth(viewpoint, sampler, of_mode, offsets_w)
            else:
                self._put_marks(row, viewpoint, sampler, of_mode)
                faces = self._faces(viewpoint, of_mode)
                self._put_values(row, viewpoint, sampler, of_mode, faces, known)
            self._provenance = of_mode[0].provenance

    def _put_marks(
        self, row: modalities.Modality, viewpoint: Viewpoint, sampler: Sampler, captures: Sequence[Capture]
    ) -> None:
        """Put what captures say of their development: which colours were changed, and what is sky."""
        for name in captures[0].marks:
            if name == "relit":
                self._seams.append(captures[0].provenance["seams"])
            marks = [capture.marks[name] for capture in captures]
            marked = sampler.sample("nearest" if row.truth else self._filter, marks) > 0
            self._canvas.put(name, viewpoint.pixels, marked)

    def _put_known(self, viewpoint: Viewpoint, offsets_w: Array | None) -> None:
        """Put what is known of pixels without captures, and where their depth is measured from."""
        origins_w = viewpoint.center_w
        known = viewpoint.known_depth
        if viewpoint.occluded is not None:
            self._canvas.put_part("occluded", viewpoint.pixels, viewpoint.occluded)
        if viewpoint.unsure is not None:
            self._canvas.put_part("unsure", viewpoint.pixels, viewpoint.unsure)
        if known is not None:
            unsure = known.unsure | _may_begin_behind(known.distance, known.error)
            layers = {"depth": known.distance, "depth_error": known.error, "unsure": unsure}
            for layer, values in layers.items():
                self._canvas.put_part(layer, viewpoint.pixels, values)
            if offsets_w is not None:  # known depth starts at the rays' origins
                origins_w = origins_w + offsets_w
        self._canvas.put_centers(viewpoint.pixels, origins_w)

    def _put_depth(
        self, viewpoint: Viewpoint, sampler: Sampler, captures: Sequence[Capture], offsets_w: Array | None
    ) -> KnownDepth | SeenPoints:
        """Sample depth, and return what it says to other modalities; ``offsets_w`` as :meth:`_offsets_w`."""
        faces = self._faces(viewpoint, captures)
        views = [capture.view for capture in captures]
        precision = codecs.precision(captures[0])
        rays = len(viewpoint.pixels)

        def pictures_of() -> DepthPictures:
            off = planar_errors(captures)
            relief = depth_relief(captures)
            return DepthPictures.of(faces, views, precision, rays, off, relief)

        pictures = pictures_of() if reads_few(faces, rays) else self._once("depth", captures, pictures_of)
        if viewpoint.check is None or offsets_w is None:
            known: KnownDepth | SeenPoints = (
                depth := sampler.sample_depth(self._filter, pictures, offsets_w)
            )
        else:
            depth = sampler.sample_depth(self._filter, pictures, None)
            rays_w = viewpoint.center_w + offsets_w, self._plan.directions_w(viewpoint.pixels)
            known = seen = SeenPoints.find(captures, *rays_w, viewpoint.check)
            depth = depth._replace(error=seen.bound(depth.distance))
            behind = _may_begin_behind(depth.distance, depth.error)
            self._canvas.put_part("unsure", viewpoint.pixels, seen.known.unsure | behind)
        self._canvas.put(captures[0].mode, viewpoint.pixels, depth.distance)
        self._canvas.put(modalities.get(captures[0].mode).marked_by, viewpoint.pixels, depth.error)
        return known

    def _faces(self, viewpoint: Viewpoint, captures: Sequence[Capture]) -> Faces:
        """Return the pixels of captures: as one array, but for colours, and where few of them are read."""
        faces = [capture.pixels for capture in captures]
        if captures[0].mode == "lit" or reads_few(faces, len(viewpoint.pixels)):
            return faces
        return self._once("stack", captures, lambda: stacked(faces))

    def _put_values(
        self,
        row: modalities.Modality,
        viewpoint: Viewpoint,
        sampler: Sampler,
        captures: Sequence[Capture],
        faces: Faces,
        known: KnownDepth | SeenPoints,
    ) -> None:
        """Sample another modality, and mark where its values may be a neighbour's."""
        sample = SAMPLE[row.interpolation]
        transfer = self._source.capabilities.transfer
        if row.name == "lit" and self._filter == "area" and light.known(transfer, faces[0]):
            decoded = [light.decode(face, transfer) for face in faces]
            values = light.encode(sample(sampler, self._filter, decoded), transfer)
        elif row.name == "lit":
            values = sampler.sample(self._filter, faces, lambda name, make: self._once(name, captures, make))
        else:
            values = sample(sampler, self._filter, faces)
        self._canvas.put(row.name, viewpoint.pixels, values)
        if row.name == "lit" and self._plan.options.checks == "light" and faces[0].dtype == np.uint8:
            extreme = [np.where((face == 0) | (face == 255), np.uint8(255), np.uint8(0)) for face in faces]
            clipped = sampler.sample(self._filter, extreme).any(axis=-1)
            self._canvas.put("light", viewpoint.pixels, np.asarray(clipped * np.uint8(BITS["clipped"])))
        if not row.marked_by:
            return
        lone = bool(known.relief.any()) if isinstance(known, KnownDepth) else False
        changes = self._once(("boundaries", lone), captures, lambda: boundaries(faces, lone))
        if isinstance(known, SeenPoints):
            blocks = self._plan.rays.blocks(viewpoint.pixels, known.toward_w)
            views = tuple(capture.view for capture in captures)
            there = self._make_sampler(lambda: blocks, np.eye(3), views, False)
            edges = known.label_edges(there, faces, changes, values)
        else:
            relief = known.relief if lone else None
            edges = sampler.label_edges(changes, known.direction_error, relief) | known.grazes
        self._canvas.put(row.marked_by, viewpoint.pixels, edges)

    def _checked_sampler(self, mode: str, viewpoint: Viewpoint, captures: Sequence[Capture]) -> Sampler:
        """Return a sampler of captures; raise unless they have one size and type, and see all rays."""
        types = {(capture.pixels.shape, capture.pixels.dtype.name) for capture in captures}
        if len(types) != 1:
            raise BadReplyError(f"expected captures of one size and type at a centre, got {sorted(types)}")
        sampler = self._sampler(viewpoint, tuple(capture.view for capture in captures))
        if sampler.unseen:
            raise _unseen(viewpoint, viewpoint.views_of(mode)[0], captures, sampler.unseen)
        return sampler

    def _sampler(self, viewpoint: Viewpoint, views: tuple[View, ...]) -> Sampler:
        """Return the sampler of views at a viewpoint, one for all modes."""
        if viewpoint is not self._viewpoint:
            self._viewpoint = viewpoint
            self._samplers = {}
        if views in self._samplers:
            return self._samplers[views]
        rays = self._plan.rays
        R_w_d = self._plan.pose.R_w_c
        toward_w = viewpoint.toward_w
        if rays.origins is None and len(viewpoint.pixels) == rays.valid_count:  # all of the image
            sampler = self._make_sampler(rays.blocks, R_w_d, views, True)
        else:
            R_w_d = R_w_d if toward_w is None else np.eye(3)
            sampler = self._make_sampler(lambda: rays.blocks(viewpoint.pixels, toward_w), R_w_d, views, False)
        self._samplers[views] = sampler
        return sampler

    def _offsets_w(self, viewpoint: Viewpoint) -> Array | None:
        """Return (N, 3) from the viewpoint's centre to the pixels' own, world frame; None where they
        coincide, and where depth is compared along other directions."""
        known_ray = viewpoint.toward_w is None or viewpoint.known_depth is not None
        if self._plan.rays.origins is None or not known_ray:
            return None
        offsets_w = self._plan.origins_w(viewpoint.pixels) - viewpoint.center_w
        return offsets_w if np.abs(offsets_w).max() > SAME_M else None


def _unseen(
    viewpoint: Viewpoint, planned: View, captures: Sequence[Capture], count: int
) -> MissingCaptureError:
    """Return the error of rays that no capture sees."""
    view = captures[0].view
    advice = "capture with strategy 'cube'"
    if (planned.fov_deg, planned.width, planned.height) != (view.fov_deg, view.width, view.height):
        came = f"they came as {view.width} x {view.height} of {view.fov_deg:g} degrees"
        square = "make the source deliver square pictures of 90 degrees"
        advice = f"{came}; {square} ('omniscv doctor' measures what a server delivers)"
    expected = f"expected {len(captures)} views at {viewpoint.center_w.tolist()} m to see all"
    return MissingCaptureError(
        f"{expected} {len(viewpoint.pixels)} rays, but {count} are seen by none; {advice}"
    )


def _may_begin_behind(distance: Floats, error: Floats) -> Mask:
    """Return which rays from beside a shared centre may begin behind a surface: their bound reaches 0 m."""
    return np.isfinite(error) & (error >= distance)
