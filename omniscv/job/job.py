"""A job: what to render, as data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from omniscv import modalities, storage
from omniscv.cameras import Camera, RollingShutter
from omniscv.cameras.rig import Rig
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.motion import Motion
from omniscv.job.motions import Exposure, check_times
from omniscv.job.recipe import Recipe
from omniscv.job.sampling import SampledPoses
from omniscv.planning import RenderOptions
from omniscv.sensor import Sensor
from omniscv.sources.registry import SourceOptions


@dataclass(frozen=True, repr=False)
class Job:
    """What to render; :mod:`omniscv.job.file` has the keys of its file. :mod:`omniscv.make` runs it.

    The world moves if there are ``motions``, or if ``clock`` is set and the source has a clock of its own.
    Then each image shows the world at its time, for the whole ``exposure``.

    Attributes:
        source: an address; several for replicas of one game.
        cameras: by name: those of the rig, then those that are at the poses themselves.
        poses: of the cameras, or of the rig; empty while they are to be sampled.
        out: a folder, or for a dataset its URL.
        modes: the modalities of each image.
        record: a recording that captures are taken from and added to.
        options: of every image.
        image_format: of colour.
        store: of layers: ``files`` or ``fast``, see :mod:`omniscv.compose.files`.
        source_options: as :func:`omniscv.open_source`.
        times: of the poses, seconds; None if they are not known.
        places: of the poses, see :class:`omniscv.job.recipe.Split`; None if they are not known.
        recipe: what a dataset holds beyond images.
        rig: cameras that move together; ``poses`` are its poses.
        sampling: how poses are chosen in an open source.
        motions: by object.
        clock: whether images show the world at the times of the poses.
        exposure: of every image.
        assumed: of the file of its poses, in one line; empty for nothing.
        brackets: stops of the exposures that colours are merged from, to light; empty for one exposure.
        sensor: of every image; None for the light alone. An image has ``lit`` only if ``modes`` has it.

    Raises:
        ArgumentError: an unknown mode, a rig that does not fit the rest, or times that are missing, or fewer
            or more than poses.
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
    assumed: str = ""
    sensor: Sensor | None = None
    brackets: tuple[float, ...] = ()
    store: str = "files"

    def __post_init__(self) -> None:
        object.__setattr__(self, "cameras", _with_rig(self.rig, self.cameras))
        object.__setattr__(self, "modes", modalities.chosen(self.modes))
        check_times(self.times, self.motions, self.clock or self.exposure.seconds > 0, self.poses)
        if self.rig is not None and self.times is None and self.poses:  # cameras do not move along them
            for name, mounted in self.rig.cameras.items():
                if mounted.time_offset:
                    got = f"{name}: time_offset {mounted.time_offset:.15g} s, and poses without times"
                    raise ArgumentError(f"rig: expected poses with times, such as a trajectory's, got {got}")
        if self.sensor is not None:
            self.sensor.to_dict()  # refuses a file of shading that cannot be read
            for camera in self.cameras.values():
                self.sensor.check(camera)
            rolling = any(isinstance(camera, RollingShutter) for camera in self.cameras.values())
            if self.moves and rolling and self.sensor.lateral != (0.0, 0.0):
                wanted = "expected none of a rolling-shutter camera in a world that moves"
                raise ArgumentError(f"sensor.lateral: {wanted}, got {list(self.sensor.lateral)}")
        if self.moves:
            self.exposure.check(self.cameras)
        if (self.motions or self.exposure.seconds) and self.source_options.get("freeze") == "pause":
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
    def captured(self) -> tuple[str, ...]:
        """The modalities that are captured: ``modes``, and ``lit`` for a sensor."""
        return self.modes if self.sensor is None or "lit" in self.modes else ("lit", *self.modes)

    @property
    def moves(self) -> bool:
        """Whether images show the world at their times."""
        return self.clock or bool(self.motions)


def _with_rig(rig: Rig | None, cameras: Mapping[str, Camera]) -> dict[str, Camera]:
    """Return the cameras of a rig, then the others.

    Raises:
        ArgumentError: no camera, or a name twice. A camera that is the rig's own, as in a copy of a job, is
            none.
    """
    of_rig = {} if rig is None else {name: mounted.camera for name, mounted in rig.cameras.items()}
    others = {name: camera for name, camera in cameras.items() if of_rig.get(name) is not camera}
    if twice := sorted(of_rig.keys() & others.keys()):
        raise ArgumentError(f"cameras: expected names that the rig has not, got {', '.join(twice)}")
    if not of_rig and not others:
        raise ArgumentError("cameras: expected cameras or a rig, got none")
    return {**of_rig, **others}
