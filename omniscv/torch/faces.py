"""The captures of one optical centre as tensors, and images of any central camera from them."""

from collections.abc import Mapping, Sequence
from functools import lru_cache, partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from omniscv import modalities
from omniscv.arguments import numbers
from omniscv.cameras import Camera, create
from omniscv.compose.renderer import Renderer
from omniscv.errors import ArgumentError, MissingCaptureError
from omniscv.frame.classes import ClassRules, class_rules
from omniscv.geometry import Array, Pose
from omniscv.geometry.pose import rotation_reader
from omniscv.planning import RenderOptions, captured
from omniscv.sources import ObjectTable, Source, View
from omniscv.sources.labels import labels_of, labels_of_ids
from omniscv.torch.sampling import DeviceLookup, DeviceTiles, ProcessorLookup, ProcessorTiles, check_central

_FINEST = 1  # px: all faces of a recording are larger, so it returns its finest ones
_RAYS_AT_ONCE = {"cpu": 1 << 17}
_RAYS_ON_A_DEVICE = 1 << 26
"""Rays of a block: they fit into a processor's cache, and into a gigabyte on a device."""
_ON_PROCESSOR = ("cpu",)
"""Types of devices for which the kernels of :mod:`omniscv.compose` sample; for others Triton's do."""

Rules = str | Path | Mapping[str, Any] | ClassRules


