"""Which samples a process reads, without PyTorch: shares of ranks and workers, whole batches, orders."""

import numpy as np
import pytest

from omniscv.dataset.shares import Share, samples_of, shuffled


def parts(length, ranks, workers, batch_size):
    """By rank, the samples of each of its workers."""
    return [
        [
            list(range(length))[samples_of(length, Share(r, ranks), Share(w, workers), batch_size)]
            for w in range(workers)
        ]
        for r in range(ranks)
    ]


@pytest.mark.parametrize("ranks", range(1, 5))
@pytest.mark.parametrize("workers", range(1, 4))
def test_shares_cover_a_sequence(ranks, workers):
    for length in range(40):
        shares = [share for rank in parts(length, ranks, workers, None) for share in rank]
        assert [i for share in shares for i in share] == list(range(length))
        sizes = [len(share) for share in shares]
        assert max(sizes) - min(sizes) <= 1


@pytest.mark.parametrize("ranks", range(1, 5))
@pytest.mark.parametrize("workers", range(1, 4))
def test_every_rank_has_as_many_whole_batches(ranks, workers):
    for length in range(40):
        for batch_size in (1, 3, 4):
            shares = parts(length, ranks, workers, batch_size)
            read = [i for rank in shares for share in rank for i in share]
            assert len(read) == len(set(read))
            assert all(len(share) % batch_size == 0 for rank in shares for share in rank)
            batches = [sum(len(share) for share in rank) / batch_size for rank in shares]
            assert batches == [length // (batch_size * ranks)] * ranks


def test_orders_differ_by_epoch_and_agree_by_seed():
    shards = [[f"{s}-{k}" for k in range(5)] for s in range(7)]
    every = {(number, key) for number, keys in enumerate(shards) for key in keys}
    orders = []
    for draw in ((0, 0), (0, 0), (0, 1), (1, 0)):
        groups = shuffled(shards, 3, np.random.default_rng(draw))
        assert [len({shard for shard, _ in group}) for group in groups] == [3, 3, 1]
        orders.append([sample for group in groups for sample in group])
        assert set(orders[-1]) == every
        assert len(orders[-1]) == len(every)
    assert orders[0] == orders[1]
    assert orders[0] not in orders[2:]
    assert orders[2] != orders[3]
