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
        rank: the share of the process in all ranks; ``Share()`` for one alone.
        worker: the share of the process in the workers of its rank; ``Share()`` for one alone.
        batch_size: of each worker's batches. Every rank then has the same number of whole batches, divided
            among its workers, and the remaining samples of the epoch are not read. None: every sample is
            read, and shares differ by at most one sample.
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
    """Return the keys of shards in a random order, (shard, key), in groups.

    Args:
        shards: the keys of each.
        group: the number of shards in a group. Groups are read one after the other.
        random: draws the order of the shards, and the order of the keys in each group.
    """
    order = random.permutation(len(shards)).tolist()
    groups = []
    for first in range(0, len(order), group):
        samples = []
        for shard in order[first : first + group]:
            for key in shards[shard]:
                samples.append((shard, key))
        groups.append([samples[index] for index in random.permutation(len(samples))])
    return groups
