"""Render: from a camera, a pose and a source to an image, for central and non-central cameras alike."""

from collections import Counter
from collections.abc import Callable, Collection, Hashable, Iterator, Sequence
from dataclasses import fields, replace
from functools import cached_property, partial
from typing import Any, Unpack

from omniscv import modalities
from omniscv.arguments import did_you_mean, number, shown
from omniscv.cameras import Camera
from omniscv.cameras.rig import Rig
from omniscv.cameras.rolling_shutter import on_path
from omniscv.compose.cache import ByteCache, HeldCaptures, T
from omniscv.compose.composition import Composing
from omniscv.compose.image import OmniImage
from omniscv.compose.layers import mark_other_surfaces
from omniscv.compose.light_checks import examine
from omniscv.compose.samplers import Blocks, Sampler
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose
from omniscv.geometry.trajectory import Trajectory, nanoseconds
from omniscv.planning import ImageRays, Plan, RenderKeywords, RenderOptions, share_captures
from omniscv.planning.rays import BYTES_PER_RAY
from omniscv.progress import Meter, Report
from omniscv.sources.base import Capture, Request, Source, View, check_modes
from omniscv.sources.developing import develop
from omniscv.sources.recorded_views import RecordedViews
from omniscv.sources.stillness import verify_still

DEFAULT_CACHE_BYTES = 2 << 30
DEFAULT_TILE_BYTES = 1 << 28
_CAPTURES_DIVISOR = 8
"""At most ``cache_bytes`` divided by it are captures of a recording."""


