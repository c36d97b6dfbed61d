"""Which samples of shards a process reads in an epoch, and in which order."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch.distributed
from torch.utils.data import get_worker_info

from omniscv.arguments import whole_number
from omniscv.errors import ArgumentError


@dataclass(frozen=True)
class Share:
    """One of several equal parts of a sequence."""

    index: int
    count: int

    def of(self, length: int) -> slice:
        """Return the part of a sequence of some length; lengths of parts differ by one at most."""
        return slice(length * self.index // self.count, length * (self.index + 1) // self.count)


def rank_share(rank: int | None, world_size: int | None) -> Share:
    """Return the part of a rank: as given, else that of ``torch.distributed``, else as ``torchrun`` says in
    ``RANK`` and ``WORLD_SIZE``, else all.

    Raises:
        ArgumentError: one without the other, or a rank that is none.
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
    """Return the part of this worker of a rank's loader; the rank's outside of workers."""
    info = get_worker_info()
    if info is None:
        return rank
    return Share(rank.index * info.num_workers + info.id, rank.count * info.num_workers)


def shuffled(
    shards: Sequence[Sequence[str]], mixed: int, random: np.random.Generator
) -> list[list[tuple[int, str]]]:
    """Return the keys of shards in a random order, (shard, key), in groups that are read one after the other.

    Args:
        shards: the keys in each.
        mixed: how many random shards are shuffled together in a group: so many files are open at a time.
        random: decides.
    """
    order = random.permutation(len(shards)).tolist()
    groups = []
    for first in range(0, len(order), mixed):
        keys = [(shard, key) for shard in order[first : first + mixed] for key in shards[shard]]
        groups.append([keys[i] for i in random.permutation(len(keys))])
    return groups
