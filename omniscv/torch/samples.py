"""One image as a dict of tensors and its frame; datasets of frames and of shards, epochs and workers.

Of WebDataset shards a process opens a group at a time, by the headers of their members, and reads samples
from any position in them.
"""

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
import torch
import torch.distributed
import torch.multiprocessing  # shared tensors can be pickled for workers  # noqa: F401
from numpy.typing import NDArray
from torch.utils.data import Dataset, IterableDataset, get_worker_info
from torch.utils.data._utils.collate import default_collate_fn_map

from omniscv import dataset, parallel, storage
from omniscv.arguments import flag, one_of, texts, whole_number
from omniscv.cameras import Camera
from omniscv.dataset.formats.webdataset import Shard, read_list
from omniscv.dataset.shares import Share, samples_of, shuffled
from omniscv.errors import ArgumentError
from omniscv.frame import FileEntry, Frame
from omniscv.storage import is_url

LAYERS = ("lit", "labels", "classes", "depth", "normals")
"""Layers of a sample, as far as its frame has them, unless others are named."""

DIRECTIONS = "directions"
"""As a layer, the rays of the camera: (3, H, W) float32 unit vectors, camera frame; 0 where not valid."""

Sample = dict[str, Any]
"""Layers by name, ``valid`` (H, W) bool, ``position`` (3,) and ``R_w_c`` (3, 3) float32, and ``record``: the
frame with its records, without its files. A batch has a list of records."""


def _as_list(batch: Sequence[Frame], *, collate_fn_map: object = None) -> list[Frame]:
    return list(batch)


default_collate_fn_map[Frame] = _as_list  # as torch's default_collate documents it


def sample_of(frame: Frame, layers: Mapping[str, torch.Tensor], *, directions: bool = False) -> Sample:
    """Return the sample of a ``frame`` with its ``layers``, and with the camera's rays if ``directions``."""
    rays, valid = _rays(frame.camera)
    sample: Sample = dict(layers)
    if directions:
        sample[DIRECTIONS] = rays.clone()
    sample["valid"] = valid.clone()
    sample["position"] = torch.tensor(frame.pose.position, dtype=torch.float32)
    sample["R_w_c"] = torch.tensor(frame.pose.R_w_c, dtype=torch.float32)
    sample["record"] = frame
    return sample


def sample_of_frame(frame: Frame, names: Sequence[str] | None) -> Sample:
    """Return a ``frame`` with files as a sample of the layers ``names``; None: of those of ``LAYERS`` that it
    has."""
    if names is None:
        names = [name for name in LAYERS if name in frame.files]
    layers = {}
    for name in names:
        if name not in (DIRECTIONS, "valid"):
            layers[name] = tensor_of(frame.layer(name))
    small = replace(frame, files={}, instances={}, classes=None)  # what workers send with each sample
    vars(small).update(truth=frame.truth, layout=frame.layout)
    return sample_of(small, layers, directions=DIRECTIONS in names)


def tensor_of(pixels: NDArray[Any]) -> torch.Tensor:
    """Return a layer as PyTorch has pictures: of (H, W, C) pixels (C, H, W) of the same dtype; of (H, W)
    floats (1, H, W); of others (H, W), int64 or bool."""
    if pixels.ndim == 3:
        return torch.from_numpy(np.ascontiguousarray(np.moveaxis(pixels, -1, 0)))
    if pixels.dtype.kind == "f":
        return torch.from_numpy(np.ascontiguousarray(pixels[None]))
    return torch.from_numpy(pixels.astype(np.bool_ if pixels.dtype == np.bool_ else np.int64))


@lru_cache(maxsize=8)
def _rays(camera: Camera) -> tuple[torch.Tensor, torch.Tensor]:
    """(3, H, W) directions and (H, W) whether they are valid."""
    rays = camera.unproject()
    directions = np.nan_to_num(np.moveaxis(rays.directions, -1, 0)).astype(np.float32)
    return torch.from_numpy(directions), torch.from_numpy(np.array(rays.valid))


