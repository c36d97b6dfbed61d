"""A dataset on disk, frame by frame."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from torch.utils.data import Dataset

from omniscv import dataset
from omniscv.arguments import one_of, texts
from omniscv.dataset import Frame
from omniscv.torch.samples import Sample, sample_of_frame
from omniscv.torch.workers import bound_threads


class FolderDataset(Dataset[Sample]):
    """The frames of a dataset on disk, in the order of their keys.

    Args:
        folder: of a dataset that is complete, by path or URL.
        layers: what samples have; :data:`LAYERS` if not given.
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
        self.frames = chosen(dataset.open(folder), cameras, split)

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: int) -> Sample:
        bound_threads()
        return sample_of_frame(self.frames[index], self.layers)


def chosen(frames: Sequence[Frame], cameras: Sequence[str], split: str) -> tuple[Frame, ...]:
    """Return the frames of some cameras and of a split; of all where none is named.

    Raises:
        ArgumentError: no frame is of a camera or of the split.
    """
    known = sorted({frame.camera_name for frame in frames})
    for camera in texts("cameras", cameras):
        one_of("cameras", camera, known)
    if split:
        one_of("split", split, sorted({frame.split for frame in frames}))
    return tuple(
        frame
        for frame in frames
        if (not cameras or frame.camera_name in cameras) and split in ("", frame.split)
    )
