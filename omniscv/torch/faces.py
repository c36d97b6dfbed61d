"""The captures of one optical centre as tensors, and images of any central camera from them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from omniscv import modalities
from omniscv.arguments import numbers
from omniscv.cameras import Camera, create
from omniscv.compose.labels import labels_of, labels_of_ids
from omniscv.compose.renderer import Renderer
from omniscv.dataset.classes import class_rules
from omniscv.errors import ArgumentError, MissingCaptureError
from omniscv.geometry import Array, Pose
from omniscv.planning import RenderOptions, captured, rounds
from omniscv.sources import ObjectTable, Source, View
from omniscv.torch.lookup import Lookup, directions_of, look_up
from omniscv.torch.tiles import TILES, Tiles
from omniscv.torch.turns import check_central
from omniscv.truth.classes import ClassRules

_FINEST = 1  # px: no face has that size, so that a recording gives the finest that it has
_RAYS_AT_ONCE = {"cpu": 1 << 17}
_RAYS_ON_A_DEVICE = 1 << 23
"""Rays that are looked up together: what stays in a processor's cache, and a gigabyte on a device."""

Rules = str | Path | Mapping[str, Any] | ClassRules


class Faces:
    """Six faces around an optical centre, from which images of any orientation are sampled on a device.

    Colour is bilinear; labels and depth are those of the nearest pixel, equal to the bit to what
    ``omniscv.render`` makes with ``filter="nearest"``. Everything is captured when it is made.

    Args:
        source: a recording, or any other source of a world that stands still; not needed afterwards.
        position: (3,) the optical centre, metres, world frame.
        modes: modalities of :mod:`omniscv.modalities`.
        face_size: px of a 90 degree face; None: the finest that a recording holds.
        truth_scale: how many times finer than colours masks, depth and normals are captured.
        classes: rules, as in ``classes.yaml``, or such a file: images then have ``classes`` too.
        device: where tensors lie; it must have float64.

    Attributes:
        position: of all images.

    Raises:
        ArgumentError: an unknown mode, no ``face_size`` for a source that captures anew, a world that
            moves, or a device that cannot do it.
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
        self._device = _checked(source, face_size, device)
        self.position = numbers("position", position, (3,))
        options = RenderOptions("cube", face_size=face_size or _FINEST, truth_scale=truth_scale)
        self._tiles: dict[str, tuple[tuple[View, ...], Tiles]] = {}
        self._class_of: Tensor | None = None
        for mode, (views, faces) in _captured(source, self.position, modes, options).items():
            if "labels" in modalities.get(mode).derives:
                objects = source.objects()
                mode, faces = "labels", list(_labels(np.stack(faces), objects))
                if classes is not None:
                    self._class_of = _class_of(class_rules(classes), objects).to(self._device)
            kind = TILES[modalities.get(mode).interpolation]
            self._tiles[mode] = views, kind(views, faces, self._device)

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
            ArgumentError: a camera that is not central, or what are no rotations.
            MissingCaptureError: the faces do not show all rays.
        """
        check_central(camera)
        given = R_w_c.tolist() if isinstance(R_w_c, Tensor) else R_w_c
        batch = numbers("R_w_c", [given] if np.ndim(given) == 2 else given, (None, 3, 3))
        every = [Pose(self.position, R).R_w_c for R in batch]
        directions, valid = directions_of(camera, self._device)
        at_once = _RAYS_AT_ONCE.get(self._device.type, _RAYS_ON_A_DEVICE)
        step = max(1, at_once // valid.numel())
        parts = [self._sampled(directions, valid, every[i : i + step]) for i in range(0, len(every), step)]
        return {name: torch.cat([part[name] for part in parts]) for name in parts[0]}

    @property
    def nbytes(self) -> int:
        """What is held in memory."""
        return sum(tiles.tensor.nbytes for _, tiles in self._tiles.values())

    def _sampled(self, directions: Tensor, valid: Tensor, R_w_c: Sequence[Array]) -> dict[str, Tensor]:
        lookups: dict[tuple[View, ...], Lookup] = {}
        found = {}
        for name, (views, tiles) in self._tiles.items():
            if views not in lookups:
                lookups[views] = look_up(directions, views, R_w_c)
                self._check_seen(lookups[views], valid)
            values = tiles.sample(lookups[views])
            row = modalities.get(name)
            if row.interpolation == "direction":
                turn = torch.from_numpy(np.array(R_w_c)).to(self._device)
                values = (values.double() @ turn).float()
            found[name] = _shaped(values, valid, row.outside)
            if name == "labels" and self._class_of is not None:
                found["classes"] = self._class_of[found[name]]
        return found

    def _check_seen(self, lookup: Lookup, valid: Tensor) -> None:
        unseen = int(((lookup.view < 0) & valid.reshape(1, -1)).sum())
        if unseen:
            wanted = f"expected {len(lookup.views)} views at {self.position.tolist()} m to see all rays"
            raise MissingCaptureError(f"{wanted}, but {unseen} are seen by none")


def _checked(source: Source, face_size: int | None, device: str | torch.device) -> torch.device:
    """The device, if it and the source serve."""
    found = torch.device(device)
    if found.type == "mps":
        raise ArgumentError("device: expected one with float64, such as cpu or cuda; mps has none")
    if source.capabilities.moves:
        raise ArgumentError("source: expected a world that stands still; record it, and use the recording")
    if face_size is None and source.recorded_views() is None:
        raise ArgumentError("face_size: expected a whole number of pixels for a source that captures anew")
    return found


def _captured(
    source: Source, position: Array, modes: Sequence[str], options: RenderOptions
) -> dict[str, tuple[tuple[View, ...], list[NDArray[Any]]]]:
    """By mode the views that came, and their pixels."""
    chosen = modalities.chosen(modes)
    # Of all cameras alike: whole cubes are captured.
    camera = create("equirectangular", width=4, height=2)
    task = Renderer(source).task(camera, Pose(position, np.eye(3)), options)
    ((_, came),) = captured(next(rounds(task)), source, chosen)
    return {
        mode: (tuple(each.view for each in captures), [np.asarray(each.pixels) for each in captures])
        for mode, captures in came.items()
    }


def _labels(masks: NDArray[Any], objects: ObjectTable) -> NDArray[np.uint16]:
    """(V, h, w) labels of masks, colours or instance ids."""
    return labels_of_ids(masks, objects)[0] if masks.ndim == 3 else labels_of(masks, objects)[0]


def _class_of(rules: ClassRules, objects: ObjectTable) -> Tensor:
    """(65536,) int64, the class of each label."""
    names = objects.names()
    label_of = {name: label for label, name in enumerate(names, start=1)}
    return torch.from_numpy(rules.table(names).ids(label_of).astype(np.int64))


def _shaped(values: Tensor, valid: Tensor, outside: float) -> Tensor:
    """(B, N) or (B, N, C) values as pictures, channels first; whole numbers of maps as int64."""
    batch, size = len(values), tuple(valid.shape)
    if values.ndim == 3:
        values = values.reshape(batch, *size, -1).movedim(-1, 1).contiguous()
    elif values.dtype.is_floating_point:
        values = values.reshape(batch, 1, *size)
    else:
        values = values.reshape(batch, *size).long()
    return torch.where(valid, values, outside) if outside else values
