"""The source of a job: opened, recorded, and searched for free space where poses are sampled."""

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, nullcontext
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv.arguments import number, numbers, shown
from omniscv.cameras import Camera, create
from omniscv.cameras.rolling_shutter import readout_of
from omniscv.compose.renderer import Renderer
from omniscv.dataset.origin import digest, world_difference
from omniscv.errors import ArgumentError
from omniscv.frame.classes import class_rules
from omniscv.geometry import Array, Pose
from omniscv.geometry.instant import Instant, Motion
from omniscv.geometry.scene_geometry import ObjectBox
from omniscv.geometry.trajectory import NS, Poses, Trajectory, nanoseconds
from omniscv.job import Job, within_path
from omniscv.job.sampling import SampledPoses
from omniscv.job.vary import COMMAND, Draws
from omniscv.make.own_cameras import with_own_cameras
from omniscv.planning import RenderOptions
from omniscv.progress import phase
from omniscv.sources.base import Source, SourceView
from omniscv.sources.brackets import bracketed
from omniscv.sources.described import WithOrigin, described, without_delivery
from omniscv.sources.recording import record
from omniscv.sources.recording.files import target_of
from omniscv.sources.recording.store import Store
from omniscv.sources.registry import SourceOptions, open_sources
from omniscv.sources.world import SharedExposure

_WIDTH = 256  # of panoramas of depth, px
_FACE_PX = 128  # of the faces that these are composed of
_NEAREST_LOOKS = 8  # panoramas that are tried for whether a position is visible
MOSTLY_NOTHING = 0.99
"""Share of rays without a surface: a position with more is taken to be a mistake."""
_LOOK_PX = 64  # columns of an image, about, at which its objects are counted


def source_options(job: Job) -> SourceOptions:
    """Return the options that a job's source is opened with.

    A game whose objects the job does not move is paused as it is; objects that move are read.
    """
    freeze = job.freeze
    if freeze in ("auto", "puppet") and not job.moves:
        freeze = "pause"
    return job.source_options if freeze is None else {**job.source_options, "freeze": freeze}


def open_source(job: Job, live: Source | None = None) -> Source:
    """Open the source of a ``job``, recorded if the job has a recording.

    ``live`` is the source without its recording; it is opened if not given.
    """
    source = open_sources(job.sources, **source_options(job)) if live is None else SourceView(live)
    try:
        if job.record is not None:
            origin = captured_of(job, source)
            _check_recorded(job.record, origin)
            source = WithOrigin(source, origin)
        if job.brackets:
            return bracketed(source, job.brackets, job.record)
        return source if job.record is None else record(source, job.record)
    except BaseException:
        source.close()
        raise


def captured_of(job: Job, source: Source) -> dict[str, Any]:
    """Return what the captures of a ``job`` show, as a recording and the record of a dataset have it.

    ``source`` is the open source of the job. If it is a recording, it is what was recorded.
    """
    known = source.recorded_origin or {}
    world = known.get("world") if known else source.world_digest
    options = {**known.get("source_options", {}), **without_delivery(job.source_options)}
    return {
        "source": known.get("source") or described(job.sources),
        "source_options": options,
        "world": world or None,
        "freeze": known.get("freeze") or job.freeze or "",
    }


def _check_recorded(path: Path, origin: Mapping[str, Any]) -> None:
    """Refuse a recording whose captures are of something else."""
    file = target_of(path)
    if not file.is_file() or not file.stat().st_size:
        return
    with closing(Store(path)) as store:
        known = store.origin()
    same = {"freeze": ""}  # captures of an instant are the same, whatever stops the world
    if known is not None and (difference := world_difference({**known, **same}, {**origin, **same})):
        expected = "expected a recording of the same captures"
        raise ArgumentError(f"record: {path}: {expected}; its {difference}; record into another file")


