"""What to render: sources, cameras, poses, modalities, options."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np

from omniscv import modalities
from omniscv.cameras import Camera
from omniscv.cameras.rig import Rig
from omniscv.compose.files import check_format
from omniscv.dataset.recipe import Recipe
from omniscv.dataset.splits import Split
from omniscv.dataset.writer import Shot
from omniscv.geometry import Pose
from omniscv.geometry.trajectory import Trajectory
from omniscv.jobs.rigs import cameras_of, trajectory_of
from omniscv.jobs.sampled_poses import SampledPoses
from omniscv.planning import RenderOptions
from omniscv.sources.base import Source
from omniscv.sources.recording import record
from omniscv.sources.registry import SourceOptions, open_sources


@dataclass(frozen=True)
class Job:
    """What to render; see :mod:`omniscv.jobs.file` for the fields. ``options`` are those of every image.

    ``cameras`` are at the poses themselves; those of a ``rig``, whose poses they then are, join them.
    ``times`` (seconds) and ``places`` are those of the poses, None where they are not known; ``sampling``
    chooses poses in an open source, see :meth:`posed`; ``recipe`` is what a dataset holds beyond images.

    Raises:
        ArgumentError: an unknown mode or image format, or a rig that does not fit the rest.
    """

    source: str | tuple[str, ...]
    cameras: Mapping[str, Camera]
    poses: tuple[Pose, ...]
    out: Path
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

    def __post_init__(self) -> None:
        apart = {name: each for name, each in self.cameras.items() if not self._mounted(name, each)}
        object.__setattr__(self, "cameras", cameras_of(self.rig, apart))
        object.__setattr__(self, "modes", modalities.chosen(self.modes))
        check_format(self.image_format)

    def __len__(self) -> int:
        return len(self.cameras) * len(self.poses)

    @property
    def sources(self) -> tuple[str, ...]:
        """The addresses of its source: several for replicas."""
        return (self.source,) if isinstance(self.source, str) else self.source

    def open(self) -> Source:
        """Open the job's source, recorded where the job has a file for it. The caller closes it."""
        source = open_sources(self.sources, **self.source_options)
        if self.record is None:
            return source
        try:
            return record(source, self.record)
        except BaseException:
            source.close()
            raise

    def posed(self, source: Source) -> Self:
        """Return this job with the poses that it samples in its source.

        Raises:
            OmniscvError: there are no such poses, or depth cannot be captured.
        """
        if self.sampling is None:
            return self
        found = self.sampling.poses(source)
        return replace(self, poses=found.poses, times=found.times, sampling=None)

    def items(self) -> Iterator[tuple[str, Camera, Pose]]:
        """Yield stem, camera and pose of every image, pose by pose."""
        for frame in self.frames():
            yield from frame

    def frames(self) -> Iterator[list[tuple[str, Camera, Pose]]]:
        """Yield stem, camera and pose of the images of each pose, which share captures."""
        for i in range(len(self.poses)):
            yield [(stem, self.cameras[name], pose) for name, stem, pose in self._images(i)]

    def shots(self, scene: str = "") -> Iterator[list[Shot]]:
        """Yield what the frames of a dataset are, those of each pose: image, time, place, split and scene.

        Raises:
            ArgumentError: a camera's name that cannot start a key.
        """
        split = self.recipe.split or Split({"": 1.0})
        places = split.places(np.array([pose.position for pose in self.poses]), self.places or ())
        for i, place in enumerate(places):
            yield [
                Shot(stem, name, self.cameras[name], pose, self._time(i, name), place, split.of(place), scene)
                for name, stem, pose in self._images(i)
            ]

    def _images(self, i: int) -> Iterator[tuple[str, str, Pose]]:
        """The camera's name, the stem and the pose of every image at a pose."""
        digits = len(str(max(0, len(self.poses) - 1)))
        mounted = {} if self.rig is None else self.rig.poses(*self._rig_pose(i))
        for name in self.cameras:
            stem = f"{name}-{i:0{digits}d}" if len(self.poses) > 1 else name
            yield name, stem, mounted.get(name, self.poses[i])

    def _rig_pose(self, i: int) -> tuple[Pose | Trajectory, float | None]:
        """The rig's pose; or its timed poses and this one's time, where time offsets move its cameras."""
        if self._trajectory is None:
            return self.poses[i], None
        return self._trajectory, (self.times or ())[i]

    @cached_property
    def _trajectory(self) -> Trajectory | None:
        return trajectory_of(self.rig, self.poses, self.times)

    def _time(self, i: int, name: str) -> float | None:
        """When a camera takes its image at a pose, seconds."""
        if self.times is None:
            return None
        late = self.rig.cameras[name].time_offset if self.rig and name in self.rig.cameras else 0.0
        return self.times[i] + late

    def _mounted(self, name: str, camera: Camera) -> bool:
        """Whether a camera is one of the rig's already, as in a copy of a job."""
        return self.rig is not None and name in self.rig.cameras and self.rig.cameras[name].camera is camera
