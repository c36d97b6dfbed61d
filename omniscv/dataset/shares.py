"""Which samples of an epoch a process reads: its rank's, and of these its worker's; and their order."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Share:
    """One of several equal parts of a sequence."""

    index: int = 0
    count: int = 1

    def of(self, length: int) -> slice:
        """Return the part of a sequence of some length; lengths of parts differ by at most one."""
        return slice(length * self.index // self.count, length * (self.index + 1) // self.count)


def samples_of(length: int, rank: Share, worker: Share, batch_size: int | None = None) -> slice:
    """Return the samples of an epoch that a worker of a rank reads.

    Args:
        length: samples in the epoch.
        rank, worker: of the process; ``Share()`` for one alone.
        batch_size: of each worker's batches. Every rank then has the same number of whole batches, divided
            among its workers, and what is left of the epoch is nobody's. None: every sample is somebody's,
            and shares differ by at most one sample.
    """
    if batch_size is None:
        return Share(rank.index * worker.count + worker.index, rank.count * worker.count).of(length)
    batches = length // (batch_size * rank.count)
    of_worker = worker.of(batches)
    first = rank.index * batches
    return slice((first + of_worker.start) * batch_size, (first + of_worker.stop) * batch_size)


def shuffled(
    shards: Sequence[Sequence[str]], group: int, random: np.random.Generator
) -> list[list[tuple[int, str]]]:
    """Return the keys of shards in a random order, (shard, key), in groups that are read one after the other,
    of so many shards."""
    order = random.permutation(len(shards)).tolist()
    groups = []
    for first in range(0, len(order), group):
        keys = [(shard, key) for shard in order[first : first + group] for key in shards[shard]]
        groups.append([keys[i] for i in random.permutation(len(keys))])
    return groups
