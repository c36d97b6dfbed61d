"""The layers of an image while they are filled, one viewpoint after another."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv import modalities
from omniscv.compose.ray_bundle import ImageRays
from omniscv.compose.samplers import SAMPLE, Sampler
from omniscv.geometry import Array
from omniscv.planning import Viewpoint


class Canvas:
    """Flat layers of an image.

    Args:
        rays: of the image.
        whole: whether one viewpoint serves all of it, so that layers need no copy.
    """

    def __init__(self, rays: ImageRays, whole: bool) -> None:
        self._rays, self.whole = rays, whole
        self._flat: dict[str, NDArray[Any]] = {}
        self._unsure: NDArray[np.bool_] | None = None
        self._centers_w: Array = np.zeros(3) if whole else np.zeros((rays.valid.size, 3))

    def add_viewpoint(self, viewpoint: Viewpoint, origins_w: Array | None) -> None:
        """Take what a viewpoint knows of its pixels without captures, and (N, 3) the origins of their depth,
        its centre if None."""
        if self.whole:
            self._centers_w = viewpoint.center_w
        else:
            self._centers_w[viewpoint.pixels] = viewpoint.center_w if origins_w is None else origins_w
        if viewpoint.unsure is not None:
            if self._unsure is None:
                self._unsure = np.zeros(self._rays.valid.size, np.bool_)
            self._unsure[viewpoint.pixels] = viewpoint.unsure
        if viewpoint.depth is not None:
            self._layer("depth", viewpoint.depth)[viewpoint.pixels] = viewpoint.depth

    def sample(
        self, mode: str, viewpoint: Viewpoint, sampler: Sampler, filter: str, faces: Sequence[NDArray[Any]]
    ) -> None:
        """Sample a mode along the rays of a viewpoint."""
        values = SAMPLE[modalities.get(mode).interpolation](sampler, filter, faces)
        if self.whole:
            self._flat[mode] = values
        else:
            self._layer(mode, values)[viewpoint.pixels] = values

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

    @property
    def unsure(self) -> NDArray[np.bool_] | None:
        """(H, W) pixels that no capture verified; None where no viewpoint was judged."""
        return None if self._unsure is None else self._unsure.reshape(self._rays.valid.shape)

    def _layer(self, mode: str, like: NDArray[Any]) -> NDArray[Any]:
        if mode not in self._flat:
            self._flat[mode] = np.zeros((self._rays.valid.size, *like.shape[1:]), like.dtype)
        return self._flat[mode]
