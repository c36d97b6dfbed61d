"""One image as a dict of tensors and its frame; a dataset on disk, frame by frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils.data import Dataset
from torch.utils.data._utils.collate import default_collate_fn_map

from omniscv import dataset
from omniscv.arguments import one_of, texts
from omniscv.cameras import Camera
from omniscv.frame import Frame
from omniscv.torch.workers import bound_threads

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
        names: of layers; None: those of ``LAYERS`` that it has.

    Raises:
        ArgumentError: a layer that the frame does not have, or a file that cannot be read.
    """
    names = [name for name in LAYERS if name in frame.files] if names is None else names
    layers = {name: tensor_of(frame.layer(name)) for name in names if name != DIRECTIONS}
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
