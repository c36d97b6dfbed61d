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
from omniscv.geometry import Array, Pose
from omniscv.geometry.instant import Instant, Motion
from omniscv.geometry.trajectory import NS, Poses, nanoseconds
from omniscv.job import Exposure, Job, Split
from omniscv.planning import densities
from omniscv.progress import Meter, Report, without_images
from omniscv.sources.base import Color, Source

SURFACE_M = 1.0
"""Assumed distance of surfaces, metres, for how fast they move in the image of a moving camera."""
_NEAREST_M = 0.25  # metres: least distance of an object that moves
_OBJECT_M = 0.5  # metres: assumed from an object's middle to its surface
_DECIMALS = 7  # of metres and entries of rotations in digests
_FEWEST = 3  # instants of an exposure
_MOST = 999  # instants of an exposure
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
    """Yield a job's images pose by pose and instant by instant, and what is captured for them.

    Images of a rolling-shutter camera in a world that moves do not share captures.

    Args:
        job: with its poses.
        indices: of the poses; of all if not given.
        scene: identity of the source's scene, for the frames of a dataset.
    """
    path = JobPath(job)
    split = job.recipe.split or Split({"": 1.0})
    places = places_of(job, split)
    start = f"{job.world}/" if job.world else ""
    split_of = {} if split.by == "world" else split.divide(f"{start}{place}" for place in places)
    for index in range(len(job.poses)) if indices is None else indices:
        groups: dict[str, list[Frame]] = {}
        place = f"{start}{places[index]}"
        in_split = job.world_split or split_of.get(place) or split.of(job.world)
        varied, fault = _varied(job, index, place)
        fault = job.faults.get(index, fault)
        for frame in path.frames(index):
            rolling = job.moves and isinstance(frame.camera, RollingShutter) and frame.camera.readout
            state = path.instant(replace(frame, varied=varied)).state
            key = frame.key if rolling else f".{state}"
            frame = replace(frame, place=place, split=in_split, scene=scene, state=state, varied=varied)
            groups.setdefault(key, []).append(frame)
        for frames in groups.values():
            captured = tuple(path.captured(index, frames))
            shown = []
            for number, frame in enumerate(frames):
                shown.append(replace(frame, shows=_shows(captured, number)))
            yield SharedFrames(tuple(shown), captured, fault)


def _shows(captured: Sequence[InstantViews], number: int) -> str:
    """Return a digest of the instants and poses of which a frame is composed; empty if there is one instant.

    ``number`` is that of the frame among those that share captures.
    """
    if len(captured) == 1:
        return ""
    count = len(captured[0][1])
    parts = []
    for instant, views, _ in captured:
        positions = []
        rotations = []
        for _, pose in views[number::count]:
            positions.append((np.round(pose.position, _DECIMALS) + 0.0).tolist())
            rotations.append((np.round(pose.rotation, _DECIMALS) + 0.0).tolist())
        parts.append((instant.state, positions, rotations))
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:16]


def places_of(job: Job, split: Split) -> Sequence[str]:
    """Return the place of each pose of a ``job``.

    ``split`` finds the places of poses without one, from the positions of all.
    """
    if job.places and all(job.places):
        return job.places
    return split.places(Poses.of(job.poses).positions, job.places or ())


def with_places(job: Job) -> Job:
    """Return a job of one world whose poses, in arrays, have their places: its parts need not find them."""
    if isinstance(job.poses, Poses) and job.places and all(job.places):
        return job
    places = tuple(places_of(job, job.recipe.split or Split({"": 1.0})))
    return replace(job, places=places, poses=Poses.of(job.poses))


def _varied(job: Job, index: int, place: str) -> tuple[Mapping[str, Any], str]:
    """Return what is drawn for a pose, and why it cannot be drawn; all cameras of a pose see one world."""
    if job.draws is None:
        return {}, ""
    keys = {"frame": pose_number(job, index), "place": place, "world": ""}
    try:
        return job.draws.of(keys[job.draws.vary.per]), ""
    except ArgumentError as fault:
        return {}, fault.message


def instants_of(job: Job) -> Iterator[Instant]:
    """Yield what the world shows at each pose of a job; nothing is drawn for its places."""
    path = JobPath(job)
    for index in range(len(job.poses)):
        varied, _ = _varied(job, index, "")
        yield path.instant_at(None if job.times_ns is None else job.times_ns[index], varied)


