"""Group a job's images by instant of the world, and compose each group from one set of captures."""

import hashlib
import json
import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omniscv import light
from omniscv.arguments import file_key
from omniscv.cameras import Camera, RollingShutter
from omniscv.cameras.rig import RigCamera
from omniscv.cameras.rolling_shutter import as_shutter, on_path, readout_of
from omniscv.compose.image import OmniImage
from omniscv.compose.renderer import Renderer
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.geometry import Pose
from omniscv.geometry.instant import Instant, Motion
from omniscv.geometry.trajectory import NS, Poses, nanoseconds
from omniscv.job import Exposure, Job, Split
from omniscv.planning import densities
from omniscv.progress import Meter, Report, without_images
from omniscv.sources.base import Color, Source

SURFACE_M = 1.0
"""Distance at which surfaces are taken to be, for what a moving camera sees of them."""
_NEAREST_M = 0.25  # to an object that moves
_OBJECT_M = 0.5  # from an object's middle to what of it is seen
_DECIMALS = 7  # of metres and entries of rotations in digests
_FEWEST = 3
_MOST = 999
_NEIGHBOURS = np.ones((3, 3), np.uint8)

Views = tuple[tuple[Camera, Pose], ...]
InstantViews = tuple[Instant, Views, tuple[str, ...]]
"""An instant of the world, and the cameras, poses and modes that are captured at it."""


@dataclass(frozen=True)
class SharedFrames:
    """Images of one instant, which share captures.

    Attributes:
        frames: the images, without files.
        captured: what they are composed of; the first instant is that of their ground truth.
        fault: why they cannot be made; empty if nothing is known.
    """

    frames: tuple[Frame, ...]
    captured: tuple[InstantViews, ...]
    fault: str = ""

    @property
    def instant(self) -> Instant:
        """The instant of the images' ground truth."""
        return self.captured[0][0]


def frames_by_instant(
    job: Job, indices: Iterable[int] | None = None, scene: str = ""
) -> Iterator[SharedFrames]:
    """Yield a job's images by pose, of all or of some indices, and instant, and what is captured for them.

    Images of a rolling-shutter camera in a world that moves do not share captures. ``scene`` is the identity
    of the source's scene, for the frames of a dataset.
    """
    path = JobPath(job)
    split = job.recipe.split or Split({"": 1.0})
    places = places_of(job, split)
    start = f"{job.world}/" if job.world else ""
    for i in range(len(job.poses)) if indices is None else indices:
        groups: dict[str, list[Frame]] = {}
        place = f"{start}{places[i]}"
        in_split = job.world_split or split.of(job.world if split.by == "world" else place)
        varied, fault = _varied(job, i, place)
        fault = job.faults.get(i, fault)
        for frame in path.frames(i):
            rolling = job.moves and isinstance(frame.camera, RollingShutter) and frame.camera.readout
            state = path.instant(replace(frame, varied=varied)).state
            key = frame.key if rolling else f".{state}"
            frame = replace(frame, place=place, split=in_split, scene=scene, state=state, varied=varied)
            groups.setdefault(key, []).append(frame)
        for frames in groups.values():
            captured = tuple(path.captured(i, frames))
            shown = tuple(replace(frame, shows=_shows(captured, at)) for at, frame in enumerate(frames))
            yield SharedFrames(shown, captured, fault)


def _shows(captured: Sequence[InstantViews], at: int) -> str:
    """Return a digest of the instants and poses that a frame, the one ``at`` of those that share captures, is
    composed of; empty for one."""
    if len(captured) == 1:
        return ""
    count = len(captured[0][1])
    parts = []
    for instant, views, _ in captured:
        numbers = [(np.round(pose.position, _DECIMALS) + 0.0).tolist() for _, pose in views[at::count]]
        turns = [(np.round(pose.rotation, _DECIMALS) + 0.0).tolist() for _, pose in views[at::count]]
        parts.append((instant.state, numbers, turns))
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:16]


def places_of(job: Job, split: Split) -> Sequence[str]:
    """Return the place of each pose; that of poses without one depends on all others."""
    if job.places and all(job.places):
        return job.places
    return split.places(Poses.of(job.poses).positions, job.places or ())


def with_places(job: Job) -> Job:
    """Return a job of one world whose poses, in arrays, have their places: its parts need not find them."""
    if isinstance(job.poses, Poses) and job.places and all(job.places):
        return job
    places = tuple(places_of(job, job.recipe.split or Split({"": 1.0})))
    return replace(job, places=places, poses=Poses.of(job.poses))


def _varied(job: Job, i: int, place: str) -> tuple[Mapping[str, Any], str]:
    """Return what is drawn for a pose, and why it cannot be drawn; all cameras of a pose see one world."""
    if job.draws is None:
        return {}, ""
    keys = {"frame": pose_number(job, i), "place": place, "world": ""}
    try:
        return job.draws.of(keys[job.draws.vary.per]), ""
    except ArgumentError as fault:
        return {}, fault.message


