"""WebDataset shards, read as a stream of samples.

A process opens a group of shards at a time, by their headers, and reads samples from any place in them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from torch.utils.data import IterableDataset

from omniscv.arguments import flag, one_of, texts, whole_number
from omniscv.errors import ArgumentError
from omniscv.storage import is_url, without_secrets
from omniscv.torch.order import rank_share, shuffled, worker_share
from omniscv.torch.packed import Packed, Shard
from omniscv.torch.samples import LAYERS, Sample, sample_of_frame
from omniscv.torch.workers import Epochs, bound_threads

_MIXED = 8
"""Shards of a group: enough that a batch is of many places, few enough to keep open."""


class ShardDataset(Epochs, IterableDataset[Sample]):
    """The samples of WebDataset shards, as ``omniscv dataset pack --as webdataset`` writes them.

    Each sample comes once an epoch, in one rank and one of its workers. Their shares differ by one sample at
    most. Every file that is read is compared with its checksum.

    Args:
        folder: with ``shards.json`` and the shards that it lists. Batches need images of one size: pack one
            camera a folder.
        layers: what samples have; those of :data:`LAYERS` that are there, if not given.
        split: only shards of this split; of all if empty.
        shuffle: draw the order from seed and epoch; else it is that of the shards.
        seed: of the order; the same in all ranks.
        rank, world_size: of this process; those of ``torch.distributed`` or ``torchrun`` if not given.

    Raises:
        ArgumentError: no shards are there, or an argument is wrong.
        DatasetError: ``shards.json`` is damaged; while samples are read, that a shard is.
    """

    def __init__(
        self,
        folder: str | Path,
        layers: Sequence[str] | None = None,
        *,
        split: str = "",
        shuffle: bool = True,
        seed: int = 0,
        rank: int | None = None,
        world_size: int | None = None,
    ) -> None:
        super().__init__()
        self.shuffle, self.seed = flag("shuffle", shuffle), whole_number("seed", seed, least=0)
        self.layers = None if layers is None else texts("layers", layers)
        self._rank = rank_share(rank, world_size)
        if is_url(folder):
            raise ArgumentError(
                f"folder: expected one on this machine, got {without_secrets(folder)}; copy it"
            )
        self._packed = Packed.read(Path(folder).absolute())
        split_of = {file: file.path.rpartition("-")[0] for file, _ in self._packed.shards}
        if split:
            one_of("split", split, sorted(set(split_of.values())))
        self._shards = [shard for shard in self._packed.shards if split in ("", split_of[shard[0]])]

    def __len__(self) -> int:
        """How many samples this rank reads in an epoch."""
        samples = range(sum(len(keys) for _, keys in self._shards))
        return len(samples[self._rank.of(len(samples))])

    def __iter__(self) -> Iterator[Sample]:
        bound_threads()
        groups = self._groups()
        part = worker_share(self._rank).of(sum(map(len, groups)))
        first = 0
        for group in groups:
            yield from self._read(group[max(part.start - first, 0) : max(part.stop - first, 0)])
            first += len(group)

    def _groups(self) -> list[list[tuple[int, str]]]:
        """The samples of an epoch, (shard, key), in groups of shards that are open together."""
        keys = [keys for _, keys in self._shards]
        if self.shuffle:
            return shuffled(keys, _MIXED, np.random.default_rng((self.seed, self.epoch)))
        return [[(shard, key) for key in each] for shard, each in enumerate(keys)]

    def _read(self, wanted: Sequence[tuple[int, str]]) -> Iterator[Sample]:
        layers = LAYERS if self.layers is None else self.layers
        with ExitStack() as opened:
            folder = Path(opened.enter_context(TemporaryDirectory(prefix="omniscv-")))
            shards: dict[int, Shard] = {}
            for number, key in wanted:
                if number not in shards:
                    shard = Shard(self._packed, self._shards[number][0])
                    shards[number] = opened.enter_context(closing(shard))
                sample = sample_of_frame(shards[number].extract(key, layers, folder), self.layers)
                for path in folder.iterdir():  # pictures are decoded from files
                    path.unlink()
                yield sample