class Renderer:
    """Composes images from a source, and keeps rays and lookups from one to the next.

    Safe to use from several threads, also for several cameras at once, and in forked children as far as its
    source is; a pickled copy starts with nothing kept.

    Args:
        source: where captures come from; not closed with the renderer.
        cache_bytes: bound of the memory that is kept between images.
        tile_bytes: bound of the memory for rays and lookups of a central camera's image that fits into
            neither bound: it is composed in blocks of rows, and its rays and lookups are not kept.
        sampler: samples captures along rays.

    Raises:
        ArgumentError: no source, or one of rays with two numberings of its objects.
    """

    def __init__(
        self,
        source: Source,
        *,
        cache_bytes: int = DEFAULT_CACHE_BYTES,
        tile_bytes: int = DEFAULT_TILE_BYTES,
        sampler: Callable[[Blocks, Array, Sequence[View]], Sampler] = Sampler,
    ) -> None:
        if not isinstance(source, Source):
            raise ArgumentError(f"source: expected a Source, as open_source gives it, got {shown(source)}")
        source.require_one_numbering()
        captures_bytes = cache_bytes // _CAPTURES_DIVISOR
        self.source = source
        self._sampler = sampler
        self._cache = ByteCache(cache_bytes - captures_bytes)
        self._captures_bytes = captures_bytes
        self._tile_bytes = tile_bytes
        self._held: tuple[Hashable, HeldCaptures] | None = None  # of a recording, by their development
        self._of = partial(Renderer, cache_bytes=cache_bytes, tile_bytes=tile_bytes, sampler=sampler)

    def __reduce__(self) -> tuple[Any, ...]:
        return self._of, (self.source,)

    def of(self, source: Source) -> "Renderer":
        """Return a renderer of another source, such as one with hidden objects; both share their cache."""
        other = self._of(source)
        other._cache = self._cache
        return other

    @property
    def nbytes(self) -> int:
        """Bytes kept between images."""
        return self._cache.nbytes + (self._held[1].nbytes if self._held else 0)

    def plan(
        self,
        camera: Camera,
        pose: Pose,
        options: RenderOptions | None = None,
        *,
        border_px: int | None = None,
    ) -> Plan:
        """Return the plan of an image; ArgumentError for a camera, pose or options of another type."""
        options = RenderOptions() if options is None else options
        arguments = ("camera", camera, Camera), ("pose", pose, Pose), ("options", options, RenderOptions)
        for name, value, expected in arguments:
            if not isinstance(value, expected):
                raise ArgumentError(f"{name}: expected a {expected.__name__}, got {shown(value)}")
        # In blocks if the camera is central, and its map would take more than both bounds.
        needed = BYTES_PER_RAY * camera.width * camera.height
        in_blocks = camera.central and needed > max(self._cache.limit, self._tile_bytes)
        block_bytes = self._tile_bytes if in_blocks else None
        rays = self._cache.get(("rays", camera), lambda: ImageRays(camera, block_bytes))
        source = self.source
        of_source = source.cover, self._recorded, border_px, source.state
        return Plan(rays, pose, source.capabilities, options, *of_source)

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
            progress: called with the image's progress after each viewpoint.

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

        Captures that several of them need are made once: see :func:`omniscv.planning.share_captures`.

        Args:
            shots: cameras and their poses.
            modes, options, progress: as :meth:`render`.
            only: indices of the shots whose images are made; all if not given. Captures are planned for all
                shots, so that an image does not depend on which others are made.

        Raises:
            TornSetError: the world moved during every try to capture them.
        """
        names = modalities.chosen(modes)
        options = RenderOptions() if options is None else options
        check_modes(self.source, options.sampled(names))

        def make(source: Source) -> Iterator[OmniImage]:
            for image in self._rendered(source, shots, names, options, only, progress):
                yield replace(image, layers=mark_other_surfaces(image.layers))

        if self.source.capabilities.moves:
            yield from verify_still(self.source, options.sampled(names), lambda source: list(make(source)))
        else:
            yield from make(self.source)

    def _rendered(
        self,
        source: Source,
        shots: Sequence[tuple[Camera, Pose]],
        modes: tuple[str, ...],
        options: RenderOptions,
        only: Collection[int] | None,
        progress: Report | None,
    ) -> Iterator[OmniImage]:
        """Yield the images of a moment, captured from a source in place of the renderer's own."""
        sampled = options.sampled(modes)
        alone = []
        for camera, pose in shots:
            alone.append(replace(self.plan(camera, pose, options), modes=sampled).by_rays())
        plans = share_captures(alone, sampled)
        if only is not None:
            plans = [plan for i, plan in enumerate(plans) if i in only]
        captured = source
        once = partial(self._once, _development(options))
        source = self._developed(source, options)

        def another(source: Source, camera: Camera, pose: Pose, modes: tuple[str, ...]) -> OmniImage:
            """Render an image for a check: from the renderer's source, or from one without an object."""
            renderer = self.of(captured if source is self.source else source)
            plain = replace(options, checks="none", sky=(), accuracy=None)
            (image,) = renderer._rendered(renderer.source, [(camera, pose)], modes, plain, None, None)
            return image

        needed: Counter[Request] = Counter()
        for plan in plans:
            needed.update(plan.requests.keys())
        adapts = _adapt_together(plans)
        if needed or adapts:
            source = HeldCaptures(source, needed, all_=adapts)
        meter = Meter(len(plans), progress)
        for plan in plans:
            sampler_of = partial(self._sampler_of, plan.rays)
            image, sky = Composing(plan, source, sampler_of, once, meter.part()).compose()
            self._cache.trim()
            examined = options.checks == "light" or options.sky
            yield examine(image, sky, self.source, another) if examined else image

    def _developed(self, source: Source, options: RenderOptions) -> Source:
        """Return where captures come from as options have them developed; of a recording some are held."""
        developed = develop(source, options)
        development = _development(options)
        if self._recorded is None or source is not self.source:
            return developed
        held = self._held
        if held is None or held[0] != development:
            self._held = held = development, HeldCaptures(developed, most_bytes=self._captures_bytes)
        return held[1]

    def _once(
        self, development: Hashable, name: Hashable, captures: Sequence[Capture], make: Callable[[], T]
    ) -> T:
        """Return what is made of captures; of a recording's it is kept as :meth:`ByteCache.get` says."""
        if self._recorded is None:
            return make()
        key = (development, name, *(capture.request for capture in captures))
        return self._cache.get(key, make, keep_at_once=False)

    @cached_property
    def _recorded(self) -> RecordedViews | None:
        return self.source.recorded()

    def _sampler_of(
        self, image: ImageRays, rays: Blocks, R_w_d: Array, views: tuple[View, ...], whole: bool
    ) -> Sampler:
        """Return a sampler; it is kept, for any centre, if it serves a whole image whose rays are kept."""
        if not whole or not image.kept:
            return self._sampler(rays, R_w_d, views)
        turned = tuple(view.key()._replace(position=()) for view in views)
        key = ("sampler", image.camera, R_w_d.tobytes(), turned)
        return self._cache.get(key, lambda: self._sampler(rays, R_w_d, views), keep_at_once=False)


