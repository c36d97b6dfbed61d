"""Shards as streams: every sample once an epoch, whatever the ranks and the workers."""

import json
import warnings

import cv2
import numpy as np
import pytest
import torch
import webdataset

from omniscv import dataset
from omniscv.errors import ArgumentError
from omniscv.torch import FolderDataset, ShardDataset
from omniscv.torch.samples import Share, shuffled


def keys(samples):
    return [sample["record"].key for sample in samples]


@pytest.mark.parametrize("camera", ["pano", "lens"])
def test_a_foreign_reader_finds_the_same_samples(camera, folder):
    shards = sorted(map(str, (folder.parent / camera).glob("*.tar")))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # its readers leave tars to the collector
        theirs = {each["__key__"]: each for each in webdataset.WebDataset(shards, shardshuffle=False)}
    ours = {sample["record"].key: sample for sample in ShardDataset(folder.parent / camera)}
    assert set(ours) == set(theirs)
    for key, sample in ours.items():
        for layer in ("lit", "labels", "classes"):
            pixels = cv2.imdecode(np.frombuffer(theirs[key][f"{layer}.png"], np.uint8), cv2.IMREAD_UNCHANGED)
            expected = np.moveaxis(pixels[..., ::-1], -1, 0) if pixels.ndim == 3 else pixels
            np.testing.assert_array_equal(sample[layer].numpy(), expected)
        record, said = sample["record"], json.loads(theirs[key]["json"])
        assert record.camera.to_dict() == said["camera"]
        assert record.pose.to_dict() == said["pose"]
        np.testing.assert_allclose(sample["R_w_c"], said["pose"]["rotation"], atol=1e-7)
        assert record.truth == json.loads(theirs[key]["truth.json"])


def test_shards_and_the_folder_have_the_same_samples(folder):
    alone = {sample["record"].key: sample for sample in FolderDataset(folder, cameras=["lens"])}
    packed = {sample["record"].key: sample for sample in ShardDataset(folder.parent / "lens")}
    assert set(alone) == set(packed) == {"lens-0", "lens-1", "lens-2"}
    for key, sample in alone.items():
        frame = next(each for each in dataset.open(folder) if each.key == key)
        np.testing.assert_array_equal(sample["depth"][0], frame.layer("depth"))
        np.testing.assert_array_equal(np.moveaxis(sample["normals"].numpy(), 0, -1), frame.layer("normals"))
        assert sample.keys() == packed[key].keys()
        for name, value in sample.items():
            assert name == "record" or torch.equal(value, packed[key][name])


def test_layers_that_are_named(folder):
    first = FolderDataset(folder, ("label_edge", "directions"), cameras=["lens"])[0]
    assert set(first) == {"label_edge", "directions", "valid", "position", "R_w_c", "record"}
    assert first["label_edge"].dtype == torch.bool
    rays = first["record"].camera.unproject()
    assert (first["valid"].numpy() == rays.valid).all()
    shown = np.moveaxis(first["directions"].numpy(), 0, -1)
    np.testing.assert_allclose(shown[rays.valid], rays.directions[rays.valid], atol=1e-7)
    with pytest.raises(ArgumentError, match="expected a frame with flow"):
        next(iter(ShardDataset(folder.parent / "lens", ("flow",))))


@pytest.mark.parametrize("world", [1, 2, 3, 5])
def test_each_sample_is_in_one_rank(world, folder):
    parts = [ShardDataset(folder.parent / "pano", rank=r, world_size=world) for r in range(world)]
    found = [keys(part) for part in parts]
    assert sorted(key for part in found for key in part) == ["pano-0", "pano-1", "pano-2"]
    assert [len(part) for part in parts] == [len(part) for part in found]
    assert max(map(len, found)) - min(map(len, found)) <= 1


def test_shares_cover_a_sequence():
    for length in range(12):
        for count in range(1, 8):
            parts = [list(range(length))[Share(i, count).of(length)] for i in range(count)]
            assert [i for part in parts for i in part] == list(range(length))
            assert max(map(len, parts)) - min(map(len, parts)) <= 1


def test_orders_differ_by_epoch_and_agree_by_seed():
    shards = [[f"{s}-{k}" for k in range(5)] for s in range(7)]
    every = {(s, key) for s, held in enumerate(shards) for key in held}
    orders = []
    for draw in ((0, 0), (0, 0), (0, 1), (1, 0)):
        groups = shuffled(shards, 3, np.random.default_rng(draw))
        assert [len({shard for shard, _ in group}) for group in groups] == [3, 3, 1]
        orders.append([each for group in groups for each in group])
        assert set(orders[-1]) == every
        assert len(orders[-1]) == len(every)
    assert orders[0] == orders[1]
    assert orders[0] not in orders[2:]
    assert orders[2] != orders[3]


def test_epochs_and_seeds_of_a_dataset(folder):
    def order(seed, epoch, shuffle=True):
        samples = ShardDataset(folder.parent / "lens", ("lit",), seed=seed, shuffle=shuffle)
        samples.set_epoch(epoch)
        return tuple(keys(samples))

    assert order(3, 1) == order(3, 1)
    assert len({order(0, epoch) for epoch in range(6)}) > 1
    assert len({order(seed, 0) for seed in range(6)}) > 1
    assert order(0, 1, shuffle=False) == order(1, 0, shuffle=False)


def test_the_rank_of_torchrun(folder, monkeypatch):
    monkeypatch.setenv("RANK", "1")
    monkeypatch.setenv("WORLD_SIZE", "2")
    whole = keys(ShardDataset(folder.parent / "pano", rank=0, world_size=1))
    assert keys(ShardDataset(folder.parent / "pano")) == whole[1:]


def test_a_split(folder):
    of = {frame.key: frame.split for frame in dataset.open(folder) if frame.camera_name == "pano"}
    for split in set(of.values()):
        expected = sorted(key for key, its in of.items() if its == split)
        assert sorted(keys(ShardDataset(folder.parent / "pano", split=split))) == expected
        assert keys(FolderDataset(folder, cameras=["pano"], split=split)) == expected
    with pytest.raises(ArgumentError, match="split: expected one of"):
        ShardDataset(folder.parent / "pano", split="test")


def test_wrong_arguments(folder, tmp_path):
    lens = folder.parent / "lens"
    for says, use in (
        (r"it has no shards\.json; write it by 'omniscv dataset pack", lambda: ShardDataset(tmp_path)),
        ("expected both rank and world_size", lambda: ShardDataset(lens, rank=1)),
        ("rank: expected a whole number", lambda: ShardDataset(lens, rank=2, world_size=2)),
        ("epoch: expected", lambda: ShardDataset(lens).set_epoch(-1)),
        ("cameras: expected one of", lambda: FolderDataset(folder, cameras=["pinhole"])),
    ):
        with pytest.raises(ArgumentError, match=says):
            use()
