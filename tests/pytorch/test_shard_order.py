"""Shards as streams: every sample once an epoch, whatever the ranks and the workers."""

import json
import warnings

import cv2
import numpy as np
import pytest
import torch
import webdataset
from torch.utils.data import DataLoader

import omniscv
from omniscv import dataset, storage
from omniscv.errors import ArgumentError
from omniscv.torch import FolderDataset, ShardDataset


@pytest.fixture(scope="module")
def many(tmp_path_factory):
    """Shards of fifteen samples."""
    folder = tmp_path_factory.mktemp("many")
    camera = omniscv.cameras.create("equirectangular", width=8, height=4)
    with omniscv.open_source("scene://four-wall") as source, dataset.Writer(folder / "own") as writer:
        image = omniscv.render(camera, omniscv.Pose.from_angles((0, 0, 1.5)), source, ("lit",), face_size=8)
        for i in range(15):
            writer.add(f"room-{i:02d}", image)
    dataset.export(folder / "own", "webdataset", folder / "shards", max_count=4)
    return folder / "shards"


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
        record = sample["record"]
        said = json.loads(theirs[key]["json"])
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


def test_epochs_and_seeds_of_a_dataset(folder):
    def order(seed, epoch, shuffle=True):
        samples = ShardDataset(folder.parent / "lens", ("lit",), seed=seed, shuffle=shuffle)
        samples.set_epoch(epoch)
        return tuple(keys(samples))

    assert order(3, 1) == order(3, 1)
    assert len({order(0, epoch) for epoch in range(6)}) > 1
    assert len({order(seed, 0) for seed in range(6)}) > 1
    assert order(0, 1, shuffle=False) == order(1, 0, shuffle=False)


@pytest.mark.filterwarnings("ignore:This DataLoader will create:UserWarning")
@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
@pytest.mark.parametrize("workers", [0, 1, 3])
@pytest.mark.parametrize("world", [1, 2, 3])
def test_ranks_have_as_many_whole_batches(world, workers, many):
    """As collective operations need it, whose ranks wait for each other at every step."""
    steps = []
    seen = set()
    for rank in range(world):
        samples = ShardDataset(many, ("lit",), rank=rank, world_size=world, batch_size=4)
        loader = DataLoader(samples, batch_size=4, num_workers=workers)
        batches = [[record.key for record in batch["record"]] for batch in loader]
        assert len(batches) == len(loader)
        assert {len(batch) for batch in batches} == {4}
        steps.append(len(batches))
        for batch in batches:
            assert not seen & set(batch)
            seen |= set(batch)
    assert steps == [15 // (4 * world)] * world


def test_too_few_samples_for_the_ranks_are_refused(many):
    with pytest.raises(ArgumentError, match="for a batch of 4 in each of 4 ranks, got 15"):
        ShardDataset(many, rank=0, world_size=4, batch_size=4)


def test_a_url_has_the_samples_of_its_folder(folder, tmp_path, monkeypatch):
    monkeypatch.setenv("OMNISCV_CACHE", str(tmp_path))
    url = f"memory://{tmp_path.name}"
    for path in (folder.parent / "pano").iterdir():
        storage.folder(url).put(path.name, path)
    there = {sample["record"].key: sample["lit"] for sample in ShardDataset(url, ("lit",))}
    here = {sample["record"].key: sample["lit"] for sample in ShardDataset(folder.parent / "pano", ("lit",))}
    assert there.keys() == here.keys()
    assert all(torch.equal(there[key], here[key]) for key in here)
    with pytest.raises(ArgumentError, match=r"it has no shards\.json"):
        ShardDataset(f"{url}/none")


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