@contextmanager
def opened(job: Job, live: Source | None = None) -> Iterator[tuple[Job, Source]]:
    """A ``job`` with its poses, and its open source; ``live`` as for :func:`open_source`.

    A game whose objects the job moves is paused from the first image to the last. So is a game that is frozen
    for a job without times: all its images show one instant.
    """
    if job.worlds:
        wanted = "expected one world here; 'omniscv dataset make' makes several"
        raise ArgumentError(f"worlds: {wanted}, got {', '.join(world.world for world in job.worlds)}")
    frozen = job.freeze not in (None, "none") and not job.clock
    with phase("opening the source"):
        source = open_source(job, live)
    with (
        source,
        source.at(Instant()) if job.motions or frozen else nullcontext(source) as still,
    ):
        if job.sampling is not None:
            job = _with_sampled_poses(job, job.sampling, still)
        if job.vary is not None and job.vary.rules:
            job = replace(job, draws=draws_of(job, still))
        job = with_own_cameras(job, still)
        if job.exposure.instants == "auto" and job.clock:
            job = replace(job, own_motions=_own_motions(job, still))
        # Of the whole job, so that its parts are exposed alike.
        still.share_exposure(SharedExposure(job.poses[0].position))
        yield job, still


def _with_sampled_poses(job: Job, sampling: SampledPoses, source: Source) -> Job:
    """Return a job with poses that are sampled in its open source."""
    with phase("searching places", getattr(sampling, "count", 0)) as step:
        sampled, faults = _sampled(job, sampling, source, step)
    timed = sampled.later(job.epoch_ns or 0)
    job = replace(
        job,
        poses=sampled.poses,
        times_ns=timed.times_ns if job.times_ns is None else job.times_ns,
        path=timed if timed.times_ns else None,
        sampling=None,
        faults=faults,
        sampled=sampling,
    )
    return within_path(job)


def origin_of(job: Job, source: Source) -> dict[str, Any]:
    """Return what the frames of a job are captured of, as the record of a dataset has it
    (:data:`omniscv.dataset.origin.World`).

    Args:
        job: with its poses and their places, as it was opened.
        source: its open source.
    """
    identity = source.scene_identity
    frozen = {}
    if job.freeze not in (None, "none") and not job.moves:
        for name, pose in source.poses(source.objects().names()).items():
            frozen[name] = pose.to_dict()
    numbers = hashlib.sha256()
    for poses in map(Poses.of, (job.poses, *job.own_poses.values())):
        numbers.update(np.ascontiguousarray(poses.positions).tobytes())
        numbers.update(np.ascontiguousarray(poses.rotations).tobytes())
    described_frames = [numbers.hexdigest(), job.times_ns, job.places, list(job.cameras), job.epoch_ns]
    return {
        **captured_of(job, source),
        "scene": "/".join(part for part in (identity.name, identity.level) if part) or None,
        "frozen": digest(frozen) if frozen else None,
        "sampling": {} if job.sampled is None else {type(job.sampled).__name__: _settings(job.sampled)},
        "poses": {"count": len(job.poses), "digest": digest(described_frames)},
    }


def _settings(sampling: SampledPoses) -> dict[str, Any]:
    """Return how poses are drawn, without their number."""
    settings = asdict(sampling)
    settings.pop("count", None)
    for key, value in settings.items():
        if isinstance(value, np.ndarray):
            settings[key] = value.tolist()
    return settings


def _own_motions(job: Job, source: Source) -> dict[str, Motion]:
    """Return the motions of objects that move by themselves, at the start, middle and end of each image."""
    longest = max(job.exposure.seconds, *map(readout_of, job.cameras.values()))
    poses: dict[str, dict[int, Pose]] = {}
    for time_ns in job.times_ns or ():
        for part in (-0.5, 0.0, 0.5, 1.0):
            at_ns = time_ns + nanoseconds(part * longest)
            own = source.own_poses((at_ns - job.clock_start_ns) / NS)
            if own is None and not job.motions:
                dialect = source.capabilities.dialect or "a source"
                wanted = "expected a number, or a source that tells how its objects move"
                raise ArgumentError(f"exposure.instants: {wanted}, got auto of {dialect} that cannot")
            for name, pose in (own or {}).items():
                poses.setdefault(name, {})[at_ns] = pose
    motions = {}
    for name, pose_at in poses.items():
        times_ns = sorted(pose_at)
        motions[name] = Motion(Trajectory([pose_at[at_ns] for at_ns in times_ns], tuple(times_ns)))
    return motions