def instants_of(job: Job) -> Iterator[Instant]:
    """Yield what the world shows at each pose of a job; nothing is drawn for its places."""
    path = JobPath(job)
    for i in range(len(job.poses)):
        varied, _ = _varied(job, i, "")
        yield path.instant_at(None if job.times_ns is None else job.times_ns[i], varied)


def keys_of(job: Job, indices: Iterable[int] | None = None) -> Iterator[str]:
    """Yield the keys of the frames at some poses; at all if not given."""
    for i in range(len(job.poses)) if indices is None else indices:
        yield from (_key(job, name, i, len(job.poses)) for name in job.cameras)


def check_keys(job: Job) -> None:
    """Raise ArgumentError if two frames of a job's worlds would have one key, in any case of letters."""
    owners: dict[str, str] = {}
    counts = {world.world: len(world.poses) or getattr(world.sampling, "count", 1) for world in job.each}
    # Keys whose numbers have as many digits differ if those of the first pose do.
    alike = len({len(str(count - 1)) if count > 1 else 0 for count in counts.values()}) == 1
    for world in job.each:
        count = counts[world.world]
        for name in world.cameras:
            indices = range(1 if alike else count)
            for key in (file_key(_key(world, name, i, count)) for i in indices):
                owner = f"camera {name!r} of world {world.world!r}"
                if owners.setdefault(key, owner) != owner:
                    got = f"that of {owners[key]} and {owner}; rename one"
                    raise ArgumentError(f"{key}: expected a key of one frame, got {got}")


def _key(job: Job, camera: str, i: int, count: int) -> str:
    key = f"{camera}-{pose_number(job, i, count)}" if count > 1 else camera
    # The cameras that are drawn for a world are named after it.
    return f"{job.world}-{key}" if job.world and not camera.startswith(f"{job.world}-") else key


def pose_number(job: Job, i: int, count: int = 0) -> str:
    """Return the number of a pose, with as many digits as the last one of ``count``, or of all, has."""
    return f"{i:0{len(str(max(0, (count or len(job.poses)) - 1)))}d}"


class JobPath:
    """Where each of a job's cameras is, and what the world shows, at any time of an image."""

    def __init__(self, job: Job) -> None:
        self.job = job

    def frames(self, i: int, after: float = 0.0) -> Iterator[Frame]:
        """Yield the images at a pose, or some seconds after it."""
        job = self.job
        pose = self.job.poses[i]
        of_pose_ns = None if job.times_ns is None else job.times_ns[i]
        mounts = {} if job.rig is None else job.rig.cameras
        for name, camera in job.cameras.items():
            key = _key(job, name, i, len(job.poses))
            mounted = mounts.get(name) or RigCamera(camera)
            time_ns = None if of_pose_ns is None else of_pose_ns + nanoseconds(mounted.time_offset + after)
            if job.path is not None and time_ns != of_pose_ns and time_ns is not None:
                pose = job.path.at(time_ns, steps_beyond=1)
            camera = self._on_path(camera, mounted.pose, time_ns)
            if name in job.own_poses:
                camera_pose = job.own_poses[name][i]
            else:
                camera_pose = pose @ mounted.pose if name in mounts else pose
            yield Frame(key, name, camera, camera_pose, time_ns=time_ns, world=job.world)
            pose = job.poses[i]

    def _on_path(self, camera: Camera, mounted: Pose, time_ns: int | None) -> Camera:
        """Return a camera whose lines are read one after the other as it moves along the path meanwhile."""
        if self.job.path is not None and time_ns is not None:
            return on_path(camera, self.job.path, time_ns, mounted)
        return as_shutter(camera) if self.job.moves and readout_of(camera) else camera

    def instant(self, frame: Frame, after: float = 0.0) -> Instant:
        """Return the instant that a frame shows, or one some seconds after it."""
        time_ns = None if frame.time_ns is None else frame.time_ns + nanoseconds(after)
        return self.instant_at(time_ns, frame.varied)

    def instant_at(self, time_ns: int | None, varied: Mapping[str, Any]) -> Instant:
        """Return the instant of a time, with what is drawn for it."""
        if not self.job.moves:
            return Instant.drawn(varied)
        poses = {name: motion.at(time_ns) for name, motion in self.job.motions.items()}
        seconds = None if time_ns is None else (time_ns - self.job.clock_start_ns) / NS
        return Instant.drawn(varied, poses, seconds)

    def captured(self, i: int, frames: Sequence[Frame]) -> Iterator[InstantViews]:
        """Yield what is captured for images of one instant: first at their time, then during their exposure,
        or the lines of a rolling-shutter camera at their times."""
        first = frames[0]
        modes = self.job.captured
        exposure = self._exposure(i, frames)
        if self.job.moves and isinstance(first.camera, RollingShutter) and first.camera.readout:
            for seconds, lines in exposure.lines(first.camera):
                yield self.instant(first, seconds), ((lines, first.pose),), modes
            return
        keys = {frame.key for frame in frames}
        moves = exposure.camera == "moves" and self.job.path is not None
        blurred = "lit" in modes and (moves or self.job.moves)
        for offset in exposure.offsets() if blurred else (0.0,):
            moved = frames
            if offset and moves:
                moved = [frame for frame in self.frames(i, offset) if frame.key in keys]
            views = tuple((frame.camera, frame.pose) for frame in moved)
            instant = self.instant(first, offset)
            yield instant, views, ("lit",) if offset else modes
            yield from self._lateral(instant, views)

    def _exposure(self, i: int, frames: Sequence[Frame]) -> Exposure:
        """Return the job's exposure with a number of instants: enough for the fastest motion in any image."""
        exposure = self.job.exposure
        if exposure.instants != "auto":
            return exposure
        most = 0.0
        motions = (*self.job.motions.values(), *self.job.own_motions.values())
        for frame in frames:
            readout = frame.camera.readout if isinstance(frame.camera, RollingShutter) else 0.0
            start, end = (0.0, readout) if readout else (-exposure.seconds / 2, exposure.seconds / 2)
            moves = exposure.camera == "moves" and not readout
            at = frame.time_ns or 0
            offsets = (start, end) if moves else (0.0, 0.0)
            first, last = (
                {other.key: other.pose for other in self.frames(i, after)}[frame.key] for after in offsets
            )
            span = at + nanoseconds(start), at + nanoseconds(end)
            most = max(most, motion_px(frame.camera, (first, last), motions, span))
        return replace(exposure, instants=instants_for(most))

    def _lateral(self, instant: Instant, views: Views) -> Iterator[InstantViews]:
        """Yield what lateral colour needs beside views: red light of all of them, then blue light of all."""
        sensor = self.job.sensor
        pairs = [sensor.lateral_cameras(camera) for camera, _ in views] if sensor else []
        if any(pairs):
            poses = [pose for _, pose in views]
            reds, blues = zip(*(pair for pair in pairs if pair), strict=True)
            yield instant, tuple(zip((*reds, *blues), poses * 2, strict=True)), ("lit",)


