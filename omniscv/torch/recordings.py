"""Images that are composed from a recording on access, each with a random camera and orientation."""

from collections.abc import Callable, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from torch.utils.data import Dataset

from omniscv import modalities, storage
from omniscv.arguments import numbers, shown, whole_number
from omniscv.cameras import Camera
from omniscv.compose.cache import ByteCache
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.frame.classes import class_rules
from omniscv.geometry import Array, Pose
from omniscv.records import checked, record
from omniscv.sources.recording.replay import RecordedSource
from omniscv.torch.faces import Faces, Rules
from omniscv.torch.samples import Epochs, Sample, bound_threads, sample_of
from omniscv.torch.sampling import check_central

Draw = Callable[[np.random.Generator], tuple[Camera, Array]]
"""Draws a central camera and (3, 3) ``R_w_c`` from the generator alone; can be pickled for workers."""


def _cameras(name: str, value: Any) -> tuple[Camera, ...]:
    cameras = (value,) if isinstance(value, Camera) else tuple(value)
    if not cameras:
        raise ArgumentError(f"{name}: expected at least one camera, got none")
    for camera in cameras:
        check_central(camera)
    return cameras


def _range(name: str, value: Any) -> tuple[float, float]:
    least, most = numbers(name, value, (2,)).tolist()
    if least > most:
        raise ArgumentError(f"{name}: expected (least, most), got ({least:g}, {most:g})")
    return least, most


@record
class RandomTurns:
    """One of some cameras, and angles from uniform distributions.

    Attributes:
        cameras: central ones, equally likely. Batches need images of one size.
        yaw_deg: least and most, degrees, as of :meth:`omniscv.Pose.from_angles`.
        pitch_deg: least and most, degrees, as of :meth:`omniscv.Pose.from_angles`.
        roll_deg: least and most, degrees, as of :meth:`omniscv.Pose.from_angles`.
    """

    cameras: Sequence[Camera] = checked(_cameras)
    yaw_deg: tuple[float, float] = checked(_range, default=(-180.0, 180.0))
    pitch_deg: tuple[float, float] = checked(_range, default=(0.0, 0.0))
    roll_deg: tuple[float, float] = checked(_range, default=(0.0, 0.0))

    def __call__(self, random: np.random.Generator) -> tuple[Camera, Array]:
        """Return a camera and an orientation (3, 3), camera to world."""
        camera = self.cameras[int(random.integers(len(self.cameras)))]
        yaw_deg = float(random.uniform(*self.yaw_deg))
        pitch_deg = float(random.uniform(*self.pitch_deg))
        roll_deg = float(random.uniform(*self.roll_deg))
        return camera, Pose.from_angles((0, 0, 0), yaw_deg, pitch_deg, roll_deg).R_w_c


class RecordingDataset(Epochs, Dataset[Sample]):
    """Images around the optical centres of a recording, as :class:`Faces` composes them.

    A sample depends on the seed, the epoch and its index alone, not on workers or the order. Each process
    opens the file itself, and keeps the faces of the centres that it used last.

    Args:
        path: of the recording, or its URL; it has six faces at each centre.
        draw: of the camera and the orientation of a sample, such as :class:`RandomTurns`.
        modes: modalities of :mod:`omniscv.modalities`.
        per_center: samples of each centre; those of one follow each other.
        seed: of all draws.
        truth_scale: as of :class:`Faces`.
        classes: as of :class:`Faces`.

    Attributes:
        cache_bytes: most memory of the faces that each process keeps; may be set before the first sample.
        centers: (x, y, z) metres, world frame, in the order of recording.

    Raises:
        ArgumentError: the recording has no six faces of any centre, or an argument is wrong.
        RecordingError: it cannot be read.
    """

    def __init__(
        self,
        path: str | Path,
        draw: Draw,
        modes: Sequence[str] = ("lit",),
        *,
        per_center: int = 1,
        seed: int = 0,
        truth_scale: int = 1,
        classes: Rules | None = None,
    ) -> None:
        super().__init__()
        if not callable(draw):
            raise ArgumentError(f"draw: expected a function of a generator, got {shown(draw)}")
        self.path = Path(storage.fetch_file(path)).absolute()
        self.draw = draw
        self.modes = modalities.chosen(modes)
        self.per_center = whole_number("per_center", per_center)
        self.seed = whole_number("seed", seed, least=0)
        self.truth_scale = truth_scale
        self.cache_bytes = 1 << 30
        self.classes = None if classes is None else class_rules(classes)
        with RecordedSource(self.path) as source:
            self.centers = source.recorded().centers()
        if not self.centers:
            raise ArgumentError(f"{path}: expected six faces around some optical centre; record with 'cube'")

    def __len__(self) -> int:
        return len(self.centers) * self.per_center

    def __getitem__(self, index: int) -> Sample:
        index = range(len(self))[index]
        bound_threads()
        random = np.random.default_rng((self.seed, self.epoch, index))
        camera, R_w_c = self.draw(random)
        center = self.centers[index // self.per_center]
        make = partial(Faces, truth_scale=self.truth_scale, classes=self.classes)
        faces = self._cache.get(center, lambda: make(self._source, center, self.modes))
        self._cache.trim()
        layers = {name: batch[0] for name, batch in faces.render(camera, R_w_c).items()}
        pose = Pose(np.array(center), R_w_c)
        x, y, z = center
        place = f"{x:.3f},{y:.3f},{z:.3f}"
        frame = Frame(f"{self.epoch}-{index}", camera.name, camera, pose, place=place)
        return sample_of(frame, layers)

    def __getstate__(self) -> dict[str, Any]:
        state = dict(vars(self))
        state.pop("_source", None)  # each process opens the file itself
        state.pop("_cache", None)
        return state

    @cached_property
    def _source(self) -> RecordedSource:
        return RecordedSource(self.path)

    @cached_property
    def _cache(self) -> ByteCache:
        return ByteCache(self.cache_bytes)
