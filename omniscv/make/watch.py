"""Find objects that a live world has left out of an image, as games do now and then.

An object is suspected if no pixel shows it, although the rays of some enter its box before they meet a
surface. It may be thin, or fill its box in part. So masks are captured again, and only an object that is seen
then was left out.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from omniscv.compose.image import OmniImage
from omniscv.geometry.scene_geometry import ObjectBox
from omniscv.truth.object_boxes import visible_ids
from omniscv.truth.registry import Observation

_LEAST_PX = 4  # of an object: fewer pixels may miss it
_LOOKS = 2  # an object may be left out of the second captures, too


def left_out(seen: Observation, look: Callable[[], set[str]]) -> tuple[str, ...]:
    """Return the names of objects that an image should show.

    Args:
        seen: an image with labels and depth, and the boxes of objects.
        look: returns the names of the objects that new captures show.
    """
    assert seen.labels is not None
    shown, found = visible_ids(seen.labels), set[str]()
    unseen = {
        name: box for name, box in seen.geometry.boxes.items() if seen.instances.get(name, 0) not in shown
    }
    suspects = _entered(seen.image, unseen)
    for _ in range(_LOOKS):
        if suspects - found:
            found |= suspects & look()
    return tuple(sorted(found))


def _entered(image: OmniImage, boxes: dict[str, ObjectBox]) -> set[str]:
    """Return the boxes that rays of at least 4 pixels enter before they meet a surface."""
    rays, pose, depth = image.camera.unproject(image.camera.pixels()), image.pose, image.depth
    assert depth is not None
    usable = rays.valid & (depth > 0)
    directions_w = rays.directions[usable] @ pose.R_w_c.T
    origins_w = np.broadcast_to(rays.origins, rays.directions.shape)[usable] @ pose.R_w_c.T + pose.position
    met, names = depth[usable], set[str]()
    for name, box in boxes.items():
        away_w, radius = box.center_w - origins_w, np.linalg.norm(box.size) / 2
        along = np.einsum("ij,ij->i", away_w, directions_w)
        near = np.flatnonzero((away_w**2).sum(axis=1) - np.maximum(along, 0) ** 2 <= radius**2)
        origins, directions = -away_w[near] @ box.R_w_b, directions_w[near] @ box.R_w_b
        with np.errstate(divide="ignore", invalid="ignore"):
            sides = np.stack([(sign * box.size / 2 - origins) / directions for sign in (-1, 1)])
        enters = np.maximum(np.nanmax(sides.min(axis=0), axis=1, initial=0), 0)
        leaves = np.nanmin(sides.max(axis=0), axis=1, initial=np.inf)
        if np.count_nonzero(enters <= np.minimum(leaves, met[near])) >= _LEAST_PX:
            names.add(name)
    return names