class Faces:
    """Six faces around an optical centre, from which images of any orientation are sampled on a device.

    Colour is bilinear. Labels and depth are those of the nearest pixel, as ``omniscv.render`` composes them
    with ``filter="nearest"`` before it rounds depth. The constructor captures all faces.

    Args:
        source: a recording, or another source of a still world; not needed afterwards.
        position: (3,) the optical centre, metres, world frame.
        modes: modalities of :mod:`omniscv.modalities`.
        face_size: px of a 90 degree face; None: the finest faces of a recording.
        truth_scale: factor by which masks, depth and normals are captured finer than colours.
        classes: rules, as in ``classes.yaml``, or such a file, for images with ``classes``.
        device: of the tensors; it must have float64, and Triton unless it is the processor.

    Attributes:
        position: of all images.

    Raises:
        ArgumentError: an unknown mode, no ``face_size`` for a live source, a world that moves, or a device
            without float64 or Triton.
        MissingCaptureError: the recording lacks a face.
    """

    def __init__(
        self,
        source: Source,
        position: ArrayLike,
        modes: Sequence[str] = ("lit",),
        *,
        face_size: int | None = None,
        truth_scale: int = 1,
        classes: Rules | None = None,
        device: str | torch.device = "cpu",
    ) -> None:
        self._device = _check(source, face_size, device)
        self.position = numbers("position", position, (3,))
        options = RenderOptions("cube", face_size=face_size or _FINEST, truth_scale=truth_scale)
        self._on_processor = self._device.type in _ON_PROCESSOR
        self._tiles: dict[str, tuple[tuple[View, ...], Any]] = {}
        self._class_of: Tensor | None = None
        for mode, (views, faces) in _capture(source, self.position, modes, options).items():
            if "labels" in modalities.get(mode).derives:
                objects = source.objects()
                masks = np.stack(faces)  # colours, or instance ids
                labels, _ = (labels_of_ids if masks.ndim == 3 else labels_of)(masks, objects)
                mode = "labels"
                faces = list(labels)
                if classes is not None:
                    self._class_of = _class_of(class_rules(classes), objects).to(self._device)
            kind = modalities.get(mode).interpolation
            make = ProcessorTiles if self._on_processor else partial(DeviceTiles, device=self._device)
            self._tiles[mode] = views, make(kind, views, faces)

    def render(self, camera: Camera, R_w_c: ArrayLike | Tensor) -> dict[str, Tensor]:
        """Return images of a central camera, one for each orientation.

        Args:
            camera: the model and its size.
            R_w_c: (B, 3, 3), or (3, 3) for a batch of one: camera to world.

        Returns:
            ``lit`` (B, 3, H, W) as captured, ``labels`` and ``classes`` (B, H, W) int64, ``depth``
            (B, 1, H, W) float32 metres along the ray, ``normals`` (B, 3, H, W) float32, camera frame; other
            modalities alike. Outside the field of view all are 0.

        Raises:
            ArgumentError: a camera that is not central, or matrices that are no rotations.
            MissingCaptureError: some rays are in none of the faces.
        """
        check_central(camera)
        values: Any = R_w_c.tolist() if isinstance(R_w_c, Tensor) else R_w_c
        rotations = rotation_reader("R_w_c", [values] if np.ndim(values) == 2 else values, (None, 3, 3))
        valid = _valid(camera, self._device)
        rays = _RAYS_AT_ONCE.get(self._device.type, _RAYS_ON_A_DEVICE)
        step = max(1, rays // valid.numel())
        blocks = []
        counts = []
        for start in range(0, len(rotations), step):
            layers, count = self._sample(camera, valid, rotations[start : start + step])
            blocks.append(layers)
            counts.append(count)
        if unseen := int(sum(counts)):  # here the processor waits for the device
            views = len(next(iter(self._tiles.values()))[0])
            here = f"{views} views at {self.position.tolist()} m"
            raise MissingCaptureError(f"expected {here} to see all rays, but {unseen} are in none")
        if len(blocks) == 1:
            return blocks[0]
        joined = {}
        for name in blocks[0]:
            joined[name] = torch.cat([layers[name] for layers in blocks])
        return joined

    @property
    def tensors(self) -> dict[str, Tensor]:
        """By layer, the faces' pixels on the device. Pixels of the same views may be copied into them."""
        return {name: tiles.tensor for name, (_, tiles) in self._tiles.items()}

    @property
    def nbytes(self) -> int:
        """Bytes of the faces in memory."""
        return sum(tensor.nbytes for tensor in self.tensors.values())

    def _sample(self, camera: Camera, valid: Tensor, R_w_c: Array) -> tuple[dict[str, Tensor], Tensor | int]:
        """Return layers, and how many rays no view sees."""
        lookups: dict[tuple[View, ...], DeviceLookup | ProcessorLookup] = {}
        layers = {}
        unseen = 0
        for name, (views, tiles) in self._tiles.items():
            if views not in lookups:
                if self._on_processor:
                    lookups[views] = ProcessorLookup(camera, views, R_w_c)
                else:
                    lookups[views] = DeviceLookup(camera, views, R_w_c, self._device)
                unseen += lookups[views].unseen
            values = tiles.sample(lookups[views])
            modality = modalities.get(name)
            if modality.interpolation == "direction":
                R_c_w = torch.from_numpy(np.array(R_w_c).swapaxes(1, 2)).to(self._device)
                values = (R_c_w @ values.double()).float()
            layers[name] = _as_images(values, valid, modality.outside)
            if name == "labels" and self._class_of is not None:
                layers["classes"] = self._class_of[layers[name]]
        return layers, unseen


def _check(source: Source, face_size: int | None, device: str | torch.device) -> torch.device:
    """Return the device; ArgumentError if it or the source cannot be used."""
    checked = torch.device(device)
    if checked.type == "mps":
        raise ArgumentError("device: expected one with float64, such as cpu or cuda; mps has none")
    if checked.type not in _ON_PROCESSOR and find_spec("triton") is None:
        raise ArgumentError(f"device: expected Triton for {checked.type}; pip install triton, or use cpu")
    if source.capabilities.moves:
        raise ArgumentError("source: expected a world that stands still; record it, and use the recording")
    if face_size is None and source.recorded_views() is None:
        raise ArgumentError("face_size: expected a whole number of pixels for a source that captures anew")
    return checked


def _capture(
    source: Source, position: Array, modes: Sequence[str], options: RenderOptions
) -> dict[str, tuple[tuple[View, ...], list[NDArray[Any]]]]:
    """By mode, views and their pixels."""
    # Any camera of all directions has the same views: whole cubes.
    camera = create("equirectangular", width=4, height=2)
    plan = Renderer(source).plan(camera, Pose(position, np.eye(3)), options)
    ((_, by_mode),) = captured(next(plan.rounds()), source, modalities.chosen(modes))
    pictures = {}
    for mode, captures in by_mode.items():
        views = tuple(capture.view for capture in captures)
        pictures[mode] = (views, [np.asarray(capture.pixels) for capture in captures])
    return pictures


def _class_of(rules: ClassRules, objects: ObjectTable) -> Tensor:
    """(65536,) int64, the class id of each label."""
    names = objects.names()
    label_of = {name: label for label, name in enumerate(names, start=1)}
    return torch.from_numpy(rules.table(names).ids(label_of).astype(np.int64))


@lru_cache(maxsize=4)
def _valid(camera: Camera, device: torch.device) -> Tensor:
    """Return (H, W) bool."""
    return torch.from_numpy(np.array(camera.valid())).to(device)


def _as_images(values: Tensor, valid: Tensor, outside: float) -> Tensor:
    """(B, N) or (B, C, N) values as images; maps of floats with a channel."""
    channels = values.shape[1:-1]
    if not channels and values.dtype.is_floating_point:
        channels = torch.Size((1,))
    values = values.reshape(len(values), *channels, *valid.shape)
    return torch.where(valid, values, outside) if outside else values