def keys_of(job: Job, indices: Iterable[int] | None = None, count: int | None = None) -> Iterator[str]:
    """Yield the keys of the frames of a ``job``.

    Args:
        job: that has them.
        indices: of the poses; of all if not given.
        count: of all poses; the job's if not given.
    """
    of_poses = len(job.poses) if count is None else count
    for index in range(of_poses) if indices is None else indices:
        for name in job.cameras:
            yield _key(job, name, index, of_poses)


def check_keys(job: Job) -> None:
    """Raise ArgumentError if two frames of a job's worlds would have one key, in any case of letters."""
    owners: dict[str, str] = {}
    counts = {}
    digits = set()
    for world in job.each:
        count = len(world.poses) or getattr(world.sampling, "count", 1)
        counts[world.world] = count
        digits.add(len(str(count - 1)) if count > 1 else 0)
    for world in job.each:
        count = counts[world.world]
        # Keys whose numbers have as many digits differ if those of the first pose do.
        indices = range(1 if len(digits) == 1 else count)
        for name in world.cameras:
            owner = f"camera {name!r} of world {world.world!r}"
            for index in indices:
                key = file_key(_key(world, name, index, count))
                if owners.setdefault(key, owner) != owner:
                    both = f"that of {owners[key]} and {owner}; rename one"
                    raise ArgumentError(f"{key}: expected a key of one frame, got {both}")


def _key(job: Job, camera: str, index: int, count: int) -> str:
    """Return the key of the frame of a camera at a pose, of a number of poses."""
    key = f"{camera}-{pose_number(job, index, count)}" if count > 1 else camera
    # The cameras that are drawn for a world are named after it.
    return f"{job.world}-{key}" if job.world and not camera.startswith(f"{job.world}-") else key


def pose_number(job: Job, index: int, count: int = 0) -> str:
    """Return the number of the pose at an ``index``, with leading zeros.

    It has as many digits as the last one of ``count`` poses; 0: of all poses of the ``job``.
    """
    last = max(0, (count or len(job.poses)) - 1)
    return str(index).zfill(len(str(last)))