def _development(options: RenderOptions) -> Hashable:
    """Return what captures with the same requests are told apart by."""
    return options.seams, options.straighten, options.sky, options.seams != "keep" and options.truth_scale


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
        camera, pose, modes: as :meth:`Renderer.render`.
        source: where captures come from.
        progress: called with the image's progress after each viewpoint.
        options: the fields of :class:`omniscv.RenderOptions`.

    Raises:
        OmniscvError: as :meth:`Renderer.render`.
    """
    return Renderer(source).render(camera, pose, modes, options_of(options), progress=progress)


def options_of(keywords: RenderKeywords) -> RenderOptions:
    """Return options from keyword arguments; raise ArgumentError for unknown ones."""
    known = [field.name for field in fields(RenderOptions)]
    if unknown := sorted(set(keywords) - set(known)):
        near = did_you_mean(unknown[0], known)
        raise ArgumentError(f"options: expected some of {', '.join(known)}; got {', '.join(unknown)}{near}")
    return RenderOptions(**keywords)


def render_rig(
    rig: Rig,
    pose: Pose | Trajectory,
    source: Source,
    modes: Sequence[str] = ("lit",),
    *,
    time: float | None = None,
    progress: Report | None = None,
    **options: Unpack[RenderKeywords],
) -> dict[str, OmniImage]:
    """Compose the images of all cameras of a rig; captures that several of them need are made once.

    Args:
        rig: the cameras.
        pose: of the rig, world frame; or its timed poses, along which time offsets move the cameras.
        source: where captures come from.
        modes: modalities of :mod:`omniscv.modalities`.
        time: the rig's, seconds, where poses are timed.
        progress: called with the images' progress after each viewpoint.
        options: the fields of :class:`omniscv.RenderOptions`.

    Returns:
        The images by the cameras' names.

    Raises:
        OmniscvError: as :func:`omniscv.render` and :meth:`Rig.poses`.
    """
    if not isinstance(rig, Rig):
        raise ArgumentError(f"rig: expected a Rig, got {shown(rig)}")
    time_ns = None if time is None else nanoseconds(number("time", time))
    poses = rig.poses(pose, time_ns)
    shots = []
    for name, mounted in rig.cameras.items():
        camera = mounted.camera
        if isinstance(pose, Trajectory) and time_ns is not None:
            camera = on_path(camera, pose, time_ns + nanoseconds(mounted.time_offset), mounted.pose)
        shots.append((camera, poses[name]))
    images = Renderer(source).render_together(shots, modes, options_of(options), progress=progress)
    return dict(zip(rig.cameras, images, strict=True))


def _adapt_together(plans: Sequence[Plan]) -> bool:
    """Return whether images at one position capture what they need as they see it: they may need the same."""
    positions = Counter(tuple(plan.pose.position) for plan in plans if plan.doubt_share is not None)
    return any(count > 1 for count in positions.values())