@contextmanager
def renderer_at(renderer: Renderer, instant: Instant) -> Iterator[Renderer]:
    """Give a renderer of the world at an instant; ``renderer`` is not used meanwhile."""
    if not instant.state:
        yield renderer
        return
    with renderer.source.at(instant) as source:
        yield renderer.of(source)


def images_of(
    renderer: Renderer,
    shared: SharedFrames,
    job: Job,
    only: Collection[int] | None = None,
    progress: Report | None = None,
    look: Callable[[Source], object] | None = None,
) -> Iterator[OmniImage]:
    """Yield the images of frames that share captures, in their order.

    Args:
        renderer: of the job's source.
        shared, job: the frames, and the job whose options and sensor make the images.
        only: indices of the frames that are composed; all if not given.
        progress: called as images progress.
        look: called once, with a source of the world at the frames' instant.
    """
    if shared.fault:
        raise ArgumentError(shared.fault)
    last = len(shared.captured) - 1
    count = len(shared.frames)
    chosen = sorted(range(count) if only is None else only)
    meter = Meter(len(chosen), progress)
    parts: list[list[OmniImage]] = []
    for done, (instant, views, modes) in enumerate(shared.captured):
        report = meter.part() if done == last else without_images(meter.part())
        with renderer_at(renderer, instant) as renderer_then:
            if look and done == 0:
                look(renderer_then.source)
            wanted = [i for i in range(len(views)) if i % count in chosen]
            images = renderer_then.render_together(views, modes, job.options, only=wanted, progress=report)
            if last == 0:
                for i, image in zip(chosen, images, strict=True):
                    yield _sensed(job, shared.frames[i], image)
                return
            parts.append(list(images))
    for place, frame in enumerate(shared.frames[i] for i in chosen):
        # An instant has one image of each frame; lateral colour has two, red and blue.
        by_instant = [images[place :: len(chosen)] for images in parts]
        instants = [images[0] for images in by_instant if len(images) == 1]
        red_blue = [images for images in by_instant if len(images) == 2]
        rolls = job.moves and readout_of(frame.camera)
        image = _read_out(as_shutter(frame.camera), instants) if rolls else _exposed(instants)
        yield _sensed(job, frame, image, [_exposed(color) for color in zip(*red_blue, strict=True)])


