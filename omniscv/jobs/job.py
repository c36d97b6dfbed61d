"""What to render: sources, cameras, poses, modalities, options."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np

from omniscv import modalities, storage
from omniscv.cameras import Camera, RollingShutter
from omniscv.cameras.rig import Rig
from omniscv.compose.files import check_format
from omniscv.dataset.recipe import Recipe
from omniscv.dataset.splits import Split
from omniscv.dataset.writer import Shot
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.instant import Instant
from omniscv.geometry.motion import Motion
from omniscv.geometry.trajectory import Trajectory
from omniscv.jobs.moments import Exposure, Moment, Picture, Take
from omniscv.jobs.motions import check_times
from omniscv.jobs.rigs import cameras_of, trajectory_of
from omniscv.jobs.sampled_poses import SampledPoses
from omniscv.planning import RenderOptions
from omniscv.sources.base import Source, SourceView
from omniscv.sources.recording import record
from omniscv.sources.registry import SourceOptions, open_sources


@dataclass(frozen=True, repr=False)
class Job:
    """What to render; see :mod:`omniscv.jobs.file` for the fields. ``options`` are those of every image.

    ``cameras`` are at the poses themselves; those of a ``rig``, whose poses they then are, join them.
    ``times`` (seconds) and ``places`` are those of the poses, None where they are not known; ``sampling``
    chooses poses in an open source, see :meth:`posed`; ``recipe`` is what a dataset holds beyond images.
    ``out`` is a folder, or the URL of one for a dataset.

    The world moves where ``motions`` (by object) say so, or where its own ``clock`` is at the poses' times.
    Then each image is of the world at its time, of all of the ``exposure``.

    Raises:
        ArgumentError: an unknown mode or image format, a rig that does not fit the rest, or times that are
            missing, or fewer or more than poses.
    """

    source: str | tuple[str, ...]
    cameras: Mapping[str, Camera]
    poses: tuple[Pose, ...]
    out: Path | str
    modes: tuple[str, ...] = ("lit",)
    record: Path | None = None
    options: RenderOptions = field(default_factory=RenderOptions)
    image_format: str = "png"
    source_options: SourceOptions = field(default_factory=SourceOptions)
    times: tuple[float, ...] | None = None
    places: tuple[str, ...] | None = None
    recipe: Recipe = field(default_factory=Recipe)
    rig: Rig | None = None
    sampling: SampledPoses | None = None
    motions: Mapping[str, Motion] = field(default_factory=dict)
    clock: bool = False
    exposure: Exposure = field(default_factory=Exposure)

    def __post_init__(self) -> None:
        apart = {name: each for name, each in self.cameras.items() if not self._mounted(name, each)}
        object.__setattr__(self, "cameras", cameras_of(self.rig, apart))
        object.__setattr__(self, "modes", modalities.chosen(self.modes))
        check_format(self.image_format)
        check_times(self.times, self.motions, self.clock or self.exposure.seconds > 0, self.poses)
        if self.moves:
            self.exposure.check(self.cameras)
        chosen = self.motions or self.exposure.seconds
        if chosen and self.source_options.get("freeze") == "pause":
            wanted = "expected auto, puppet, batch or none for motions and exposures"
            raise ArgumentError(f"freeze: {wanted}, got pause, which leaves objects where they are")
        if self.moves and "poses" not in self.recipe.truth:
            recipe = replace(self.recipe, truth={**self.recipe.truth, "poses": {}})
            object.__setattr__(self, "recipe", recipe)

    def __len__(self) -> int:
        return len(self.cameras) * len(self.poses)

    def __repr__(self) -> str:
        poses = "sampled poses" if self.sampling else f"{len(self.poses)} poses"
        shown = f"{', '.join(self.cameras)} at {poses}, {' '.join(self.modes)}"
        places = " ".join(storage.without_secrets(each) for each in self.sources)
        return f"<Job {shown}, from {places} into {storage.without_secrets(self.out)}>"

    @property
    def sources(self) -> tuple[str, ...]:
        """The addresses of its source: several for replicas."""
        return (self.source,) if isinstance(self.source, str) else self.source

    def open_live(self) -> Source:
        """Open the job's source as it is, without its recording. The caller closes it."""
        return open_sources(self.sources, **self.live_options)

    @property
    def live_options(self) -> SourceOptions:
        """The options that the job's source is opened with.

        A game in which nothing is set is paused where it is, and what moves in it is read.
        """
        options = self.source_options
        if options.get("freeze") in ("auto", "puppet") and not self.moves:
            return {**options, "freeze": "pause"}
        return options

    def open(self, live: Source | None = None) -> Source:
        """Open the job's source, recorded where the job has a file for it. The caller closes it.

        Args:
            live: what :meth:`open_live` returned, which stays open; opened if not given.
        """
        source = self.open_live() if live is None else SourceView(live)
        if self.record is None:
            return source
        try:
            return record(source, self.record)
        except BaseException:
            source.close()
            raise

    @contextmanager
    def opened(self, live: Source | None = None) -> Iterator[tuple[Self, Source]]:
        """Give this job with its poses, and its source; ``live`` as for :meth:`open`.

        A game whose objects the job moves is paused from the first image to the last: all else stands still.
        So is one that is to be frozen for a job without times, whose images are all of one instant.
        """
        frozen = self.source_options.get("freeze", "none") != "none" and not self.clock
        with (
            self.open(live) as source,
            source.at(Instant()) if self.motions or frozen else nullcontext(source) as held,
        ):
            yield self.posed(held), held

    def posed(self, source: Source) -> Self:
        """Return this job with the poses that it samples in its source.

        Raises:
            OmniscvError: there are no such poses, or depth cannot be captured.
        """
        if self.sampling is None:
            return self
        found = self.sampling.poses(source)
        times = found.times if self.times is None else self.times
        return replace(self, poses=found.poses, times=times, sampling=None)

    def items(self) -> Iterator[tuple[str, Camera, Pose]]:
        """Yield stem, camera and pose of every image, pose by pose."""
        for i in range(len(self.poses)):
            for picture in self._pictures(i):
                yield picture.stem, picture.camera, picture.pose

    def moments(self, indices: Iterable[int] | None = None) -> Iterator[Moment]:
        """Yield the images of each pose that are of one instant, and what is captured for them.

        Images of a rolling-shutter camera in a world that moves are moments of their own.

        Args:
            indices: of poses; all if not given.
        """
        for i in range(len(self.poses)) if indices is None else indices:
            groups: dict[str, list[Picture]] = {}
            for picture in self._pictures(i):
                alone = self.moves and isinstance(picture.camera, RollingShutter)
                key = picture.stem if alone else f".{self._instant(picture.time).state}"
                groups.setdefault(key, []).append(picture)
            for group in groups.values():
                yield Moment(i, tuple(group), tuple(self._takes(i, group)))

    def shots(
        self, scene: str = "", indices: Iterable[int] | None = None
    ) -> Iterator[tuple[Moment, list[Shot]]]:
        """Yield moments with what the frames of a dataset are: image, time, place, split and scene.

        Args:
            scene: the identity of the source's scene.
            indices: of poses; all if not given.

        Raises:
            ArgumentError: a camera's name that cannot start a key.
        """
        split = self.recipe.split or Split({"": 1.0})
        for moment in self.moments(indices):
            place, instant = self._places[moment.index], moment.instant
            yield (
                moment,
                [
                    Shot(stem, name, camera, pose, time, place, split.of(place), scene, instant)
                    for name, stem, camera, pose, time in moment.pictures
                ],
            )

    @property
    def moves(self) -> bool:
        """Whether images are of the world at their times."""
        return self.clock or bool(self.motions)

    def _instant(self, time: float | None, late: float = 0.0) -> Instant:
        """The instant of a time, or some seconds later."""
        if not self.moves:
            return Instant()
        at = None if time is None else time + late
        return Instant({name: motion.at(at) for name, motion in self.motions.items()}, time=at)

    def _takes(self, i: int, pictures: Sequence[Picture]) -> Iterator[Take]:
        """What is captured for images of one instant: that of their time first."""
        (_, _, camera, pose, time), *_ = pictures
        if self.moves and isinstance(camera, RollingShutter):
            for seconds, lines in self.exposure.lines(camera):
                yield Take(self._instant(time, seconds), ((lines, pose),), self.modes)
            return
        yield Take(self._instant(time), tuple((each.camera, each.pose) for each in pictures), self.modes)
        stems = {picture.stem for picture in pictures}
        for offset in self.exposure.offsets()[1:] if "lit" in self.modes else ():
            moved = self._pictures(i, offset if self.exposure.camera == "moves" else 0.0)
            shots = tuple((each.camera, each.pose) for each in moved if each.stem in stems)
            yield Take(self._instant(time, offset), shots, ("lit",))

    def _pictures(self, i: int, late: float = 0.0) -> Iterator[Picture]:
        """The images at a pose; or, some seconds later, along the poses as along a trajectory."""
        digits = len(str(max(0, len(self.poses) - 1)))
        pose, time = self.poses[i], None if self.times is None else self.times[i] + late
        path = self._path
        if path is not None and time is not None and late:
            pose = path.at(time, steps_beyond=1)
        mounted = {} if self.rig is None else self.rig.poses(pose if path is None else path, time)
        for name, camera in self.cameras.items():
            stem = f"{name}-{i:0{digits}d}" if len(self.poses) > 1 else name
            yield Picture(name, stem, camera, mounted.get(name, pose), self._late(name, time))

    @cached_property
    def _places(self) -> tuple[str, ...]:
        """The place of each pose."""
        split = self.recipe.split or Split({"": 1.0})
        return split.places(np.array([pose.position for pose in self.poses]), self.places or ())

    @cached_property
    def _path(self) -> Trajectory | None:
        """The timed poses, where cameras move along them within an image; None elsewhere."""
        moves = self.exposure.seconds > 0 and self.exposure.camera == "moves" and len(self.poses) > 1
        return trajectory_of(self.rig, self.poses, self.times, moves)

    def _late(self, name: str, time: float | None) -> float | None:
        """When a camera takes an image of a time, seconds."""
        if time is None:
            return None
        late = self.rig.cameras[name].time_offset if self.rig and name in self.rig.cameras else 0.0
        return time + late

    def _mounted(self, name: str, camera: Camera) -> bool:
        """Whether a camera is one of the rig's already, as in a copy of a job."""
        return self.rig is not None and name in self.rig.cameras and self.rig.cameras[name].camera is camera
