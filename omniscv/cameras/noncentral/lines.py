"""Cameras that read their image line by line, each line from an optical centre of its own."""

import numpy as np

from omniscv.arguments import whole_number
from omniscv.cameras.base import Array, Mask, Viewpoints


def viewpoints_by_line(origins: Array, valid: Mask, axis: int, count: int | None) -> Viewpoints:
    """Return one centre per line of an image, or at most ``count`` for equal numbers of lines.

    A shared centre is the mean of its lines' own (least squares; a single line's is exact). Where all centres
    are the same, one suffices; centres that no valid pixel has are left out.

    Args:
        origins: (L, 3) the lines' centres, camera frame, metres.
        valid: (H, W) of the image.
        axis: 0 where lines are rows, 1 where they are columns.
        count: centres at most, or None.
    """
    lines = len(origins)
    count = whole_number("count", lines if count is None else count, "viewpoints")
    groups = 1 if (origins == origins[0]).all() else min(count, lines)
    group = np.arange(lines) * groups // lines
    first = np.searchsorted(group, np.arange(groups))
    centers = np.add.reduceat(origins, first) / np.bincount(group)[:, None]
    if groups == 1 and count == lines:
        centers = origins[:1]
    used, group = np.unique(np.where(valid.any(axis=1 - axis), group, -1), return_inverse=True)
    kept = used[used >= 0]
    line = np.expand_dims(group - (len(used) - len(kept)), 1 - axis)
    return Viewpoints(centers[kept], np.where(valid, line, -1).astype(np.int32))
