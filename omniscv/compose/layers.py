"""What composition makes: the layers of an image."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.captures.source import ObjectTable, Source
from omniscv.compose.labels import labels_of
from omniscv.geometry import Array
from omniscv.plan import Plan

Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Layers:
    """The layers of an image; those that were not asked for are None.

    Attributes:
        valid: (H, W) bool, the pixel is inside the field of view.
        centers_w: (H, W, 3) or (3,), where depth is measured from, world frame, metres.
        lit: (H, W, 3), as captured: uint8 RGB from servers.
        object_mask: (H, W, 3) uint8 RGB, only colours that were captured.
        labels: (H, W) uint16, 0 where nothing is known.
        depth: (H, W) float32 metres along the ray; +inf no surface, 0 outside the field of view.
        normals: (H, W, 3) float32 unit vectors, camera frame; 0 where unknown.
        unsure: (H, W) bool, pixels whose optical centre is not in the open as seen from the camera's
            position (:mod:`omniscv.compose.reachable`), or that a strategy with few centres could not verify;
            None for a single centre, or where a record cannot tell.
        unknown_colors: mask colours that no object has, and on how many pixels.
        objects: names and mask colours.
        provenance: where the captures came from.
    """

    valid: Mask
    centers_w: Array
    lit: NDArray[Any] | None = None
    object_mask: NDArray[np.uint8] | None = None
    labels: NDArray[np.uint16] | None = None
    depth: NDArray[np.float32] | None = None
    normals: NDArray[np.float32] | None = None
    unsure: Mask | None = None
    unknown_colors: dict[tuple[int, int, int], int] = field(default_factory=dict)
    objects: ObjectTable | None = None
    provenance: dict[str, Any] = field(default_factory=dict)


def layers_of(
    plan: Plan,
    source: Source,
    valid: Mask,
    images: dict[str, NDArray[Any]],
    centers_w: Array,
    provenance: dict[str, Any],
    unsure: Mask | None = None,
) -> Layers:
    """The layers of what was sampled.

    Args:
        plan: whose camera and pose.
        source: asked for its objects, where there are masks.
        valid: (H, W).
        images: mode to (H, W, ...); normals in the world frame.
        centers_w: as in :class:`Layers`.
        provenance: of one capture.
        unsure: (H, W) as in :class:`Layers`.
    """
    labels, objects = None, None
    unknown: dict[tuple[int, int, int], int] = {}
    if (mask := images.get("object_mask")) is not None:
        objects = source.objects()
        labels, unknown = labels_of(mask, objects)
        labels[~valid] = 0
    normals = images.get("normal")
    if normals is not None:
        normals = (normals @ plan.pose.R_w_c).astype(np.float32)
    return Layers(
        valid=valid,
        centers_w=centers_w,
        lit=images.get("lit"),
        object_mask=mask,
        labels=labels,
        depth=images.get("depth"),
        normals=normals,
        unknown_colors=unknown,
        objects=objects,
        provenance=provenance,
        unsure=unsure,
    )
