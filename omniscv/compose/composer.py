"""From a plan's captures to the layers of an image, one optical centre at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.cameras import Camera
from omniscv.captures.source import Source
from omniscv.captures.view import Capture, View
from omniscv.compose.grid import Grid, averaged
from omniscv.compose.layers import Layers, layers_of
from omniscv.compose.maps import Maps, filter_for, unit
from omniscv.compose.reachable import look_around, reachable
from omniscv.errors import ArgumentError, BadReply, MissingCapture
from omniscv.plan import PROBE_MODES, Plan, Station

FILTERS = ("auto", "nearest", "bilinear", "bicubic", "area")

Progress = Callable[[int, int], None]


class Composer:
    """Composes images, and keeps rays and maps from one to the next."""

    def __init__(self) -> None:
        self._camera: Camera | None = None
        self._grid: Grid | None = None
        self._finer: Grid | None = None
        self._maps: tuple[NDArray[np.float64], Maps] | None = None

    def compose(
        self,
        plan: Plan,
        source: Source,
        modes: Sequence[str],
        *,
        filter: str = "auto",
        progress: Progress | None = None,
    ) -> Layers:
        """The layers of a plan's image.

        Args:
            plan: the views and the pixels that they serve.
            source: where captures come from.
            modes: which layers; object_mask brings labels.
            filter: for lit, one of ``nearest``, ``bilinear``, ``bicubic``, ``area`` (averages what a pixel
                spans) or ``auto``: area where most pixels span two of a view's or more, else bilinear.
                Masks are never blended; depth is interpolated on surfaces unless ``nearest``.
            progress: called with (captures done, captures in all).

        Raises:
            ArgumentError: an unknown filter.
            BadReply: the captures of one centre differ in size or type.
            MissingCapture: a view that came does not see the rays it should.
            SourceError, RecordError: a capture could not be had.
        """
        if filter not in FILTERS:
            raise ArgumentError(f"filter: expected one of {', '.join(FILTERS)}; got {filter!r}")
        grid = self._grid_of(plan.camera)
        whole = len(plan.stations) == 1
        if filter == "auto" and "lit" in modes and plan.stations:
            filter = self._chosen(plan, whole)
        canvas = _Canvas(grid, self._finer_grid, whole, filter)
        captures = source.capture(plan.requests(modes))
        around = None
        if plan.probe is not None:
            around = look_around(plan, plan.probe.by_mode(PROBE_MODES, captures))
        done, provenance = 0, {}
        for station in plan.stations:
            if around is not None and not reachable(around, station.center_w[None])[0]:
                canvas.unsure[station.pixels] = True
            maps: Maps | None = None
            for mode, faces in station.by_mode(modes, captures).items():
                _same_kind(faces)
                views = tuple(capture.view for capture in faces)
                if maps is None or maps.views != views:
                    maps = self._maps_of(plan, station, views, whole)
                canvas.add(mode, station, maps, faces)
                provenance = faces[0].provenance
                done += len(faces)
            if progress:
                progress(done, len(plan) * len(modes))
        if canvas.centers_w is None:
            centers_w = plan.stations[0].center_w
        else:
            centers_w = canvas.centers_w.reshape(*grid.valid.shape, 3)
        unsure = None if plan.probe is None else canvas.unsure.reshape(grid.valid.shape)
        return layers_of(plan, source, grid.valid, canvas.images(), centers_w, provenance, unsure)

    def _chosen(self, plan: Plan, whole: bool) -> str:
        """The filter for lit, one for the whole image: what its middle station asks for."""
        station = plan.stations[len(plan.stations) // 2]
        return "area" if self._maps_of(plan, station, station.views, whole).minifies else "bilinear"

    def _grid_of(self, camera: Camera) -> Grid:
        if self._grid is None or self._camera != camera:
            self._camera, self._grid, self._finer, self._maps = camera, Grid(camera), None, None
        return self._grid

    def _finer_grid(self) -> Grid:
        assert self._camera is not None
        if self._finer is None:
            self._finer = Grid(self._camera, fine=True)
        return self._finer

    def _maps_of(self, plan: Plan, station: Station, views: tuple[View, ...], whole: bool) -> Maps:
        """The maps of a station, kept from the image before where it has one and nothing changed.

        Positions do not count: the same orientation and views around another centre have the same map.
        """
        assert self._grid is not None
        kept = self._maps if whole else None
        if kept is not None and np.array_equal(kept[0], plan.pose.R_w_c) and _alike(kept[1].views, views):
            maps = kept[1]
        else:
            pixels = None if whole else station.pixels
            maps = Maps(self._grid, self._finer_grid, plan.pose.R_w_c, views, pixels)
            self._maps = (plan.pose.R_w_c, maps) if whole else None
        if maps.unseen:
            raise MissingCapture(
                f"expected {len(views)} views at {station.center_w.round(4).tolist()} m to see all "
                f"{len(station.pixels)} rays, but {maps.unseen} are seen by none; {_advice(station, views)}"
            )
        return maps


class _Canvas:
    """The layers while they are filled, one optical centre after another."""

    def __init__(self, grid: Grid, finer: Callable[[], Grid], whole: bool, filter: str) -> None:
        self._grid, self._finer, self._whole, self._filter = grid, finer, whole, filter
        self._flat: dict[str, NDArray[Any]] = {}
        self._averaged: dict[str, NDArray[np.bool_]] = {}
        self.centers_w = None if whole else np.zeros((grid.valid.size, 3))
        self.unsure = np.zeros(grid.valid.size, np.bool_)

    def add(self, mode: str, station: Station, maps: Maps, faces: Sequence[Capture]) -> None:
        """Samples a mode along the rays of a station."""
        if self.centers_w is not None:
            self.centers_w[station.pixels] = station.center_w
        pixels, filter = [face.pixels for face in faces], self._filter
        if mode == "depth":
            values = maps.sample_depth(pixels, nearest=filter == "nearest")
        else:
            chosen = filter_for(mode, filter)
            values = maps.sample(chosen, pixels)
            if mode == "normal":
                values = unit(values)
            elif chosen == "area":
                finer = self._finer()
                seen = self._averaged.setdefault(mode, np.zeros(finer.valid.size, dtype=bool))
                self._put(mode, finer, station, values)
                seen[self._rays_of(finer, station)] = maps.finer_places.view >= 0
                return
        self._put(mode, self._grid, station, values)

    def images(self) -> dict[str, NDArray[Any]]:
        """The layers, (H, W, ...)."""
        images = {}
        for mode, values in self._flat.items():
            shape = (self._finer() if mode in self._averaged else self._grid).valid.shape
            image = values.reshape(*shape, *values.shape[1:])
            if mode in self._averaged:
                image = averaged(image, self._averaged[mode].reshape(shape))
            images[mode] = image
        return images

    def _rays_of(self, grid: Grid, station: Station) -> Any:
        return slice(None) if self._whole else grid.pixels(station.pixels, self._grid.valid.shape[1])

    def _put(self, mode: str, grid: Grid, station: Station, values: NDArray[Any]) -> None:
        if self._whole:
            self._flat[mode] = values
            return
        if mode not in self._flat:
            self._flat[mode] = np.zeros((grid.valid.size, *values.shape[1:]), values.dtype)
        self._flat[mode][self._rays_of(grid, station)] = values


def _advice(station: Station, views: Sequence[View]) -> str:
    """What to do where views miss rays."""
    asked, came = station.views[0], views[0]
    if (asked.fov_deg, asked.width, asked.height) == (came.fov_deg, came.width, came.height):
        return "capture with strategy 'cube'"
    return (
        f"they came as {came.width} x {came.height} of {came.fov_deg:g} degrees; object masks of plugin "
        "0.3.10 are the game's window: start it with a square one of 90 degrees"
    )


def _alike(a: Sequence[View], b: Sequence[View]) -> bool:
    """Whether views differ in nothing but their position."""
    return len(a) == len(b) and all(
        x.key()[:2] + x.key()[5:] == y.key()[:2] + y.key()[5:] for x, y in zip(a, b, strict=True)
    )


def _same_kind(faces: Sequence[Capture]) -> None:
    kinds = {(face.pixels.shape, face.pixels.dtype.name) for face in faces}
    if len(kinds) != 1:
        raise BadReply(f"expected captures of one size and type at a centre, got {sorted(kinds)}")