def draws_of(job: Job, source: Source) -> Draws:
    """Return the draws of a ``job`` whose ``vary`` is set, in its open ``source``.

    ArgumentError: the source cannot vary something, or an object that is varied has a motion.
    """
    vary = job.vary
    can = source.capabilities
    assert vary is not None
    for kind, rules in vary.rules.items():
        for name, settings in rules.items():
            need = "commands" if COMMAND in settings else kind
            if need not in can.varies:
                wanted = f"expected a source that varies {need}"
                known = " and ".join(sorted(can.varies))
                other = f"{can.dialect or 'one'}, which varies {known or 'nothing'}"
                raise ArgumentError(f"vary.{kind}.{name}: {wanted}, got {other}")
    boxes: Mapping[str, ObjectBox] = {}
    pivots = {}
    if any(settings.get("clearance") for settings in vary.objects.values()):
        boxes = source.geometry().boxes
        for name, pose in source.poses(list(boxes)).items():
            pivots[name] = pose.position
    draws = Draws(vary, job.world, {kind: source.variable(kind) for kind in vary.rules}, boxes, pivots)
    if both := sorted(draws.settings().get("objects", {}).keys() & job.motions.keys()):
        raise ArgumentError(f"vary.objects: expected objects without motions, got {', '.join(both)}")
    return draws


def sample_poses(
    sampling: SampledPoses, source: Source, step: Callable[[int], None] | None = None
) -> Trajectory:
    """Return the poses that ``sampling`` describes, free ones in the open ``source`` if it asks for that.

    ``step`` is called with the number of free positions whenever one is found.
    """
    if sampling.clearance is None or sampling.start is None:
        return sampling.poses()
    return sampling.poses(FreeSpace(source, sampling.start, sampling.clearance, step=step).is_free)


def _sampled(
    job: Job, sampling: SampledPoses, source: Source, step: Callable[[int], None]
) -> tuple[Trajectory, dict[int, str]]:
    """Return the poses of a job, and by index why no pose was found that shows what is to be visible.

    ``step`` is that of :func:`sample_poses`.
    """
    visible = sampling.visible
    if visible is None or sampling.clearance is None or sampling.start is None:
        return sample_poses(sampling, source, step), {}
    labels = _labels_of_class(job, source, visible.name)
    if not labels:
        wanted = f"expected a class of the job's classes that objects have, got {shown(visible.name)}"
        raise ArgumentError(f"poses.visible.class: {wanted}")
    space = FreeSpace(source, sampling.start, sampling.clearance, labels, step)

    def share(pose: Pose) -> float:
        """Return the largest share of an image at a ``pose`` that shows the class."""
        mounted = {} if job.rig is None else job.rig.poses(pose, None)
        shares = []
        for name, camera in job.cameras.items():
            if name not in job.own_cameras:
                shares.append(space.share(camera, mounted.get(name, pose)))
        return max(shares)

    found = sampling.poses(space.is_free, lambda pose: share(pose) >= visible.share)
    wanted = f"expected a pose that shows {visible.share:g} of {visible.name}"
    faults = {}
    for index, pose in enumerate(found.poses):
        actual = share(pose)
        if actual < visible.share:
            faults[index] = f"{wanted}, got {actual:.3g} at the last drawn"
    return found, faults


def _labels_of_class(job: Job, source: Source, class_name: str) -> list[int]:
    """Return the source's labels of the objects of a class of a job; none if the job has no classes."""
    table = source.objects()
    if job.recipe.classes is None:
        return []
    rules = class_rules(job.recipe.classes)
    return [table.label(name) for name in table.names() if rules.class_of(name) == class_name]


class _Look(NamedTuple):
    """A panorama.

    Attributes:
        position_w: (3,) its centre, metres, world frame.
        depth: (H, W) metres along the rays.
        shown: (H, W) whether a pixel shows an object that is to be visible.
    """

    position_w: Array
    depth: NDArray[np.float32]
    shown: NDArray[np.bool_]


