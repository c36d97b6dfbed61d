"""A job: what to render, as data."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import Literal

from omniscv import modalities, storage
from omniscv.arguments import number, stems, text, texts, whole_number
from omniscv.cameras import Camera, PushBroom, RollingShutter
from omniscv.cameras.rig import Rig
from omniscv.cameras.rolling_shutter import readout_of
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.instant import Motion
from omniscv.geometry.trajectory import SINCE_1970_NS, Trajectory, decimal, nanoseconds
from omniscv.job.own_cameras import OwnCamera, check_own_cameras
from omniscv.job.poses import read_epoch, read_motions, read_poses, read_times
from omniscv.job.readers import (
    read_brackets,
    read_cameras,
    read_recording,
    read_rig,
    read_source,
    read_source_options,
)
from omniscv.job.recipe import Recipe
from omniscv.job.sampling import SampledPoses
from omniscv.job.vary import Draws, Vary
from omniscv.planning import RenderOptions
from omniscv.records import checked, mapping, nested, optional, record, word
from omniscv.sensor import Sensor
from omniscv.sensor.imu import Imu, ImuTrack
from omniscv.sources.registry import SourceOptions
from omniscv.sources.world import Freeze


def _instants(name: str, value: object) -> int | Literal["auto"]:
    if value == "auto":
        return "auto"
    if (count := whole_number(name, value, least=3, most=999)) % 2 == 0:
        raise ArgumentError(f"{name}: expected an odd number, got {count}")
    return count


@record
class Exposure:
    """How long the shutter is open while the world moves, and how finely that is captured.

    The colours of an image are the mean of ``instants``: of light where the source's transfer is known, else
    of codes. All other layers are those of the middle, which is one of the instants. The lines of a
    rolling-shutter camera show as many instants of its read-out, the first and the last line among them.
    """

    seconds: float = checked(number, least=0, default=0.0, help="exposure time, seconds")
    instants: int | Literal["auto"] = checked(
        _instants, default=9, help="averaged instants, an odd number, or auto: as many as the motion needs"
    )
    camera: Literal["moves", "rests"] = word(
        ("moves", "rests"), default="moves", help="moves along timed poses during the exposure, or rests"
    )

    def offsets(self) -> tuple[float, ...]:
        """Return seconds from the middle, that of the middle first."""
        count = self._count() if self.seconds else 1
        offsets = [self.seconds * ((number + 0.5) / count - 0.5) for number in range(count)]
        middle = count // 2
        return (0.0, *offsets[:middle], *offsets[middle + 1 :])

    def lines(self, camera: RollingShutter) -> Iterator[tuple[float, Camera]]:
        """Yield each instant, in seconds after the first line is read, and a ``camera`` of its lines.

        They are read between the instant before and the one after: each line is in two of these cameras.
        """
        last = self._count() - 1
        for index in range(last + 1):
            lines = camera.lines((index - 1) / last, (index + 1) / last)
            yield camera.readout * (index / last), lines

    def _count(self) -> int:
        """The number of instants, once it is chosen."""
        assert self.instants != "auto"
        return self.instants


@record
class FailureLimit:
    """How many frames may fail."""

    skip: float = checked(
        number, least=0, most=1, default=0.0, help="share of frames that may fail, and are left out"
    )


@record(in_files=True, repr=False)
class Job:
    """What to render, and the keys of its file; :mod:`omniscv.make` runs it.

    The world moves if there are ``motions``, or if ``clock`` is set and the source has a clock of its own.
    Then each image shows the world at its time, for the whole ``exposure``. Further keys of the file are the
    fields of :class:`omniscv.RenderOptions` and :class:`omniscv.job.Recipe`.

    Attributes:
        cameras: by name: those of the rig, then those that are at the poses themselves.
        poses: of the cameras, or of the rig; empty while they are to be sampled.
        times_ns: of the poses, whole nanoseconds; None if they are not known.
        epoch_ns: what was added to all times of the file, whole nanoseconds.
        path: of the rig, or of the cameras, which moves them while an image is made; None if they rest.
        own_cameras: the cameras that follow those of the scene itself.
        own_poses: of these, one for each of ``poses``; empty until the source is open.
        own_motions: of objects that move by themselves in the open source, at the times of images.
        imu: what the rig carries, and that path; None without one.
        worlds: a job for each world; this job then has the cameras of all, and otherwise equals the first.
        options: of every image.
        recipe: what a dataset holds beyond images.
        places: of the poses, see :class:`omniscv.job.recipe.Split`; None if they are not known.
        sampling: how poses are chosen in an open source.
        clock: whether images show the world at the times of the poses.
        assumed: of files of poses, in lines; empty for nothing.
        draws: what is drawn anew, with the names of an open source.
        sampled: how the poses were chosen in an open source.
        faults: why poses were not found, by their index.
        world: its name among several; keys of frames start with it.
        world_split: the split of all its frames, in place of that of ``recipe``; empty for none.

    Raises:
        ArgumentError: an unknown mode, a rig that does not fit the rest, or times that are missing, or fewer
            or more than poses.
    """

    source: str | tuple[str, ...] = checked(
        read_source, help="an address, a recording, or a list: replicas of one game"
    )
    poses: Sequence[Pose] = checked(
        read_poses, help="a list of poses, a trajectory file, or random, grid, path"
    )
    cameras: Mapping[str, Camera] = checked(
        read_cameras,
        default_factory=dict,
        help="by name: model and parameters, or a calibration file; of: a camera of the scene",
    )
    out: Path | str = checked(text, default="out", help="folder to write into, or the URL of a dataset")
    modes: tuple[str, ...] = checked(texts, default=("lit",), help="some of lit, object_mask, depth, normals")
    record: Path | None = checked(
        optional(read_recording),
        default=None,
        help="recording whose captures are reused, and that new captures are added to",
    )
    source_options: SourceOptions = checked(
        read_source_options, default_factory=SourceOptions, help="how the source is opened"
    )
    freeze: Freeze | None = word(Freeze, default=None, help="how a live world is held at one instant")
    rig: Rig | None = checked(
        read_rig, default=None, help="cameras that move together, or the name of a rig's file"
    )
    image_format: str = checked(text, default="png", help="file format of lit: png or jpg")
    depth_format: str = checked(
        text, default="exr", help="file format of depth, its bounds and normals: exr, tiff or npy"
    )
    store: str = word(
        ("files", "fast"),
        default="files",
        help="how layers are stored: files (pictures), or fast (arrays of Blosc2, by the extra fast)",
    )
    motions: Mapping[str, Motion] = checked(
        read_motions,
        default_factory=dict,
        help="by object: waypoints, {spline: waypoints}, or a trajectory file",
    )
    times_ns: tuple[int, ...] | None = checked(
        read_times,
        default=None,
        key="times",
        help="seconds: a list, {start, rate, count}, {rate}, or poses for the poses' times",
    )
    epoch_ns: int | None = checked(
        read_epoch,
        default=None,
        key="epoch",
        help="seconds, or nanoseconds, since 1970 that are added to all times [1700000000 with an imu]",
    )
    exposure: Exposure = checked(nested(Exposure), default=Exposure(), help="motion blur")
    brackets: tuple[float, ...] = checked(
        read_brackets, default=(), help="stops of the exposures that are merged to floating-point light"
    )
    sensor: Sensor | None = checked(
        optional(nested(Sensor)), default=None, help="simulated noise and lens effects"
    )
    imu: ImuTrack | None = checked(
        optional(nested(Imu)), default=None, help="an IMU on the rig; cameras then move on a spline"
    )
    vary: Vary | None = checked(
        optional(nested(Vary)), default=None, help="what is drawn for each frame, place or world"
    )
    worlds: tuple[Job, ...] = checked(
        mapping, default=(), help="by name, in place of source: each with a source, poses, split"
    )
    failures: FailureLimit = checked(
        nested(FailureLimit), default=FailureLimit(), help="how many frames of a dataset may fail"
    )
    options: RenderOptions = RenderOptions()
    recipe: Recipe = Recipe()
    path: Trajectory | None = None
    own_cameras: Mapping[str, OwnCamera] = field(default_factory=dict)
    own_poses: Mapping[str, Sequence[Pose]] = field(default_factory=dict)
    own_motions: Mapping[str, Motion] = field(default_factory=dict)
    places: tuple[str, ...] | None = None
    sampling: SampledPoses | None = None
    clock: bool = False
    assumed: str = ""
    draws: Draws | None = None
    sampled: SampledPoses | None = None
    faults: Mapping[int, str] = field(default_factory=dict)
    world: str = ""
    world_split: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "cameras", _with_rig(self.rig, self.cameras))
        object.__setattr__(self, "modes", modalities.chosen(self.modes))
        if self.poses:  # else they are to be sampled
            self._check_times(len(self.poses))
        elif count := getattr(self.sampling, "count", 0):
            self._check_times(count)
        self._check_exposure()
        per_place = self.vary is not None and self.vary.per == "place" and bool(self.vary.rules)
        check_own_cameras(self.own_cameras, self.cameras, self.exposure.seconds, per_place)
        if self.sensor is not None:
            self.sensor.to_dict()  # refuses a file of shading that cannot be read
            for camera in self.cameras.values():
                self.sensor.check(camera)
        if self.moves:
            self._check_rolling_shutters()
        if (self.motions or self.exposure.seconds) and self.freeze == "pause":
            wanted = "expected auto, puppet, batch or none for motions and exposures"
            raise ArgumentError(f"freeze: {wanted}, got pause, which leaves objects where they are")

    def __len__(self) -> int:
        return len(self.cameras) * len(self.poses)

    def __repr__(self) -> str:
        poses = "sampled poses" if self.sampling else f"{len(self.poses)} poses"
        images = f"{', '.join(self.cameras)} at {poses}, {' '.join(self.modes)}"
        sources = " ".join(storage.without_secrets(address) for address in self.sources)
        return f"<Job {images}, from {sources} into {storage.without_secrets(self.out)}>"

    @property
    def sources(self) -> tuple[str, ...]:
        """The addresses of its source: several for replicas."""
        return (self.source,) if isinstance(self.source, str) else self.source

    @property
    def each(self) -> tuple[Job, ...]:
        """The jobs of its worlds; itself if it has one source."""
        return self.worlds or (self,)

    @property
    def captured(self) -> tuple[str, ...]:
        """The modalities that are captured: ``modes``, and ``lit`` for a sensor."""
        return self.modes if self.sensor is None or "lit" in self.modes else ("lit", *self.modes)

    @property
    def moves(self) -> bool:
        """Whether images show the world at their times."""
        return self.clock or bool(self.motions)

    @property
    def clock_start_ns(self) -> int:
        """The time at which the world's clock is 0: the epoch, or the first one, of times since 1970."""
        if self.epoch_ns:
            return self.epoch_ns
        return self.times_ns[0] if self.times_ns and abs(self.times_ns[0]) > SINCE_1970_NS else 0

    @property
    def changes(self) -> bool:
        """Whether images show the world in several states."""
        return self.moves or (self.vary is not None and bool(self.vary.rules))

    def _check_rolling_shutters(self) -> None:
        """Refuse blur and lateral colour of rolling-shutter cameras, in a world that moves."""
        for name, camera in self.cameras.items():
            if not readout_of(camera):
                continue
            if self.sensor is not None and self.sensor.lateral != (0.0, 0.0):
                wanted = "expected none of a rolling-shutter camera in a world that moves"
                raise ArgumentError(f"sensor.lateral: {wanted}, got {list(self.sensor.lateral)}")
            if self.exposure.seconds:
                wanted = "expected 0 for a rolling-shutter camera in a world that moves"
                raise ArgumentError(f"exposure.seconds: {wanted}, got {self.exposure.seconds:g} for {name!r}")

    def _check_exposure(self) -> None:
        """Refuse a camera that would move in two ways, or an exposure of what does not move."""
        for name, camera in self.cameras.items():
            if self.path is not None and isinstance(camera, RollingShutter) and camera.moves_itself:
                wanted = "expected no velocity or path, as the camera moves along its timed poses"
                raise ArgumentError(f"cameras.{name}: {wanted}, got {camera.velocity.tolist()}; leave it out")
            if self.path is None and self.poses and isinstance(camera, PushBroom) and camera.readout:
                wanted = "expected timed poses, along which it moves, or a travel in place of a readout"
                raise ArgumentError(f"cameras.{name}: {wanted}, got poses without a path")
        if self.exposure.seconds and len(self.poses) == 1 and not self.moves:
            wanted = "expected several timed poses, 'times' or 'motions', so that something moves"
            raise ArgumentError(f"exposure.seconds: {wanted}, got one pose in a still world")

    def _check_times(self, poses: int) -> None:
        """Refuse times that do not fit so many poses, the motions or the rig."""
        times = self.times_ns
        if times is None:
            self._check_without_times()
            return
        if len(times) != poses:
            raise ArgumentError(f"times: expected one for each of {poses} poses, got {len(times)}")
        for name, motion in self.motions.items():
            if not motion.span_ns:
                continue
            start, end = motion.span_ns
            if max(times) < start or min(times) > end:
                wanted = f"expected waypoints around the job's times, {self._span(min(times), max(times))}"
                raise ArgumentError(f"motions.{name}: {wanted}, got {self._span(start, end)}")

    def _check_without_times(self) -> None:
        """Refuse what needs the times of poses: motions, a clock, an exposure, and offsets in a rig."""
        has_spans = any(motion.span_ns for motion in self.motions.values())
        if self.clock or self.exposure.seconds > 0 or has_spans:
            wanted = "expected them where something moves"
            raise ArgumentError(f"times: {wanted}, got poses without; give 'times'")
        if self.rig is None:
            return
        for name, mounted in self.rig.cameras.items():
            if mounted.time_offset:  # cameras do not move along such poses
                offset = f"{name}: time_offset {mounted.time_offset:.15g} s, and poses without times"
                raise ArgumentError(f"rig: expected poses with times, such as a trajectory's, got {offset}")

    def _span(self, start_ns: int, end_ns: int) -> str:
        """Return the start and end of a span as the job's file has them, in words."""
        epoch_ns = self.epoch_ns or 0
        return f"{decimal(start_ns - epoch_ns)} to {decimal(end_ns - epoch_ns)} s"


