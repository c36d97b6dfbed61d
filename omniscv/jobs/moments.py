"""The moments of a job: what is captured of which instants of the world, and the images made of that."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import Reader, fields, number, one_of, whole_number
from omniscv.cameras import Camera, RollingShutter
from omniscv.compose.image import OmniImage
from omniscv.compose.renderer import Renderer
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.instant import Instant
from omniscv.planning import RenderOptions
from omniscv.progress import Meter, Report, without_images
from omniscv.sources.base import Color, Source

_MOST_INSTANTS = 999


@dataclass(frozen=True)
class Exposure:
    """How long the shutter is open while the world moves, and how finely that is captured.

    Attributes:
        seconds: around an image's time. Its colours are the mean of ``instants``, of the values as they are
            captured; all else is that of the middle.
        instants: an odd number, so that the middle is one of them. The lines of a rolling-shutter camera show
            as many instants of its read-out, the first and the last line's among them.
        camera: whether it ``moves`` meanwhile, along its timed poses, or ``rests``.

    Raises:
        ArgumentError: a negative time, an even number, or another word.
    """

    seconds: float = 0.0
    instants: int = 9
    camera: Literal["moves", "rests"] = "moves"

    def __post_init__(self) -> None:
        number("exposure.seconds", self.seconds, least=0)
        whole_number("exposure.instants", self.instants, least=3, most=_MOST_INSTANTS)
        if self.instants % 2 == 0:
            raise ArgumentError(f"exposure.instants: expected an odd number, got {self.instants}")
        one_of("exposure.camera", self.camera, ("moves", "rests"))

    @classmethod
    def read(cls, name: str, value: object) -> Self:
        """Return the exposure that a mapping describes; ArgumentError for all else."""
        kinds: dict[str, Reader] = dict.fromkeys(("seconds", "instants", "camera"), lambda _, given: given)
        return cls(**fields(name, value, kinds))

    def check(self, cameras: Mapping[str, Camera]) -> None:
        """Refuse what cannot be exposed to a world that moves: lines that are read one after the other."""
        rolling = [name for name, each in cameras.items() if isinstance(each, RollingShutter)]
        if rolling and self.seconds:
            wanted = "expected 0 for a rolling-shutter camera in a world that moves"
            raise ArgumentError(f"exposure.seconds: {wanted}, got {self.seconds:g} for {rolling[0]!r}")

    def offsets(self) -> tuple[float, ...]:
        """Return seconds from the middle, that of the middle first."""
        count = self.instants if self.seconds else 1
        found = [self.seconds * ((i + 0.5) / count - 0.5) for i in range(count)]
        middle = count // 2
        return (0.0, *found[:middle], *found[middle + 1 :])

    def lines(self, camera: RollingShutter) -> Iterator[tuple[float, Camera]]:
        """Yield seconds after the first line is read, and a camera of the lines that are read about then."""
        if camera.readout == 0:
            yield 0.0, camera
            return
        step = 1 / (self.instants - 1)
        for i in range(self.instants):
            yield camera.readout * i * step, camera.lines((i - 0.5) * step, (i + 0.5) * step)


class Picture(NamedTuple):
    """An image of a job: its camera's name, the stem of its files, camera, pose and time (seconds)."""

    name: str
    stem: str
    camera: Camera
    pose: Pose
    time: float | None


@dataclass(frozen=True)
class Take:
    """What is captured of one instant.

    Attributes:
        instant: of the world.
        shots: cameras and poses.
        modes: what is captured.
    """

    instant: Instant
    shots: tuple[tuple[Camera, Pose], ...]
    modes: tuple[str, ...]


@dataclass(frozen=True)
class Moment:
    """Images of one instant, which share captures.

    Attributes:
        index: of the pose.
        pictures: the images.
        takes: what they are made of; the first shows the instant that their ground truth is of.
    """

    index: int
    pictures: tuple[Picture, ...]
    takes: tuple[Take, ...]

    @property
    def instant(self) -> Instant:
        """The instant that the images' ground truth is of."""
        return self.takes[0].instant


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
    moment: Moment,
    options: RenderOptions,
    only: Collection[int] | None = None,
    progress: Report | None = None,
    look: Callable[[Source], object] | None = None,
) -> Iterator[OmniImage]:
    """Yield the images of a moment, in their order.

    Args:
        renderer: of the job's source.
        moment: of the job.
        options: how images are captured and composed.
        only: those of the moment's pictures, by index, that are made; all if not given.
        progress: called with how far the images have come.
        look: called once, with a source of the world at the moment's instant.
    """
    takes, meter = moment.takes, Meter(len(moment.pictures) if only is None else len(only), progress)
    parts: list[list[OmniImage]] = []
    for done, take in enumerate(takes):
        part = meter.part() if done + 1 == len(takes) else without_images(meter.part())
        with renderer_at(renderer, take.instant) as there:
            if look and done == 0:
                look(there.source)
            fresh = there.render_together(take.shots, take.modes, options, only=only, progress=part)
            if len(takes) == 1:
                yield from fresh
                return
            parts.append(list(fresh))
    kept = range(len(moment.pictures)) if only is None else sorted(only)
    for i, *mine in zip(kept, *parts, strict=True):
        camera = moment.pictures[i].camera
        yield _read_out(camera, mine) if isinstance(camera, RollingShutter) else _exposed(mine)


def _exposed(parts: Sequence[OmniImage]) -> OmniImage:
    """The first of several images, with the mean of their colours."""
    lit = [np.asarray(image["lit"]) for image in parts]
    mean = np.mean(lit, axis=0, dtype=np.float64)
    rounded = np.rint(mean) if lit[0].dtype == np.uint8 else mean
    return replace(parts[0], layers={**parts[0].layers, "lit": rounded.astype(lit[0].dtype)})


def _read_out(camera: RollingShutter, parts: Sequence[OmniImage]) -> OmniImage:
    """The image of a rolling-shutter camera whose lines were captured in several parts."""
    first = parts[0]
    valid = np.logical_or.reduce([part.valid for part in parts])
    layers: dict[str, NDArray[Any]] = {}
    centers_w = np.zeros((*valid.shape, 3))
    unknown: Counter[Color] = Counter()
    for part in parts:
        mine = part.valid
        centers_w[mine] = np.broadcast_to(part.centers_w, centers_w.shape)[mine]
        unknown.update(part.unknown_colors)
        for name, layer in part.layers.items():
            layers.setdefault(name, np.zeros_like(layer))[mine] = layer[mine]
    return replace(
        first, camera=camera, valid=valid, layers=layers, centers_w=centers_w, unknown_colors=dict(unknown)
    )
