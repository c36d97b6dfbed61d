"""Datasets in a ``DataLoader``: the same samples without workers, with forked and with spawned ones."""

import cv2
import numpy as np
import pytest
import torch
from support.datasets import made
from torch.utils.data import ConcatDataset, DataLoader, IterableDataset, get_worker_info

import omniscv
from omniscv import parallel, storage
from omniscv.errors import ArgumentError
from omniscv.torch import FolderDataset, RandomTurns, RecordingDataset, ShardDataset

CAMERA = omniscv.cameras.create("fisheye-equidistant", width=32, height=32, fov_deg=180)
TURNS = RandomTurns((CAMERA,), pitch_deg=(-30, 30), roll_deg=(-10, 10))
MODES = ("lit", "object_mask", "depth")
LAYERS = ("lit", "labels", "depth")


def composed(recording, seed=0):
    return RecordingDataset(recording, TURNS, MODES, per_center=3, seed=seed)


def loaded(samples, **options):
    """The layers of every sample, by its key."""
    found = {}
    for sample in DataLoader(samples, **options):
        assert sample["record"].key not in found
        found[sample["record"].key] = {name: sample[name] for name in LAYERS}
    return found


def same(one, other):
    assert set(one) == set(other)
    for key, layers in one.items():
        assert all(torch.equal(value, other[key][name]) for name, value in layers.items())


class All(IterableDataset):
    """Shards, then each worker's part of what has indices: one loader, because workers take time to start."""

    def __init__(self, shards, maps):
        self.shards = shards
        self.maps = maps

    def __iter__(self):
        yield from self.shards
        info = get_worker_info()
        part = slice(None) if info is None else slice(info.id, None, info.num_workers)
        for i in range(len(self.maps))[part]:
            yield self.maps[i]


def test_arrays_are_loaded_as_pictures_are(folder, tmp_path):
    fast = made(tmp_path, more="truth: {boxes: true}\nstore: fast\n")
    read = [loaded(FolderDataset(out, cameras=["pano"]), batch_size=None) for out in (fast, folder)]
    same(*read)


@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_workers_read_what_one_process_reads(method, recording, folder):
    maps = ConcatDataset([composed(recording), FolderDataset(folder, LAYERS, cameras=["pano"])])
    every = All(ShardDataset(folder.parent / "lens", LAYERS), maps)
    expected = loaded(every, batch_size=None)  # the parent has used the file and OpenCV's threads
    assert len(expected) == 3 + 6 + 3
    same(loaded(every, batch_size=None, num_workers=2, multiprocessing_context=method), expected)


class Threads(torch.utils.data.Dataset):
    """How many threads a worker has once it has read from a dataset."""

    def __init__(self, samples):
        self.samples = samples

    def __len__(self):
        return 2

    def __getitem__(self, index):
        assert len(self.samples[index]) > 0
        return cv2.getNumThreads(), parallel.cores(), torch.get_num_threads()


@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
def test_a_worker_has_one_thread(recording):
    before = cv2.getNumThreads(), parallel.cores()
    loader = DataLoader(Threads(composed(recording)), num_workers=2, batch_size=None)
    assert [tuple(each) for each in loader] == [(1, 1, 1), (1, 1, 1)]
    assert (cv2.getNumThreads(), parallel.cores()) == before


@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
def test_workers_that_persist_see_the_epoch(recording, folder):
    for samples in (composed(recording), ShardDataset(folder.parent / "lens", LAYERS)):
        loader = DataLoader(samples, batch_size=1, num_workers=2, persistent_workers=True)
        found = []
        for epoch in (0, 1, 2, 0):
            samples.set_epoch(epoch)
            found.append([batch["lit"].numpy().tobytes() for batch in loader])
        assert found[0] == found[3]
        assert len({tuple(each) for each in found}) > 1


def test_a_sample_depends_on_seed_epoch_and_index(recording):
    def picture(seed, epoch, index):
        samples = composed(recording, seed)
        samples.set_epoch(epoch)
        return samples[index]["lit"].numpy().tobytes()

    draws = [(0, 0, 0), (0, 0, 1), (0, 1, 0), (1, 0, 0), (0, 0, 3)]
    assert len({picture(*draw) for draw in draws}) == len(draws)
    assert all(picture(*draw) == picture(*draw) for draw in draws)


