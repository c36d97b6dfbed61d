"""An omnidirectional image and its ground truth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import Camera
from omniscv.compose import Layers
from omniscv.geometry import Array, Pose


@dataclass(frozen=True, eq=False)
class OmniImage:
    """What :func:`omniscv.render` makes. Layers that were not asked for are None.

    Attributes:
        camera, pose: what was rendered, and from where.
        layers: the layers and where they came from; the commonest are properties of the image.
    """

    camera: Camera
    pose: Pose
    layers: Layers

    @property
    def lit(self) -> NDArray[Any] | None:
        """(H, W, 3) RGB, as captured: uint8 from servers."""
        return self.layers.lit

    @property
    def object_mask(self) -> NDArray[np.uint8] | None:
        """(H, W, 3) uint8 RGB."""
        return self.layers.object_mask

    @property
    def labels(self) -> NDArray[np.uint16] | None:
        """(H, W) uint16; 0 where nothing is known."""
        return self.layers.labels

    @property
    def depth(self) -> NDArray[np.float32] | None:
        """(H, W) float32 metres along the ray; +inf no surface, 0 outside the field of view."""
        return self.layers.depth

    @property
    def normals(self) -> NDArray[np.float32] | None:
        """(H, W, 3) float32 unit vectors, camera frame; 0 where unknown."""
        return self.layers.normals

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(H, W) bool: inside the field of view."""
        return self.layers.valid

    @property
    def unsure(self) -> NDArray[np.bool_] | None:
        """(H, W) bool: not verified by any capture; None where every pixel has a capture of its own."""
        return self.layers.unsure

    def points(self) -> Array:
        """(N, 3) world points, metres, of the pixels with finite depth, row by row.

        Raises:
            ArgumentError: the image has no depth.
        """
        from omniscv.errors import ArgumentError

        if self.depth is None:
            raise ArgumentError(
                "points: expected an image with depth, got none; render with modes=('depth', ...)"
            )
        seen = self.valid & np.isfinite(self.depth) & (self.depth > 0)
        directions_w = self.camera.unproject().directions[seen] @ self.pose.R_w_c.T
        centers_w = np.broadcast_to(self.layers.centers_w, (*seen.shape, 3))[seen]
        return centers_w + self.depth[seen, None].astype(np.float64) * directions_w

    def save(self, out: str | Path, stem: str = "image", image_format: str = "png") -> list[Path]:
        """Writes the layers into a folder; see :mod:`omniscv.output.files`.

        Args:
            out: the folder; made if it is not there.
            stem: start of the file names.
            image_format: ``png``, ``jxl`` (lossless) or ``jpg``, for lit.

        Returns:
            The files, each written whole or not at all.
        """
        from omniscv.output.files import write

        return write(self, Path(out), stem, image_format)
