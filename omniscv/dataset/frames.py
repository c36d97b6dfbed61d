"""A frame of a dataset: the files of one image, and what is known of it. Formats read nothing else."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.truth.classes import ClassTable


@dataclass(frozen=True, eq=False, repr=False)
class Frame:
    """One image of a dataset, on disk.

    Attributes:
        key: start of its file names, unique in the dataset, without a dot.
        camera_name, camera: as the dataset names it.
        pose: of the camera, world frame.
        files: by kind: a layer's name, ``truth`` (STEM.truth.json), ``layout`` (STEM.layout.json), or
            ``image`` (STEM.json).
        instances: object name to the instance id that ``labels`` holds, the same in the whole dataset.
        classes: of the dataset; None without.
        time: seconds; None where poses have none.
        place: frames of one place are never split.
        split: ``train``, ``val``, ``test``, ...; empty without splits.
        scene: identity of what was captured; empty where it is not known.
        state: of the world (:attr:`omniscv.geometry.instant.Instant.state`); empty for a still one.
    """

    key: str
    camera_name: str
    camera: Camera
    pose: Pose
    files: Mapping[str, Path]
    instances: Mapping[str, int]
    classes: ClassTable | None = None
    time: float | None = None
    place: str = ""
    split: str = ""
    scene: str = ""
    state: str = ""

    def __repr__(self) -> str:
        split = f", {self.split}" if self.split else ""
        return f"<Frame {self.key}: {self.camera_name}{split}: {', '.join(self.files)}>"

    def layer(self, name: str) -> NDArray[Any]:
        """Return a layer as it was in memory: dtype and shape as :mod:`omniscv.modalities` has it.

        Raises:
            ArgumentError: the frame has no such layer, or its file cannot be read.
        """
        from omniscv.compose.files import read

        return read(self._file(name), name)

    def has(self, *names: str) -> dict[str, NDArray[Any]]:
        """Return those of some layers that the frame has, by name, as :meth:`layer` does."""
        return {name: self.layer(name) for name in names if name in self.files}

    @cached_property
    def truth(self) -> Mapping[str, Any]:
        """The records of STEM.truth.json, by the name of the truth; empty without the file."""
        return self._records("truth")

    @cached_property
    def layout(self) -> Mapping[str, Any]:
        """The record of STEM.layout.json; empty without the file."""
        return self._records("layout")

    @cached_property
    def valid(self) -> NDArray[np.bool_]:
        """(H, W) bool: the pixels inside the field of view."""
        return self.camera.valid()

    def _records(self, kind: str) -> Mapping[str, Any]:
        if kind not in self.files:
            return {}
        try:
            found = json.loads(self.files[kind].read_text(encoding="utf-8"))
        except (OSError, ValueError) as cause:
            raise ArgumentError(f"{self.files[kind]}: expected records in JSON, got: {cause}") from cause
        return dict(found)

    def _file(self, kind: str) -> Path:
        if kind not in self.files:
            have = ", ".join(self.files) or "none"
            raise ArgumentError(
                f"{self.key}: expected a frame with {kind}, it has {have}; make it with {kind}"
            )
        return self.files[kind]
