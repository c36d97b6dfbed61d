"""What to render: sources, cameras, poses, modalities, options."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from omniscv import modalities
from omniscv.cameras import Camera
from omniscv.cameras.rig import Rig
from omniscv.compose.files import check_format
from omniscv.geometry import Pose
from omniscv.geometry.trajectory import Trajectory
from omniscv.jobs.rigs import cameras_of, poses_of
from omniscv.planning import RenderOptions
from omniscv.sources.base import Source
from omniscv.sources.recording import record
from omniscv.sources.registry import SourceOptions, open_sources


@dataclass(frozen=True)
class Job:
    """What to render; see :mod:`omniscv.jobs.file` for the fields. ``options`` are those of every image.

    ``times`` of the poses are seconds. ``cameras`` are at the poses themselves, and with a ``rig`` they are
    joined by its cameras.

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
    rig: Rig | None = None
    times: tuple[float, ...] | None = None

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

    def items(self) -> Iterator[tuple[str, Camera, Pose]]:
        """Yield stem, camera and pose of every image, pose by pose."""
        for frame in self.frames():
            yield from frame

    def frames(self) -> Iterator[Sequence[tuple[str, Camera, Pose]]]:
        """Yield the images of each pose: stem, camera and pose of every camera."""
        digits = len(str(max(0, len(self.poses) - 1)))
        trajectory = Trajectory(self.poses, self.times)
        for i, pose in enumerate(self.poses):
            own = poses_of(self.rig, trajectory, i)
            suffix = f"-{i:0{digits}d}" if len(self.poses) > 1 else ""
            yield [(f"{name}{suffix}", each, own.get(name, pose)) for name, each in self.cameras.items()]

    def _mounted(self, name: str, camera: Camera) -> bool:
        """Whether a camera is one of the rig's already, as in a copy of a job."""
        return self.rig is not None and name in self.rig.cameras and self.rig.cameras[name].camera is camera
