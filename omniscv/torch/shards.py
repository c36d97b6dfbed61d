"""WebDataset shards, read as a stream of samples.

A process opens a group of shards at a time, by the headers of their members, and reads samples from any
position in them.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch.distributed
from torch.utils.data import IterableDataset, get_worker_info

from omniscv.arguments import flag, one_of, texts, whole_number
from omniscv.dataset.formats.webdataset import Shard, read_list
from omniscv.errors import ArgumentError
from omniscv.storage import is_url, without_secrets
from omniscv.torch.samples import LAYERS, Epochs, Sample, bound_threads, sample_of_frame

_GROUP_SHARDS = 8
"""Shards that are shuffled together: a batch has samples of many places, and few files are open."""

_RECORDS = "truth", "layout"
"""Kinds of files that every sample has, beside layers."""


class ShardDataset(Epochs, IterableDataset[Sample]):
    """The samples of WebDataset shards, as ``omniscv dataset pack --as webdataset`` writes them.

    Each sample comes once an epoch, in one rank and one of its workers. Their shares differ by at most one
    sample. Every file that is read is compared with its checksum.

    Args:
        folder: with ``shards.json`` and the shards that it lists. Batches need images of one size: pack one
            camera a folder.
        layers: of the samples; those of :data:`LAYERS` that are there, if not given.
        split: only shards of this split; of all if empty.
        shuffle: draw the order from seed and epoch; else it is that of the shards.
        seed: of the order; the same in all ranks.
        rank, world_size: of this process; those of ``torch.distributed`` or ``torchrun`` if not given.

    Raises:
        ArgumentError: the folder has no shards, or an argument is wrong.
        DatasetError: ``shards.json`` is damaged; while samples are read: a shard is damaged.
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
        self._folder = Path(folder).absolute()
        self._manifest, shards = read_list(self._folder)
        split_of = {file: file.path.rpartition("-")[0] for file in shards}
        if split:
            one_of("split", split, sorted(set(split_of.values())))
        self._shards = [(file, keys) for file, keys in shards.items() if split in ("", split_of[file])]

    def __len__(self) -> int:
        """How many samples this rank reads in an epoch."""
        samples = range(sum(len(keys) for _, keys in self._shards))
        return len(samples[self._rank.of(len(samples))])

    def __iter__(self) -> Iterator[Sample]:
        bound_threads()
        keys = [keys for _, keys in self._shards]
        if self.shuffle:
            groups = shuffled(keys, _GROUP_SHARDS, np.random.default_rng((self.seed, self.epoch)))
        else:
            groups = [[(shard, key) for key in of_shard] for shard, of_shard in enumerate(keys)]
        part = worker_share(self._rank).of(sum(map(len, groups)))
        first = 0
        for group in groups:
            yield from self._read(group[max(part.start - first, 0) : max(part.stop - first, 0)])
            first += len(group)

    def _read(self, samples: Sequence[tuple[int, str]]) -> Iterator[Sample]:
        kinds = (*(LAYERS if self.layers is None else self.layers), *_RECORDS)
        with ExitStack() as stack:
            folder = Path(stack.enter_context(TemporaryDirectory(prefix="omniscv-")))
            shards: dict[int, Shard] = {}
            for number, key in samples:
                if number not in shards:
                    shard = Shard(self._folder, self._shards[number][0], self._manifest)
                    shards[number] = stack.enter_context(closing(shard))
                sample = sample_of_frame(shards[number].extract(key, kinds, folder), self.layers)
                for path in folder.iterdir():  # pictures are decoded from files
                    path.unlink()
                yield sample


@dataclass(frozen=True)
class Share:
    """One of several equal parts of a sequence."""

    index: int
    count: int

    def of(self, length: int) -> slice:
        """Return the part of a sequence of some length; lengths of parts differ by at most one."""
        return slice(length * self.index // self.count, length * (self.index + 1) // self.count)


def rank_share(rank: int | None, world_size: int | None) -> Share:
    """Return the part of a rank: as given, else of ``torch.distributed``, else of ``torchrun``'s ``RANK`` and
    ``WORLD_SIZE``, else all.

    Raises:
        ArgumentError: one without the other, or a rank beyond the world's size.
    """
    if (rank is None) != (world_size is None):
        raise ArgumentError(f"rank: expected both rank and world_size, got {rank} and {world_size}")
    if rank is None or world_size is None:
        if torch.distributed.is_available() and torch.distributed.is_initialized():
            return Share(torch.distributed.get_rank(), torch.distributed.get_world_size())
        rank, world_size = int(os.environ.get("RANK", "0")), int(os.environ.get("WORLD_SIZE", "1"))
    count = whole_number("world_size", world_size)
    return Share(whole_number("rank", rank, least=0, most=count - 1), count)


def worker_share(rank: Share) -> Share:
    """Return the part of this worker of a rank's loader; outside of workers that of the rank."""
    info = get_worker_info()
    if info is None:
        return rank
    return Share(rank.index * info.num_workers + info.id, rank.count * info.num_workers)


def shuffled(
    shards: Sequence[Sequence[str]], group: int, random: np.random.Generator
) -> list[list[tuple[int, str]]]:
    """Return the keys of shards in a random order, (shard, key), in groups that are read one after the other.

    Args:
        shards: the keys of each shard.
        group: number of shards that are shuffled together, and open at a time.
        random: of the order.
    """
    order = random.permutation(len(shards)).tolist()
    groups = []
    for first in range(0, len(order), group):
        keys = [(shard, key) for shard in order[first : first + group] for key in shards[shard]]
        groups.append([keys[i] for i in random.permutation(len(keys))])
    return groups
