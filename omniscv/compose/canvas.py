"""The layers of an image while they are filled, one viewpoint after another."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv import modalities
from omniscv.compose.depth import SampledDepth
from omniscv.compose.kernels import Floats, Mask
from omniscv.compose.ray_bundle import ImageRays
from omniscv.compose.samplers import SAMPLE, Sampler
from omniscv.geometry import Array
from omniscv.planning import FoundDepth, Viewpoint
from omniscv.sources import codecs
from omniscv.sources.base import Capture

_DOUBTFUL = 0.1
"""Of the distance: where depth may be off by more, the label may be anything's."""


class Canvas:
    """Flat layers of an image.

    Args:
        rays: of the image.
        whole: whether one viewpoint serves all of it, so that layers need no copy.
    """

    def __init__(self, rays: ImageRays, whole: bool) -> None:
        self._rays, self.whole = rays, whole
        self._flat: dict[str, NDArray[Any]] = {}
        self._centers_w: Array = np.zeros(3) if whole else np.zeros((rays.valid.size, 3))

    def add_viewpoint(self, viewpoint: Viewpoint, origins_w: Array) -> None:
        """Take what a viewpoint knows of its pixels without captures, and (3,) or (N, 3) where their depth is
        measured from."""
        pixels, found = viewpoint.pixels, viewpoint.found
        if self.whole:
            self._centers_w = viewpoint.center_w
        else:
            self._centers_w[pixels] = origins_w
        if viewpoint.occluded is not None:
            self._layer("occluded", viewpoint.occluded)[pixels] = viewpoint.occluded
        if found is not None:
            known = ("depth", found.distance), ("depth_error", found.error), ("unsure", found.unsure)
            for layer, values in known:
                self._layer(layer, values)[pixels] = values

    def sample_depth(
        self,
        viewpoint: Viewpoint,
        sampler: Sampler,
        filter: str,
        captures: Sequence[Capture],
        offsets_w: Array | None,
    ) -> SampledDepth:
        """Sample depth along the rays of a viewpoint.

        Args:
            viewpoint, sampler, filter: what is sampled, and how.
            captures: of the viewpoint's depth.
            offsets_w: (N, 3) from its centre to the pixels' own, metres; None: they are the same.
        """
        faces, precision = [each.pixels for each in captures], codecs.precision(captures[0].encoding)
        depth = sampler.sample_depth(filter, faces, precision, offsets_w)
        if viewpoint.check is not None:
            unsure = _bound_by(depth, viewpoint.check)
            self._layer("unsure", unsure)[viewpoint.pixels] = unsure
        self._put(captures[0].mode, viewpoint.pixels, depth.distance)
        self._put(modalities.get(captures[0].mode).marked_by, viewpoint.pixels, depth.error)
        return depth

    def sample(
        self, mode: str, viewpoint: Viewpoint, sampler: Sampler, filter: str, faces: Sequence[NDArray[Any]]
    ) -> None:
        """Sample another mode along the rays of a viewpoint."""
        self._put(mode, viewpoint.pixels, SAMPLE[modalities.get(mode).interpolation](sampler, filter, faces))

    def mark_edges(
        self,
        mode: str,
        viewpoint: Viewpoint,
        sampler: Sampler,
        faces: Sequence[NDArray[Any]],
        parallax: Floats | None,
    ) -> None:
        """Mark where a mode's values may be a neighbour's.

        Args:
            mode, viewpoint, sampler, faces: of what was sampled.
            parallax: (N,) radians, how far from its ray a pixel's surface may show; None: nowhere else.
        """
        edges = sampler.label_edges(faces, parallax)
        for known in (viewpoint.found, viewpoint.check):
            if known is not None:
                edges |= known.grazes
        self._put(modalities.get(mode).marked_by, viewpoint.pixels, edges)

    def layers(self) -> dict[str, NDArray[Any]]:
        """Return the layers, (H, W, ...)."""
        valid, found = self._rays.valid, {}
        for mode, values in self._flat.items():
            found[mode] = values.reshape(*valid.shape, *values.shape[1:])
            if outside := modalities.get(mode).outside:
                found[mode][~valid] = outside
        return found

    @property
    def centers_w(self) -> Array:
        """(3,) or (H, W, 3) where depth is measured from, world frame, metres."""
        return self._centers_w if self.whole else self._centers_w.reshape(*self._rays.valid.shape, 3)

    def _put(self, mode: str, where: Any, values: NDArray[Any]) -> None:
        if self.whole:
            self._flat[mode] = values
        else:
            self._layer(mode, values)[where] = values

    def _layer(self, mode: str, like: NDArray[Any]) -> NDArray[Any]:
        if mode not in self._flat:
            self._flat[mode] = np.zeros((self._rays.valid.size, *like.shape[1:]), like.dtype)
        return self._flat[mode]


def _bound_by(depth: SampledDepth, check: FoundDepth) -> Mask:
    """Bound the error of depth from a shared centre by what is known along the pixels' own rays.

    Returns:
        (N,) whether neither says what a ray meets.
    """
    with np.errstate(invalid="ignore"):
        off = np.where(depth.distance == check.distance, 0, np.abs(depth.distance - check.distance))
        agree = off <= depth.error + check.error
    bound, known = off + check.error, np.isfinite(off) & np.isfinite(check.error)
    beside = np.zeros(len(bound), np.bool_) if depth.beside_edge is None else depth.beside_edge
    # What is captured beside an edge may be too thin for the check.
    depth.error[known] = np.where(beside, np.fmax(depth.error, bound), bound)[known]
    if depth.parallax is not None:  # what is met there may show anywhere
        depth.parallax[~agree | ~(depth.error <= _DOUBTFUL * depth.distance)] = np.pi
    return np.asarray(check.unsure & ~agree)