def within_path(job: Job) -> Job:
    """Return a job without the poses whose images its path does not cover from the first line to the last.

    Raises:
        ArgumentError: none is left.
    """
    if job.path is None or job.path.times_ns is None or job.times_ns is None:
        return job
    mounts = {} if job.rig is None else job.rig.cameras
    ends = [0.0]  # of the images of a pose, seconds after its time
    for name, camera in job.cameras.items():
        offset = mounts[name].time_offset if name in mounts else 0.0
        ends += [offset, offset + readout_of(camera)]
    early = nanoseconds(min(ends))
    late = nanoseconds(max(ends))
    first = job.path.times_ns[0] - early
    last = job.path.times_ns[-1] - late
    kept = [index for index, time in enumerate(job.times_ns) if first <= time <= last]
    if len(kept) == len(job.times_ns):
        return job
    span = decimal(late - early)
    if not kept:
        raise ArgumentError(f"poses: expected a path of at least {span} s, as images last, got a shorter one")
    says = f"poses: {len(job.times_ns) - len(kept)} of {len(job.times_ns)} are left out: their images, of "
    says += f"{span} s, would begin before the path or end after it"
    part = slice(kept[0], kept[-1] + 1)
    return replace(
        job,
        poses=job.poses[part],
        times_ns=job.times_ns[part],
        places=job.places[part] if job.places else job.places,
        assumed=f"{job.assumed}\n{says}" if job.assumed else says,
    )


def _with_rig(rig: Rig | None, cameras: Mapping[str, Camera]) -> dict[str, Camera]:
    """Return the cameras of a rig, then the others, of which a copy of a job holds the rig's own, too."""
    of_rig: dict[str, Camera] = {}
    if rig is not None:
        for name, mounted in rig.cameras.items():
            of_rig[name] = mounted.camera
    others = {}
    for name, camera in cameras.items():
        if of_rig.get(name) is not camera:
            others[name] = camera
    if twice := sorted(of_rig.keys() & others.keys()):
        raise ArgumentError(f"cameras: expected names that the rig has not, got {', '.join(twice)}")
    stems("cameras", [*of_rig, *others], dots=True)
    if not of_rig and not others:
        raise ArgumentError("cameras: expected cameras or a rig, got none")
    return {**of_rig, **others}