class JobPath:
    """Where each of a job's cameras is, and what the world shows, at any time of an image."""

    def __init__(self, job: Job) -> None:
        self.job = job

    def frames(self, index: int, after: float = 0.0) -> Iterator[Frame]:
        """Yield the images at the pose of an ``index``, or those of ``after`` seconds later."""
        job = self.job
        pose_ns = None if job.times_ns is None else job.times_ns[index]
        mounts = {} if job.rig is None else job.rig.cameras
        for name, camera in job.cameras.items():
            key = _key(job, name, index, len(job.poses))
            mounted = mounts.get(name) or RigCamera(camera)
            time_ns = None if pose_ns is None else pose_ns + nanoseconds(mounted.time_offset + after)
            pose = job.poses[index]
            if job.path is not None and time_ns != pose_ns and time_ns is not None:
                pose = job.path.at(time_ns, steps_beyond=1)
            if name in job.own_poses:
                pose = job.own_poses[name][index]
            elif name in mounts:
                pose = pose @ mounted.pose
            camera = self._on_path(camera, mounted.pose, time_ns)
            yield Frame(key, name, camera, pose, time_ns=time_ns, world=job.world)

    def _on_path(self, camera: Camera, mounted: Pose, time_ns: int | None) -> Camera:
        """Return a camera whose lines are read one after the other as it moves along the path meanwhile."""
        if self.job.path is not None and time_ns is not None:
            return on_path(camera, self.job.path, time_ns, mounted)
        return as_shutter(camera) if self.job.moves and readout_of(camera) else camera

    def instant(self, frame: Frame, after: float = 0.0) -> Instant:
        """Return the instant that a ``frame`` shows, or that of ``after`` seconds later."""
        time_ns = None if frame.time_ns is None else frame.time_ns + nanoseconds(after)
        return self.instant_at(time_ns, frame.varied)

    def instant_at(self, time_ns: int | None, varied: Mapping[str, Any]) -> Instant:
        """Return the instant of ``time_ns``, None for no time, with what is ``varied`` for it."""
        if not self.job.moves:
            return Instant.drawn(varied)
        poses = {}
        for name, motion in self.job.motions.items():
            poses[name] = motion.at(time_ns)
        seconds = None if time_ns is None else (time_ns - self.job.clock_start_ns) / NS
        return Instant.drawn(varied, poses, seconds)

    def captured(self, index: int, frames: Sequence[Frame]) -> Iterator[InstantViews]:
        """Yield what is captured for ``frames`` of one instant, at the pose of an ``index``.

        First it is the view of each frame at their time, then those during their exposure. Of a
        rolling-shutter camera, it is the lines at their times.
        """
        first = frames[0]
        exposure = self._exposure(index, frames)
        if self.job.moves and isinstance(first.camera, RollingShutter) and first.camera.readout:
            for seconds, lines in exposure.lines(first.camera):
                yield self.instant(first, seconds), ((lines, first.pose),), self.job.captured
            return
        yield from self._during_exposure(index, frames, exposure)

    def _during_exposure(
        self, index: int, frames: Sequence[Frame], exposure: Exposure
    ) -> Iterator[InstantViews]:
        """Yield what is captured for frames of one instant, each of which is exposed at once."""
        modes = self.job.captured
        keys = {frame.key for frame in frames}
        camera_moves = exposure.camera == "moves" and self.job.path is not None
        is_blurred = "lit" in modes and (camera_moves or self.job.moves)
        for offset in exposure.offsets() if is_blurred else (0.0,):
            moved = frames
            if offset and camera_moves:
                moved = [frame for frame in self.frames(index, offset) if frame.key in keys]
            views = tuple((frame.camera, frame.pose) for frame in moved)
            instant = self.instant(frames[0], offset)
            yield instant, views, ("lit",) if offset else modes
            yield from self._lateral(instant, views)

    def _exposure(self, index: int, frames: Sequence[Frame]) -> Exposure:
        """Return the job's exposure with a number of instants: enough for the fastest motion in any image."""
        exposure = self.job.exposure
        if exposure.instants != "auto":
            return exposure
        most = 0.0
        motions = (*self.job.motions.values(), *self.job.own_motions.values())
        for frame in frames:
            readout = frame.camera.readout if isinstance(frame.camera, RollingShutter) else 0.0
            start = 0.0 if readout else -exposure.seconds / 2
            end = readout or exposure.seconds / 2
            camera_moves = exposure.camera == "moves" and not readout
            first = self._pose_of(frame, index, start if camera_moves else 0.0)
            last = self._pose_of(frame, index, end if camera_moves else 0.0)
            time_ns = frame.time_ns or 0
            span = time_ns + nanoseconds(start), time_ns + nanoseconds(end)
            most = max(most, motion_px(frame.camera, (first, last), motions, span))
        return replace(exposure, instants=instants_for(most))

    def _pose_of(self, frame: Frame, index: int, after: float) -> Pose:
        """Return the pose of a frame's camera some seconds after the pose of an index."""
        poses = {other.key: other.pose for other in self.frames(index, after)}
        return poses[frame.key]

    def _lateral(self, instant: Instant, views: Views) -> Iterator[InstantViews]:
        """Yield what lateral colour needs beside views: red light of all of them, then blue light of all."""
        if self.job.sensor is None:
            return
        red_views = []
        blue_views = []
        for camera, pose in views:
            if cameras := self.job.sensor.lateral_cameras(camera):
                red, blue = cameras
                red_views.append((red, pose))
                blue_views.append((blue, pose))
        if red_views:
            yield instant, (*red_views, *blue_views), ("lit",)


