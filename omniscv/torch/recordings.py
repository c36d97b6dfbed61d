"""Images that are composed from a recording when they are wanted, each with a draw of its own."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from torch.utils.data import Dataset

from omniscv import modalities, storage
from omniscv.arguments import shown, whole_number
from omniscv.compose.cache import ByteCache
from omniscv.dataset.classes import class_rules
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.planning import RecordedViews
from omniscv.sources.recording.replay import RecordedSource
from omniscv.torch.faces import Faces, Rules
from omniscv.torch.samples import Record, Sample, sample_of
from omniscv.torch.turns import Draw
from omniscv.torch.workers import Epochs, bound_threads

DEFAULT_CACHE_BYTES = 1 << 30


class RecordingDataset(Epochs, Dataset[Sample]):
    """Images around the optical centres of a recording, as :class:`Faces` composes them.

    A sample depends on the seed, the epoch and its index alone, so it is the same whatever the workers and
    the order. Each process opens the file for itself, and keeps the faces of the centres that it used last.

    Args:
        path: the recording, by path or URL; centres are those at which it has six faces.
        draw: gives the camera and the orientation of a sample, such as :class:`RandomTurns`.
        modes: modalities of :mod:`omniscv.modalities`.
        per_center: samples of each centre; those of one follow each other.
        seed: of all draws.
        truth_scale, classes: as :class:`Faces` has them.
        cache_bytes: the bound of what each process keeps.

    Attributes:
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
        cache_bytes: int = DEFAULT_CACHE_BYTES,
    ) -> None:
        super().__init__()
        if not callable(draw):
            raise ArgumentError(f"draw: expected a function of a generator, got {shown(draw)}")
        self.path = Path(storage.fetch_file(path)).absolute()
        self.draw, self.modes = draw, modalities.chosen(modes)
        self.per_center = whole_number("per_center", per_center)
        self.seed = whole_number("seed", seed, least=0)
        self.truth_scale, self._cache_bytes = truth_scale, cache_bytes
        self.classes = None if classes is None else class_rules(classes)
        with RecordedSource(self.path) as source:
            self.centers = RecordedViews(source.recorded_views()).centers()
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
        layers = {name: batch[0] for name, batch in self._faces(center).render(camera, R_w_c).items()}
        pose, place = Pose(np.array(center), R_w_c), ",".join(f"{each:.3f}" for each in center)
        record = Record(f"{self.epoch}-{index}", camera.name, camera, pose, place=place)
        return sample_of(record, layers)

    def _faces(self, center: tuple[float, ...]) -> Faces:
        def made() -> Faces:
            return Faces(self._source, center, self.modes, truth_scale=self.truth_scale, classes=self.classes)

        found = self._kept.get(center, made)
        self._kept.trim()
        return found

    def __getstate__(self) -> dict[str, Any]:
        opened = ("_source", "_kept")
        return {name: value for name, value in vars(self).items() if name not in opened}

    @cached_property
    def _source(self) -> RecordedSource:
        return RecordedSource(self.path)

    @cached_property
    def _kept(self) -> ByteCache:
        return ByteCache(self._cache_bytes)