class Epochs:
    """A base of datasets that differ from epoch to epoch.

    The epoch lies in shared memory, so that workers that persist see it too.
    """

    def __init__(self) -> None:
        self._epoch = torch.zeros((), dtype=torch.int64).share_memory_()

    @property
    def epoch(self) -> int:
        """The epoch, 0 at first."""
        return int(self._epoch)

    def set_epoch(self, epoch: int) -> None:
        """Set the epoch, >= 0; call it before the loader is iterated."""
        self._epoch.fill_(whole_number("epoch", epoch, least=0))


def bound_threads() -> None:
    """Use one thread in a worker, as PyTorch does; outside workers do nothing."""
    if get_worker_info() is not None:
        _bound_threads(os.getpid())


@lru_cache(maxsize=1)
def _bound_threads(process: int) -> None:
    """Cached by process, because a forked worker must set what its parent has set."""
    parallel.limit(1)
    cv2.setNumThreads(0)  # 1 would wait for threads that did not survive the fork


class FolderDataset(Dataset[Sample]):
    """The frames of a dataset on disk, in the order of their keys.

    Args:
        folder: of a dataset that is complete, by path or URL.
        layers: of the samples; :data:`LAYERS` if not given.
        cameras: only frames of these; of all if empty. Batches need images of one size.
        split: only frames of this split; of all if empty.

    Raises:
        ArgumentError: no dataset is there, or it has no such camera or split.
        DatasetError: it is not complete.
    """

    def __init__(
        self,
        folder: str | Path,
        layers: Sequence[str] | None = None,
        *,
        cameras: Sequence[str] = (),
        split: str = "",
    ) -> None:
        self.layers = None if layers is None else texts("layers", layers)
        frames = dataset.open(folder)
        cameras = texts("cameras", cameras) if cameras else ()
        for camera in cameras:
            one_of("cameras", camera, sorted({frame.camera_name for frame in frames}))
        if split:
            one_of("split", split, sorted({frame.split for frame in frames}))
        selected = []
        for frame in frames:
            if split in ("", frame.split) and (not cameras or frame.camera_name in cameras):
                selected.append(frame)
        self.frames = tuple(selected)

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: int) -> Sample:
        bound_threads()
        return sample_of_frame(self.frames[index], self.layers)


_GROUP_SHARDS = 8
"""Shards that are shuffled together: a batch has samples of many places, and few files are open."""

_RECORDS = "truth", "layout"
"""Kinds of files that every sample has, beside layers."""


