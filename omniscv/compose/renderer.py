"""Camera, rays, plan, source, compose, image: one pipeline, for central and non-central cameras alike."""

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import fields
from functools import partial
from typing import Any, Unpack

from omniscv import modalities
from omniscv.arguments import shown
from omniscv.cameras import Camera
from omniscv.compose.cache import ByteCache
from omniscv.compose.composition import Composition
from omniscv.compose.image import OmniImage
from omniscv.compose.ray_bundle import ImageRays, RayBundle
from omniscv.compose.samplers import CpuSampler, Sampler
from omniscv.compose.shared_captures import PlaceCaptures, SharedCaptures
from omniscv.compose.tiles import TiledSampler, Tiles, image_rays
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose
from omniscv.planning import (
    RecordedViews,
    RenderKeywords,
    RenderOptions,
    Task,
    drive,
    proven,
    rounds,
    sampled,
    together,
)
from omniscv.progress import Meter, Report
from omniscv.sources.base import Source, View

DEFAULT_CACHE_BYTES = 2 << 30
DEFAULT_TILE_BYTES = 1 << 28
_FOR_CAPTURES = 8
"""The part of what is kept that captures of a recording may take: one in so many bytes."""


class Renderer:
    """Composes images from a source, and keeps rays and lookups from one to the next.

    Safe to use from several threads, also for several cameras at once, and in forked children as far as its
    source is; a pickled copy starts with nothing kept.

    Args:
        source: where captures come from; not closed with the renderer.
        cache_bytes: the bound of what is kept between images.
        tile_bytes: what the rays and lookups of an image may take at a time that is composed in tiles: of a
            central camera's, whose map would not fit into either bound. Nothing of its map is kept.
        sampler: what samples captures along rays.

    Raises:
        ArgumentError: no source.
    """

    def __init__(
        self,
        source: Source,
        *,
        cache_bytes: int = DEFAULT_CACHE_BYTES,
        tile_bytes: int = DEFAULT_TILE_BYTES,
        sampler: Callable[[RayBundle, Array, Sequence[View]], Sampler] = CpuSampler,
    ) -> None:
        if not isinstance(source, Source):
            raise ArgumentError(f"source: expected a Source, as open_source gives it, got {shown(source)}")
        for_captures = cache_bytes // _FOR_CAPTURES
        self.source, self._sampler, self._cache = source, sampler, ByteCache(cache_bytes - for_captures)
        recording = source.recorded_views() is not None
        self._here = PlaceCaptures(source, for_captures) if recording else source
        self._cache_bytes, self._tile_bytes = cache_bytes, tile_bytes
        self._recorded: RecordedViews | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        kept: dict[str, Any] = {"cache_bytes": self._cache_bytes, "tile_bytes": self._tile_bytes}
        return partial(Renderer, self.source, **kept, sampler=self._sampler), ()

    def of(self, source: Source) -> "Renderer":
        """Return a renderer of another source, for example of one in which objects are hidden; both share
        what is kept between images."""
        kept: dict[str, Any] = {"cache_bytes": self._cache_bytes, "tile_bytes": self._tile_bytes}
        other = Renderer(source, **kept, sampler=self._sampler)
        other._cache = self._cache
        return other

    @property
    def nbytes(self) -> int:
        """What is kept between images, bytes."""
        here = self._here.nbytes if isinstance(self._here, PlaceCaptures) else 0
        return self._cache.nbytes + here

    def task(
        self,
        camera: Camera,
        pose: Pose,
        options: RenderOptions | None = None,
        *,
        border_px: int | None = None,
    ) -> Task:
        """Return what a strategy plans for; see :class:`omniscv.planning.Task`.

        Raises:
            ArgumentError: a camera, pose or options of another type.
        """
        options = RenderOptions() if options is None else options
        given = ("camera", camera, Camera), ("pose", pose, Pose), ("options", options, RenderOptions)
        for name, value, kind in given:
            if not isinstance(value, kind):
                raise ArgumentError(f"{name}: expected a {kind.__name__}, got {shown(value)}")
        rays, source = self._rays(camera).camera_rays, self.source
        recorded = self._recorded_views()
        return Task(rays, pose, source.capabilities, options, source.cover, recorded, border_px, source.state)

    def render(
        self,
        camera: Camera,
        pose: Pose,
        modes: Sequence[str] = ("lit",),
        options: RenderOptions | None = None,
        *,
        progress: Report | None = None,
    ) -> OmniImage:
        """Compose an omnidirectional image and its ground truth from captures.

        Args:
            camera: the model and its size.
            pose: where the camera is, world frame.
            modes: modalities of :mod:`omniscv.modalities`; object_mask comes with labels.
            options: how it is captured and composed.
            progress: called with how far the image has come, after each viewpoint.

        Raises:
            ArgumentError: an unknown mode or strategy, or arguments that exclude each other.
            BadReplyError: the captures of one viewpoint differ in size or type.
            MissingCaptureError: the views that came do not see all rays.
            SourceError, RecordingError: a capture could not be had.
        """
        (image,) = self.render_together([(camera, pose)], modes, options, progress=progress)
        return image

    def render_together(
        self,
        shots: Sequence[tuple[Camera, Pose]],
        modes: Sequence[str] = ("lit",),
        options: RenderOptions | None = None,
        *,
        only: Collection[int] | None = None,
        progress: Report | None = None,
    ) -> Iterator[OmniImage]:
        """Yield the images of several cameras at one moment, in their order, as :meth:`render` makes them.

        What several of them need is captured once: see :func:`omniscv.planning.together`.

        Args:
            shots: cameras and their poses.
            modes, options, progress: as :meth:`render`.
            only: those of the shots, by index, whose images are made; all if not given. The others count for
                how they are captured, so that an image is the same whichever others are made.

        Raises:
            TornSetError: the world may move, and did so while they were captured, every time.
        """
        chosen = modalities.chosen(modes)
        if not self.source.capabilities.moves:
            yield from self._together(self._here, shots, chosen, options, only, progress)
            return

        def make(source: Source) -> list[OmniImage]:
            return list(self._together(source, shots, chosen, options, only, progress))

        yield from proven(self.source, sampled(chosen, options or RenderOptions()), make)

    def _together(
        self,
        source: Source,
        shots: Sequence[tuple[Camera, Pose]],
        chosen: tuple[str, ...],
        options: RenderOptions | None,
        only: Collection[int] | None,
        progress: Report | None,
    ) -> Iterator[OmniImage]:
        """Yield the images of a moment, captured from a source that stands for the renderer's."""
        tasks = [self.task(camera, pose, options) for camera, pose in shots]
        tasks, wanted = together(tasks, sampled(chosen, options or RenderOptions()))
        made = [i for i in range(len(tasks)) if only is None or i in only]
        needed = Counter(request for i in made for request in wanted[i])
        source = SharedCaptures(source, needed) if needed else source
        meter = Meter(len(made), progress)
        for task in (tasks[i] for i in made):
            rays = self._rays(task.rays.camera)
            composition = Composition(task, rays, chosen, source, self._sampler_of, meter.part())
            drive(rounds(task), composition.capture)
            self._cache.trim()
            yield composition.image()

    def _rays(self, camera: Camera) -> ImageRays:
        return self._cache.get(
            ("rays", camera), lambda: image_rays(camera, self._cache.limit, self._tile_bytes)
        )

    def _recorded_views(self) -> RecordedViews | None:
        views = self.source.recorded_views()
        if views is None:
            return None
        if self._recorded is None or self._recorded.views is not views:
            self._recorded = RecordedViews(views)
        return self._recorded

    def _sampler_of(
        self, rays: RayBundle, R_w_d: Array, views: tuple[View, ...], camera: Camera | None
    ) -> Sampler:
        """A sampler; kept where it serves a camera's whole image.

        Positions do not count: the same orientation and views around another centre have the same lookup.
        """
        if isinstance(rays, Tiles) and self._sampler is CpuSampler:
            return TiledSampler(rays, R_w_d, views)
        if camera is None:
            return self._sampler(rays, R_w_d, views)
        turned = tuple(view.key()._replace(position=()) for view in views)
        key = ("sampler", camera, R_w_d.tobytes(), turned)
        return self._cache.get(key, lambda: self._sampler(rays, R_w_d, views), keep_at_once=False)


def render(
    camera: Camera,
    pose: Pose,
    source: Source,
    modes: Sequence[str] = ("lit",),
    *,
    progress: Report | None = None,
    **options: Unpack[RenderKeywords],
) -> OmniImage:
    """Compose one image; :class:`Renderer` keeps rays and lookups for the next.

    Args:
        camera, pose, source, modes: what, from where, of which captures, and which modalities.
        progress: called with how far the image has come, after each viewpoint.
        options: the fields of :class:`omniscv.RenderOptions`.

    Raises:
        OmniscvError: as :meth:`Renderer.render`.
    """
    return Renderer(source).render(camera, pose, modes, options_of(options), progress=progress)


def options_of(keywords: RenderKeywords) -> RenderOptions:
    """Return options from keyword arguments; raise ArgumentError for others than they have."""
    known = [field.name for field in fields(RenderOptions)]
    if unknown := sorted(set(keywords) - set(known)):
        raise ArgumentError(f"options: expected some of {', '.join(known)}; got {', '.join(unknown)}")
    return RenderOptions(**keywords)
