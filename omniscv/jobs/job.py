"""What to render: sources, cameras, poses, modalities, options."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from omniscv import modalities
from omniscv.cameras import Camera
from omniscv.compose.files import check_format
from omniscv.geometry import Pose
from omniscv.planning import RenderOptions
from omniscv.sources.base import Source
from omniscv.sources.recording import record
from omniscv.sources.registry import SourceOptions, open_sources


@dataclass(frozen=True)
class Job:
    """What to render; see :mod:`omniscv.jobs.file` for the fields. ``options`` are those of every image;
    ``times`` of the poses, seconds, are None where they are not known.

    Raises:
        ArgumentError: an unknown mode or image format.
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

    def __post_init__(self) -> None:
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
        digits = len(str(max(0, len(self.poses) - 1)))
        for i, pose in enumerate(self.poses):
            for name, camera in self.cameras.items():
                yield (f"{name}-{i:0{digits}d}" if len(self.poses) > 1 else name), camera, pose