class FreeSpace:
    """Finds positions of a scene that are at least a distance away from every surface.

    A position is free if it is visible from a position that is known to be free, and if no surface visible
    from it is nearer than the clearance. So no position inside a solid, below the floor or beyond a wall is
    free. Results depend only on the tested positions and their order. Surfaces narrower than 1/60 of the
    clearance may be missed.

    Args:
        source: of the scene; panoramas of depth are captured from it.
        start: (3,) metres, world frame: a free position.
        clearance: metres, from every surface.
        visible: labels of the objects that :meth:`share` counts.
        step: called with the number of free positions whenever one is found.

    Raises:
        ArgumentError: no position, or no distance > 0.
    """

    def __init__(
        self,
        source: Source,
        start: ArrayLike,
        clearance: float,
        visible: Sequence[int] = (),
        step: Callable[[int], None] | None = None,
    ) -> None:
        self._step = step
        self._modes = ("depth", "object_mask") if visible else ("depth",)
        self._visible = visible
        self.clearance = number("clearance", clearance, above=0)
        self._renderer = Renderer(source)
        self._camera = create("equirectangular", width=_WIDTH, height=_WIDTH // 2)
        self._looks = [self._look(numbers("start", start, (3,)))]
        if np.isinf(self._looks[0].depth).mean() >= MOSTLY_NOTHING:
            wanted = "expected a start, or the middle of the box, where something is seen"
            place = f"{shown(start)} m, where {100 * MOSTLY_NOTHING:g} % of the rays meet nothing"
            scene = ""
            if boxes := [box.corners_w() for box in source.geometry().boxes.values()]:
                low = np.min(boxes, axis=(0, 1)).round(2).tolist()
                high = np.max(boxes, axis=(0, 1)).round(2).tolist()
                scene = f"; the objects lie from {low} to {high}"
            raise ArgumentError(f"poses: {wanted}; got {place}{scene}")

    def is_free(self, position_w: Array) -> bool:
        """Return whether a position (3,), metres, world frame, is free."""
        away = [_distance(look, position_w) for look in self._looks]
        order = np.argsort(away, kind="stable")[:_NEAREST_LOOKS]
        if not any(self._sees(self._looks[number], position_w, away[number]) for number in order):
            return False
        look = self._look(position_w)
        if look.depth.min() < self.clearance:
            return False
        self._looks.append(look)
        if self._step is not None:
            self._step(len(self._looks) - 1)
        return True

    def share(self, camera: Camera, pose: Pose) -> float:
        """Return about which share of an image shows what is to be visible.

        The image is that of a ``camera`` whose ``pose``, in the world frame, is at a free position.
        """
        look = min(self._looks, key=lambda look: _distance(look, pose.position))
        step = max(1, camera.width // _LOOK_PX)
        rays = camera.unproject(camera.pixels()[::step, ::step])
        directions_w = rays.directions[rays.valid] @ pose.R_w_c.T
        column, row = self._camera.project(directions_w @ Pose.from_angles((0, 0, 0)).R_w_c)[0].T.astype(int)
        return float(look.shown[row.clip(max=_WIDTH // 2 - 1), column % _WIDTH].mean())

    def _look(self, position_w: Array) -> _Look:
        """Capture the panorama of a position."""
        options = RenderOptions(face_size=_FACE_PX)
        pose = Pose.from_angles(position_w)
        image = self._renderer.render(self._camera, pose, self._modes, options)
        assert image.depth is not None
        labels = np.zeros_like(image.depth, np.uint16) if image.labels is None else image.labels
        return _Look(position_w, image.depth, np.isin(labels, self._visible))

    def _sees(self, look: _Look, position_w: Array, away: float) -> bool:
        """Return whether the rays to a position and around it are free for ``away`` metres."""
        if away == 0:
            return True
        point_c = Pose.from_angles(look.position_w).to_camera(position_w)
        (u, v), _ = self._camera.project(point_c)
        rows = np.clip(int(v) + np.arange(-1, 2), 0, self._camera.height - 1)
        columns = (int(u) + np.arange(-1, 2)) % self._camera.width
        return bool(look.depth[np.ix_(rows, columns)].min() > away)


def _distance(look: _Look, position_w: Array) -> float:
    """Return the distance of a position from a panorama's centre, metres."""
    return float(np.linalg.norm(position_w - look.position_w))