@contextmanager
def renderer_at(renderer: Renderer, instant: Instant) -> Iterator[Renderer]:
    """A renderer of the world at an ``instant``; ``renderer`` itself is not used meanwhile."""
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
        shared: the frames.
        job: whose options and sensor make the images.
        only: indices of the frames that are composed; all if not given.
        progress: called as images progress.
        look: called once, with a source of the world at the frames' instant.

    Raises:
        ArgumentError: the frames cannot be made, as their ``fault`` says.
    """
    if shared.fault:
        raise ArgumentError(shared.fault)
    count = len(shared.frames)
    last = len(shared.captured) - 1
    chosen = sorted(range(count) if only is None else only)
    meter = Meter(len(chosen), progress)

    parts: list[list[OmniImage]] = []
    for number, (instant, views, modes) in enumerate(shared.captured):
        report = meter.part() if number == last else without_images(meter.part())
        with renderer_at(renderer, instant) as renderer_then:
            if look and number == 0:
                look(renderer_then.source)
            wanted = [index for index in range(len(views)) if index % count in chosen]
            images = renderer_then.render_together(views, modes, job.options, only=wanted, progress=report)
            if last == 0:
                for index, image in zip(chosen, images, strict=True):
                    yield _sensed(job, shared.frames[index], image)
                return
            parts.append(list(images))
    for position, index in enumerate(chosen):
        yield _merged(job, shared.frames[index], [images[position :: len(chosen)] for images in parts])


def _merged(job: Job, frame: Frame, parts: Sequence[Sequence[OmniImage]]) -> OmniImage:
    """Return the image of a frame, of its images at several instants.

    Each of ``parts`` is one image of an instant, or two of lateral colour, red and blue.
    """
    instants = []
    reds = []
    blues = []
    for images in parts:
        if len(images) == 1:
            instants.append(images[0])
        elif len(images) == 2:
            reds.append(images[0])
            blues.append(images[1])
    is_rolling = job.moves and readout_of(frame.camera)
    image = _read_out(as_shutter(frame.camera), instants) if is_rolling else _exposed(instants)
    lateral = [_exposed(reds), _exposed(blues)] if reds else []
    return _sensed(job, frame, image, lateral)


def _sensed(job: Job, frame: Frame, image: OmniImage, lateral: Sequence[OmniImage] = ()) -> OmniImage:
    """Return an image as the job's sensor shows it, with ``lit`` only if the job wants it."""
    if job.sensor is None:
        return image
    image = job.sensor.apply(image, frame.camera_name, frame.time, lateral)
    layers = dict(image.layers)
    if "lit" not in job.modes:
        layers.pop("lit", None)
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
    layers = {}
    for name in parts[0].layers:
        layers[name] = _chosen(shown, _layer(parts, name))
    valid = _chosen(shown, [part.valid for part in parts])
    if "labels" in layers and "label_edge" in layers:
        differs = _chosen(other, _layer(parts, "labels")) != layers["labels"]
        layers["label_edge"] |= cv2.dilate(differs.view(np.uint8), _NEIGHBOURS).view(np.bool_) & valid
    if "depth_error" in layers:
        with np.errstate(invalid="ignore"):
            moved = np.abs(_chosen(other, _layer(parts, "depth")) - layers["depth"])
        layers["depth_error"] += np.where(np.isnan(moved), 0, moved) * valid  # of +inf twice: no surface
    centers_w = []
    unknown = Counter[Color]()
    for part in parts:
        centers_w.append(np.broadcast_to(part.centers_w, (*valid.shape, 3)))
        unknown += Counter(part.unknown_colors)
    return replace(
        parts[0],
        camera=camera,
        valid=valid,
        layers=layers,
        centers_w=_chosen(shown, centers_w),
        unknown_colors=dict(unknown),
    )


def _layer(parts: Sequence[OmniImage], name: str) -> list[NDArray[Any]]:
    """Return a layer of each of several images."""
    return [part[name] for part in parts]


def _chosen(index: NDArray[Any], arrays: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Return, for each pixel of an index (H, W), that pixel of one of several arrays (H, W, ...)."""
    chosen = np.zeros_like(arrays[0])
    for number, array in enumerate(arrays):
        chosen[index == number] = array[index == number]
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
    """Return how far the camera, and objects, move in an image from a start to an end, px.

    Pixels are taken to be as wide as in the image's middle.

    Args:
        camera: of the image.
        poses: of the camera at the start and at the end, world frame.
        motions: of objects.
        times_ns: of the start and of the end.
    """
    start, end = poses
    turned = _angle(start.rotation, end.rotation)
    radians = turned + float(np.linalg.norm(end.position - start.position)) / SURFACE_M
    for motion in motions:
        before = motion.at(times_ns[0])
        after = motion.at(times_ns[1])
        moved = float(np.linalg.norm(after.position - before.position))
        moved += _OBJECT_M * _angle(before.rotation, after.rotation)
        away_before = float(np.linalg.norm(before.position - start.position))
        away_after = float(np.linalg.norm(after.position - start.position))
        away = min(away_before, away_after)
        radians = max(radians, turned + moved / max(away - _OBJECT_M, _NEAREST_M))
    return radians * densities.pixels_per_radian(camera)


def _angle(R_w_a: Array, R_w_b: Array) -> float:
    """Return the angle between two rotations, radians: acos((trace(R_w_a^T R_w_b) - 1) / 2)."""
    return math.acos(min(1.0, max(-1.0, (float(np.trace(R_w_a.T @ R_w_b)) - 1) / 2)))
