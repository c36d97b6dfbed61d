"""``boxes3d``: boxes in space of every object that is seen. ``STEM.truth.json``."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from omniscv.dataset.truths import Observation, Truth, no_options, register
from omniscv.geometry.scene_geometry import ObjectBox
from omniscv.truth.oriented_boxes import boxes3d, from_points


def derive(observation: Observation, options: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the records of :func:`omniscv.truth.boxes3d.boxes3d`: of boxes that the source knows, else of
    the points that are seen, where the image has depth; there are no options."""
    no_options(options)
    image, labels = observation.image, observation.seen()
    seen = set(np.flatnonzero(np.bincount(labels.ravel())).tolist())
    names = {name: each for name, each in observation.instances.items() if each in seen}
    known = observation.geometry.boxes
    unknown = {name: each for name, each in names.items() if name not in known}
    found = _from_depth(observation, unknown) if unknown and image.depth is not None else {}
    return boxes3d({**known, **found}, image.camera, image.pose, names, observation.classes)


def _from_depth(observation: Observation, names: Mapping[str, int]) -> dict[str, ObjectBox]:
    image = observation.image
    depth = np.asarray(image.depth, dtype=np.float64)
    doubtful = [image.layers[each] for each in ("label_edge", "unsure") if each in image.layers]
    kept = np.isfinite(depth) & (depth > 0) & ~np.any([np.zeros(depth.shape, bool), *doubtful], axis=0)
    directions_w = image.camera.unproject().directions @ image.pose.R_w_c.T
    points_w = image.centers_w + np.where(kept, depth, 0.0)[..., None] * directions_w
    return from_points(points_w, observation.seen(), kept, names)


register(Truth("boxes3d", derive, needs=("object_mask",), check_options=no_options))
