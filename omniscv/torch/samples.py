"""One image as a dict of tensors, and its record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils.data._utils.collate import default_collate_fn_map

from omniscv.cameras import Camera
from omniscv.dataset import Frame
from omniscv.geometry import Pose

LAYERS = ("lit", "labels", "classes", "depth", "normals")
"""What a sample has, as far as its frame has it, unless others are named."""

DIRECTIONS = "directions"
"""Named among the layers, the rays of the camera: (3, H, W) float32 unit vectors, camera frame, else 0."""

Sample = dict[str, Any]
"""Layers by name, ``valid`` (H, W) bool, ``position`` (3,) and ``R_w_c`` (3, 3) float32, and ``record``."""


@dataclass(frozen=True, eq=False)
class Record:
    """What is known of a sample beside its tensors; a batch has a list of them.

    Attributes:
        key: unique in its dataset.
        camera_name, camera: as the dataset names it.
        pose: of the camera, world frame, in float64.
        time: seconds; None where poses have none.
        place, split, scene, state: as in :class:`omniscv.dataset.Frame`.
        truth, layout: records, as the frame has them; empty without.
    """

    key: str
    camera_name: str
    camera: Camera
    pose: Pose
    time: float | None = None
    place: str = ""
    split: str = ""
    scene: str = ""
    state: str = ""
    truth: Mapping[str, Any] = field(default_factory=dict)
    layout: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, frame: Frame) -> Record:
        """Return the record of a frame; ArgumentError where its files cannot be read."""
        alike = ("key", "camera_name", "camera", "pose", "time", "place", "split", "scene", "state")
        values = {name: getattr(frame, name) for name in alike}
        return cls(**values, truth=frame.truth, layout=frame.layout)


def _as_list(batch: Sequence[Record], *, collate_fn_map: object = None) -> list[Record]:
    return list(batch)


default_collate_fn_map[Record] = _as_list  # as torch's default_collate documents it


def sample_of(record: Record, layers: Mapping[str, torch.Tensor], *, directions: bool = False) -> Sample:
    """Return a sample; with the camera's rays if they are wanted."""
    rays, valid = _rays(record.camera)
    pose = {
        "position": torch.tensor(record.pose.position, dtype=torch.float32),
        "R_w_c": torch.tensor(record.pose.R_w_c, dtype=torch.float32),
    }
    wanted = {DIRECTIONS: rays.clone()} if directions else {}
    return {**layers, **wanted, "valid": valid.clone(), **pose, "record": record}


def sample_of_frame(frame: Frame, names: Sequence[str] | None) -> Sample:
    """Return a frame as a sample.

    Args:
        frame: whose files are read.
        names: layers; None: those of ``LAYERS`` that it has.

    Raises:
        ArgumentError: a layer that the frame does not have, or a file that cannot be read.
    """
    wanted = [name for name in LAYERS if name in frame.files] if names is None else names
    layers = {name: tensor_of(frame.layer(name)) for name in wanted if name != DIRECTIONS}
    return sample_of(Record.of(frame), layers, directions=DIRECTIONS in wanted)


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
