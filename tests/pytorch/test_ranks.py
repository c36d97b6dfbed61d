"""Ranks that wait for each other, as training does: processes under gloo, each with a loader of its own."""

import socket
import time

import pytest
import torch
import torch.multiprocessing
from torch import distributed
from torch.utils.data import DataLoader

import omniscv
from omniscv import dataset
from omniscv.torch import ShardDataset

SAMPLES = 15


@pytest.fixture(scope="module")
def shards(tmp_path_factory):
    folder = tmp_path_factory.mktemp("many")
    camera = omniscv.cameras.create("equirectangular", width=8, height=4)
    with omniscv.open_source("scene://four-wall") as source, dataset.Writer(folder / "own") as writer:
        image = omniscv.render(camera, omniscv.Pose.from_angles((0, 0, 1.5)), source, ("lit",), face_size=8)
        for i in range(SAMPLES):
            writer.add(f"room-{i:02d}", image)
    dataset.export(folder / "own", "webdataset", folder / "shards", max_count=4)
    return folder / "shards"


def train(rank, world, port, folder, workers):
    """Sum something over all ranks at every step; a rank with fewer steps would leave the others waiting."""
    distributed.init_process_group("gloo", f"tcp://127.0.0.1:{port}", rank=rank, world_size=world)
    samples = ShardDataset(folder, ("lit",), batch_size=3)
    loader = DataLoader(samples, batch_size=3, num_workers=workers, persistent_workers=workers > 0)
    for epoch in range(2):
        samples.set_epoch(epoch)
        steps = 0
        for batch in loader:
            total = torch.tensor([len(batch["record"])])
            distributed.all_reduce(total)
            assert int(total) == 3 * world
            steps += 1
        assert steps == SAMPLES // (3 * world)
    distributed.barrier()
    distributed.destroy_process_group()


@pytest.mark.soak
@pytest.mark.parametrize("workers", [0, 3])
@pytest.mark.parametrize("world", [1, 2, 4])
def test_collectives_of_all_ranks_end(world, workers, shards):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    context = torch.multiprocessing.spawn(train, (world, port, shards, workers), nprocs=world, join=False)
    until = time.monotonic() + 240
    while not context.join(timeout=1):  # raises what a process raises
        assert time.monotonic() < until, "a rank waits for others that have no more batches"
