"""Find objects that a live world has left out of an image, as games do now and then.

An object is suspected if no pixel shows it, although a part of its box is in the image, and nothing is seen
before that part. It may be thin, or fill its box in part. So masks and depth are captured again, and only an
object that is seen then, where nothing was before it at first, was left out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from omniscv.compose.image import OmniImage
from omniscv.geometry.scene_geometry import ObjectBox
from omniscv.truth.object_boxes import surface_w, visible_ids
from omniscv.truth.registry import Observation

_TOUCHING = 0.01  # of its distance: by how much an object may be seen before its box
_SAME = 1e-3  # of its distance: by how much depth may differ from capture to capture
_LOOKS = 3  # an object may be left out of the second captures, too


def left_out(seen: Observation, names: Sequence[str], look: Callable[[], OmniImage]) -> tuple[str, ...]:
    """Return the names of objects that an image should show.

    Args:
        seen: an image with labels and depth, and the boxes of objects.
        names: of the labels 1, 2, 3, ... of the source.
        look: returns the image of new captures, with labels of the source and depth.
    """
    depth = seen.image.depth
    assert seen.labels is not None
    assert depth is not None
    shown, found = visible_ids(seen.labels), set[str]()
    suspects = {
        name
        for name, box in seen.geometry.boxes.items()
        if seen.instances.get(name, 0) not in shown and _unhidden(seen.image, box)
    }
    for _ in range(_LOOKS):
        if suspects - found:
            again = look()
            assert again.labels is not None
            assert again.depth is not None
            clear = np.where(depth >= (1 - _SAME) * again.depth, again.labels, 0)
            found |= suspects & {names[label - 1] for label in visible_ids(clear) - {0}}
    return tuple(sorted(found))


def _unhidden(image: OmniImage, box: ObjectBox) -> bool:
    """Return whether the image shows nothing before some part of a box."""
    assert image.depth is not None
    points_c = image.pose.to_camera(surface_w(box))
    pixels, valid = image.camera.project(points_c)
    columns, rows = np.where(valid[:, None], pixels, 0).astype(int).T
    met = image.depth[rows.clip(max=image.camera.height - 1), columns.clip(max=image.camera.width - 1)]
    return bool((valid & (met > 0) & (met >= (1 - _TOUCHING) * np.linalg.norm(points_c, axis=1))).any())
