"""Two predictions of the same images: paired differences, with intervals by scene.

Images of one scene are alike, so scenes are drawn, not images: a bootstrap draws as many scenes as there are,
each as often as it comes, and takes the mean of all images of those. Source: Efron and Tibshirani, An
introduction to the bootstrap, 1993; Field and Welsh, Bootstrapping clustered data, 2007.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.geometry.arrays import Ints
from omniscv.score.running import WEIGHTS, Scored

DRAWS = 2000
"""Draws of scenes."""
_SEED = 7
_SHARE = 0.95  # of draws, that lie in the interval


class Difference(NamedTuple):
    """The mean difference of a measure, the second prediction's less the first's.

    Attributes:
        weights: ``by_pixel`` or ``by_solid_angle``.
        measure: its name.
        mean: over images.
        low, high: within which 95 % of the draws of scenes lie; None for one scene.
        scenes: that were drawn from.
    """

    weights: str
    measure: str
    mean: float
    low: float | None
    high: float | None
    scenes: int

    @property
    def interval(self) -> str:
        """The interval for people."""
        if self.low is None or self.high is None:
            return "one scene: unknown"
        return f"[{self.low:+.4g}, {self.high:+.4g}]"

    @property
    def is_clear(self) -> bool:
        """Whether the interval leaves out 0."""
        return self.low is not None and self.high is not None and self.low * self.high > 0


def differences(first: Sequence[Scored], second: Sequence[Scored]) -> list[Difference]:
    """Return the differences of all measures between two predictions of the same images.

    Args:
        first: the scores of one prediction.
        second: those of the other one, of the same images in any order.

    Raises:
        ArgumentError: other images, or other measures.
    """
    others = {item.name: item for item in second}
    if sorted(others) != sorted(item.name for item in first):
        raise ArgumentError("predictions: expected two of the same images, got those of different ones")
    scenes, index = np.unique([item.scene for item in first], return_inverse=True)
    counts = _drawn(len(scenes))
    rows = []
    for weights in WEIGHTS:
        for measure in first[0].figures(weights):
            values = []
            for item in first:
                values.append(others[item.name].figures(weights)[measure] - item.figures(weights)[measure])
            low, high = _interval(np.array(values), index, counts)
            rows.append(Difference(weights, measure, float(np.mean(values)), low, high, len(scenes)))
    return rows


def _interval(values: Array, index: Ints, counts: Array) -> tuple[float | None, float | None]:
    """Return the ends of the interval of a mean of values (N,) of images; None for one scene.

    Args:
        values: (N,) of images.
        index: (N,) of their scenes.
        counts: (draws, scenes) how often each scene is drawn.
    """
    if counts.shape[1] == 1:
        return None, None
    means = counts @ np.bincount(index, values) / (counts @ np.bincount(index))
    low, high = np.quantile(means, ((1 - _SHARE) / 2, (1 + _SHARE) / 2))
    return float(low), float(high)


def _drawn(count: int) -> Array:
    """Return (draws, scenes) how often each scene is drawn, by a fixed seed."""
    rng = np.random.default_rng(_SEED)
    return rng.multinomial(count, np.full(count, 1 / count), DRAWS).astype(np.float64)