class ShardDataset(Epochs, IterableDataset[Sample]):
    """The samples of WebDataset shards, as ``omniscv dataset pack --as webdataset`` writes them.

    Each sample comes once an epoch, in one rank and one of its workers. Their shares differ by at most one
    sample, unless ``batch_size`` is given. Every file that is read is compared with its checksum.

    Args:
        folder: with ``shards.json`` and the shards that it lists, by path or URL; a store's shards are
            fetched into the local cache when they are read. Batches need images of one size: pack one camera
            a folder.
        layers: of the samples; those of :data:`LAYERS` that are there, if not given.
        split: only shards of this split; of all if empty.
        shuffle: draw the order from seed and epoch; else it is that of the shards.
        seed: of the order; the same in all ranks.
        rank: of this process; that of ``torch.distributed`` or ``torchrun`` if not given.
        world_size: the number of ranks; as of ``rank`` if not given.
        batch_size: that of the loader. All ranks then have the same number of whole batches, whatever their
            workers, as collective operations need it. The remaining samples of an epoch are left out; with
            ``shuffle`` they are others in each epoch.

    Raises:
        ArgumentError: the folder has no shards, too few samples for a batch in each rank, or an argument is
            wrong.
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
        batch_size: int | None = None,
    ) -> None:
        super().__init__()
        self.batch_size = None if batch_size is None else whole_number("batch_size", batch_size)
        self.shuffle = flag("shuffle", shuffle)
        self.seed = whole_number("seed", seed, least=0)
        self.layers = None if layers is None else texts("layers", layers)
        self._rank = rank_share(rank, world_size)
        # A worker may have another working folder.
        self._folder = storage.folder(folder if is_url(folder) else Path(folder).absolute())
        self._manifest, shards = read_list(self._folder)
        if split:
            one_of("split", split, sorted({_split_of(file) for file in shards}))
        self._files: list[FileEntry] = []
        self._keys: list[tuple[str, ...]] = []  # of the samples of each file
        for file, keys in shards.items():
            if split in ("", _split_of(file)):
                self._files.append(file)
                self._keys.append(keys)
        self._count = sum(map(len, self._keys))
        if self.batch_size is not None and self._count < self.batch_size * self._rank.count:
            wanted = f"expected samples for a batch of {self.batch_size} in each of {self._rank.count} ranks"
            raise ArgumentError(f"batch_size: {wanted}, got {self._count}")

    def __len__(self) -> int:
        """How many samples this rank reads in an epoch."""
        return len(range(self._count)[samples_of(self._count, self._rank, Share(), self.batch_size)])

    def __iter__(self) -> Iterator[Sample]:
        bound_threads()
        if self.shuffle:
            groups = shuffled(self._keys, _GROUP_SHARDS, np.random.default_rng((self.seed, self.epoch)))
        else:
            groups = []
            for number, keys in enumerate(self._keys):
                groups.append([(number, key) for key in keys])
        part = samples_of(self._count, self._rank, worker_share(), self.batch_size)
        first = 0
        for group in groups:
            yield from self._read(group[max(part.start - first, 0) : max(part.stop - first, 0)])
            first += len(group)

    def _read(self, samples: Sequence[tuple[int, str]]) -> Iterator[Sample]:
        """Yield ``samples``, each given by the index of its shard and its key.

        Every shard is opened once. Files are extracted to a temporary folder, one sample at a time.
        """
        kinds = (*(LAYERS if self.layers is None else self.layers), *_RECORDS)
        with ExitStack() as stack:
            folder = Path(stack.enter_context(TemporaryDirectory(prefix="omniscv-")))
            shards: dict[int, Shard] = {}
            for index, key in samples:
                if index not in shards:
                    shard = Shard(self._folder, self._files[index], self._manifest)
                    shards[index] = stack.enter_context(closing(shard))
                frame = shards[index].extract(key, kinds, folder)
                sample = sample_of_frame(frame, self.layers)
                for path in folder.iterdir():  # the sample has decoded them
                    path.unlink()
                yield sample


def _split_of(file: FileEntry) -> str:
    """Return the split of a shard, ``SPLIT-000000.tar``."""
    return file.path.rpartition("-")[0]


def rank_share(rank: int | None, world_size: int | None) -> Share:
    """Return the part of a ``rank`` of ``world_size``.

    If both are None, it is that of ``torch.distributed``, else of ``torchrun``'s ``RANK`` and ``WORLD_SIZE``,
    else all. ArgumentError: one of them is None, or out of range.
    """
    if (rank is None) != (world_size is None):
        raise ArgumentError(f"rank: expected both rank and world_size, got {rank} and {world_size}")
    if rank is None or world_size is None:
        if torch.distributed.is_available() and torch.distributed.is_initialized():
            return Share(torch.distributed.get_rank(), torch.distributed.get_world_size())
        rank = int(os.environ.get("RANK", "0"))
        world_size = int(os.environ.get("WORLD_SIZE", "1"))
    count = whole_number("world_size", world_size)
    return Share(whole_number("rank", rank, least=0, most=count - 1), count)


def worker_share() -> Share:
    """Return the part of this worker of its rank's loader; outside of workers all."""
    info = get_worker_info()
    return Share() if info is None else Share(info.id, info.num_workers)
