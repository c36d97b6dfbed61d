"""Features that are followed from frame to frame: which bearings, of which frames, belong to one point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from omniscv.evaluate.odometry.adjustment import Observations
from omniscv.evaluate.odometry.features import Features, match
from omniscv.evaluate.odometry.two_views import relative_pose
from omniscv.geometry import Pose

FEWEST = 15
"""Matches that agree on a motion; with fewer, the frames do not belong together."""


@dataclass(frozen=True, eq=False)
class Tracks:
    """Tracks through the frames 0 to K-1, which are all linked.

    Attributes:
        steps: (K - 1) each frame's pose in the frame before, at distance 1.
        seen: all observations of points that two frames or more see, ordered by frame; ``camera`` is the
            frame, ``point`` the track.
        count: of tracks.
    """

    steps: Sequence[Pose]
    seen: Observations
    count: int


def follow(features: Sequence[Features], limit_rad: float) -> Tracks:
    """Return the tracks of a sequence up to the first frame that does not continue the one before.

    Matches that disagree with the motion between two frames make no track.

    Args:
        features: of each frame, at least one.
        limit_rad: the angle by which a bearing may be off.
    """
    steps: list[Pose] = []
    ids = [np.arange(len(features[0].bearings))]
    count = len(ids[0])
    for before, after in pairwise(features):
        pairs = match(before, after)
        found = relative_pose(before.bearings[pairs[:, 0]], after.bearings[pairs[:, 1]], limit_rad)
        if found is None or np.count_nonzero(found.agree) < FEWEST:
            break
        steps.append(found.T_1_2)
        agreed = pairs[found.agree]
        mine = np.arange(count, count + len(after.bearings))
        mine[agreed[:, 1]] = ids[-1][agreed[:, 0]]
        ids.append(mine)
        count += len(after.bearings)
    return Tracks(steps, *_observations(features, ids))


def _observations(features: Sequence[Features], ids: Sequence[NDArray[np.int64]]) -> tuple[Observations, int]:
    """The observations of tracks with two or more, tracks counted anew."""
    frame = np.concatenate([np.full(len(each), i) for i, each in enumerate(ids)])
    track = np.concatenate(ids)
    bearings = np.concatenate([each.bearings for each in features[: len(ids)]])
    _, track, often = np.unique(track, return_inverse=True, return_counts=True)
    kept = often[track] > 1
    _, track = np.unique(track[kept], return_inverse=True)
    return Observations(frame[kept], track, bearings[kept]), int(track.max(initial=-1)) + 1
