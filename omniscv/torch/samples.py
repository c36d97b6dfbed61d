"""One image as a dict of tensors and its frame; datasets of frames, their epochs and their workers."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
import torch.multiprocessing  # shared tensors can be pickled for workers  # noqa: F401
from numpy.typing import NDArray
from torch.utils.data import Dataset, get_worker_info
from torch.utils.data._utils.collate import default_collate_fn_map

from omniscv import dataset, parallel
from omniscv.arguments import one_of, texts, whole_number
from omniscv.cameras import Camera
from omniscv.frame import Frame

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
    """Return a sample, with the camera's rays if ``directions``."""
    rays, valid = _rays(frame.camera)
    pose = {
        "position": torch.tensor(frame.pose.position, dtype=torch.float32),
        "R_w_c": torch.tensor(frame.pose.R_w_c, dtype=torch.float32),
    }
    extra = {DIRECTIONS: rays.clone()} if directions else {}
    return {**layers, **extra, "valid": valid.clone(), **pose, "record": frame}


def sample_of_frame(frame: Frame, names: Sequence[str] | None) -> Sample:
    """Return a frame as a sample.

    Args:
        frame: with files.
        names: of layers; None: those of ``LAYERS`` that it has. ``valid`` always comes.

    Raises:
        ArgumentError: a layer that the frame does not have, or a file that cannot be read.
    """
    names = [name for name in LAYERS if name in frame.files] if names is None else names
    layers = {name: tensor_of(frame.layer(name)) for name in names if name not in (DIRECTIONS, "valid")}
    small = replace(frame, files={}, instances={}, classes=None)  # what workers send with each sample
    vars(small).update(truth=frame.truth, layout=frame.layout)
    return sample_of(small, layers, directions=DIRECTIONS in names)


def tensor_of(pixels: NDArray[Any]) -> torch.Tensor:
    """Return a layer as PyTorch has pictures: channels first, whole numbers of maps as int64.

    Args:
        pixels: (H, W) or (H, W, C).

    Returns:
        (C, H, W) of the same dtype; of (H, W) floats (1, H, W); of others (H, W), int64 or bool.
    """
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
        """Set the epoch; call it before the loader is iterated.

        Raises:
            ArgumentError: an epoch below 0.
        """
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
        self.frames = tuple(
            frame
            for frame in frames
            if (not cameras or frame.camera_name in cameras) and split in ("", frame.split)
        )

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: int) -> Sample:
        bound_threads()
        return sample_of_frame(self.frames[index], self.layers)