def test_samples_are_what_render_makes(recording):
    samples = composed(recording)
    with omniscv.open_source(recording) as source:
        for sample in samples:
            record = sample["record"]
            pose = record.pose
            image = omniscv.render(record.camera, pose, source, MODES, filter="nearest")
            np.testing.assert_array_equal(sample["labels"].numpy(), image.labels)
            off = np.abs(sample["depth"][0].numpy() - image.depth)
            assert (off <= image.depth_error / 32).all()  # composed depth is rounded by as much
            blended = omniscv.render(record.camera, pose, source, filter="bilinear")
            lit = np.moveaxis(sample["lit"].numpy(), 0, -1).astype(int)
            assert np.abs(lit - blended.lit).max() <= 1
            np.testing.assert_allclose(sample["R_w_c"], pose.R_w_c, atol=1e-7)
    positions = {sample["record"].place for sample in samples}
    assert positions == {"0.000,0.000,1.500", "0.800,-0.500,1.200"}


def test_a_sample_that_is_changed_changes_no_other(folder):
    samples = FolderDataset(folder, ("directions",), cameras=["pano"])
    first = samples[0]
    kept = {name: first[name].clone() for name in ("valid", "directions")}
    first["valid"].fill_(False)
    first["directions"].mul_(-1)
    assert all(torch.equal(samples[1][name], value) for name, value in kept.items())


def test_a_recording_by_url(recording, monkeypatch, tmp_path):
    monkeypatch.setenv("OMNISCV_CACHE", str(tmp_path))
    url = f"memory://{tmp_path.name}"
    storage.folder(url).put("room.sqlite", recording)
    read = [loaded(composed(path), batch_size=None) for path in (f"{url}/room.sqlite", recording)]
    same(*read)
    with pytest.raises(ArgumentError, match=f"folder: expected one on this machine, got {url}; copy it"):
        ShardDataset(url)


def test_turns_are_within_their_ranges():
    cameras = CAMERA, omniscv.cameras.create("equirectangular", width=64, height=32)
    turns = RandomTurns(cameras, yaw_deg=(10, 20), pitch_deg=(-5, 5), roll_deg=(1, 1))
    drawn = [turns(np.random.default_rng(seed)) for seed in range(200)]
    assert {camera for camera, _ in drawn} == set(cameras)
    angles = np.array([omniscv.Pose(np.zeros(3), R).angles() for _, R in drawn])
    assert (angles.min(axis=0) >= (10 - 1e-9, -5 - 1e-9, 1 - 1e-9)).all()
    assert (angles.max(axis=0) <= (20 + 1e-9, 5 + 1e-9, 1 + 1e-9)).all()
    assert (np.ptp(angles, axis=0)[:2] > (9, 9)).all()


def test_a_batch_holds_records(recording):
    batch = next(iter(DataLoader(composed(recording), batch_size=3)))
    assert [record.key for record in batch["record"]] == ["0-0", "0-1", "0-2"]
    assert batch["depth"].shape == (3, 1, 32, 32)
    assert batch["position"].shape == (3, 3)


def test_wrong_arguments(recording, tmp_path):
    with pytest.raises(ArgumentError, match="cameras: expected at least one"):
        RandomTurns(())
    with pytest.raises(ArgumentError, match=r"pitch_deg: expected \(least, most\)"):
        RandomTurns(CAMERA, pitch_deg=(1, 0))
    with pytest.raises(ArgumentError, match="draw: expected a function"):
        RecordingDataset(recording, CAMERA)
    with pytest.raises(ArgumentError, match="modes: expected a sequence"):
        RecordingDataset(recording, TURNS, "lit")
    path = tmp_path / "one.sqlite"
    pinhole = omniscv.cameras.create("pinhole", width=8, height=8, fov_deg=60)
    with omniscv.record(omniscv.open_source("scene://four-wall"), path) as source:
        omniscv.render(pinhole, omniscv.Pose.from_angles((0, 0, 1.5)), source)
    with pytest.raises(ArgumentError, match="expected six faces around some optical centre"):
        RecordingDataset(path, TURNS)
    with pytest.raises(IndexError):
        composed(recording)[6]