def _sensed(job: Job, frame: Frame, image: OmniImage, lateral: Sequence[OmniImage] = ()) -> OmniImage:
    """Return an image as the job's sensor shows it, with ``lit`` only if the job wants it."""
    if job.sensor is None:
        return image
    image = job.sensor.apply(image, frame.camera_name, frame.time, lateral)
    layers = {name: layer for name, layer in image.layers.items() if name != "lit" or "lit" in job.modes}
    return replace(image, layers=layers)


def _exposed(parts: Sequence[OmniImage]) -> OmniImage:
    """Return the first of several images, with the mean of their colours: of light where codes say it."""
    lit = [np.asarray(image["lit"]) for image in parts]
    transfer = parts[0].transfer
    if light.known(transfer, lit[0]):
        total = np.zeros(lit[0].shape)
        for colors in lit:
            total += light.decode(colors, transfer)
        shown = light.encode(np.asarray(total / len(lit), np.float32), transfer)
    else:
        mean = np.mean(lit, axis=0, dtype=np.float64)
        shown = (np.rint(mean) if lit[0].dtype == np.uint8 else mean).astype(lit[0].dtype)
    return replace(parts[0], layers={**parts[0].layers, "lit": shown})


def _read_out(camera: RollingShutter, parts: Sequence[OmniImage]) -> OmniImage:
    """Return the image of a rolling-shutter camera, each of whose lines was captured at two instants.

    A line shows the nearer of them. Where the other one differs, its label and its depth may be what the line
    had to show: they are in the marks and in the bound.
    """
    between = camera.parts_read() * (len(parts) - 1)
    shown = np.clip(np.rint(between), 0, len(parts) - 1).astype(int)
    other = np.clip(shown + np.where(between < shown, -1, 1), 0, len(parts) - 1)
    layers = {name: _chosen(shown, [part[name] for part in parts]) for name in parts[0].layers}
    valid = _chosen(shown, [part.valid for part in parts])
    centers_w = [np.broadcast_to(part.centers_w, (*valid.shape, 3)) for part in parts]
    if "labels" in layers and "label_edge" in layers:
        differs = _chosen(other, [part["labels"] for part in parts]) != layers["labels"]
        layers["label_edge"] |= cv2.dilate(differs.view(np.uint8), _NEIGHBOURS).view(np.bool_) & valid
    if "depth_error" in layers:
        with np.errstate(invalid="ignore"):
            moved = np.abs(_chosen(other, [part["depth"] for part in parts]) - layers["depth"])
        layers["depth_error"] += np.where(np.isnan(moved), 0, moved) * valid  # of +inf twice: no surface
    unknown = sum((Counter(part.unknown_colors) for part in parts), Counter[Color]())
    return replace(
        parts[0],
        camera=camera,
        valid=valid,
        layers=layers,
        centers_w=_chosen(shown, centers_w),
        unknown_colors=dict(unknown),
    )


def _chosen(index: NDArray[Any], arrays: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Return, for each pixel of an index (H, W), that pixel of one of several arrays (H, W, ...)."""
    chosen = np.zeros_like(arrays[0])
    for i, array in enumerate(arrays):
        chosen[index == i] = array[index == i]
    return chosen


def instants_for(moved_px: float) -> int:
    """Return how many instants, an odd number, show a motion of so many px without steps.

    The mean of N instants shows an edge that moves by p px as N steps of p / N px. Behind the box of a pixel
    the largest error is p / (8 N^2) of the contrast, for steps of at most 1 px: below 1 / 128, 2 levels of
    255, if N is at least p and 4 sqrt(p). Captures with one sample a pixel have jagged edges, so N is twice
    as many.
    """
    count = math.ceil(2 * max(moved_px, 4 * math.sqrt(moved_px)))
    return min(max(count | 1, _FEWEST), _MOST)


def motion_px(
    camera: Camera, poses: tuple[Pose, Pose], motions: Sequence[Motion], times_ns: tuple[int, int]
) -> float:
    """Return how far the camera, and objects by their motions, move in an image from a start to an end, px,
    where its pixels are as wide as in its middle."""
    start, end = poses
    turned = _angle(start.rotation, end.rotation)
    radians = turned + float(np.linalg.norm(end.position - start.position)) / SURFACE_M
    for motion in motions:
        before, after = (motion.at(time) for time in times_ns)
        moved = float(np.linalg.norm(after.position - before.position))
        moved += _OBJECT_M * _angle(before.rotation, after.rotation)
        away = min(float(np.linalg.norm(pose.position - start.position)) for pose in (before, after))
        radians = max(radians, turned + moved / max(away - _OBJECT_M, _NEAREST_M))
    return radians * densities.pixels_per_radian(camera)


def _angle(one: np.ndarray, other: np.ndarray) -> float:
    """Return the angle between two rotations, radians."""
    return math.acos(min(1.0, max(-1.0, (float(np.trace(one.T @ other)) - 1) / 2)))
