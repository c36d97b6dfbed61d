"""Non-central images from few optical centres: every ray finds its point in depth captured elsewhere.

Each ray is followed through the depth captured at the nearest centres until one has seen all of its way
(:mod:`omniscv.compose.march`): then colour, label and depth are taken from there. Rays that no centre
vouches for are found, not filled. ``adaptive`` captures more centres where most of those begin, exactly at
the origins of their rays, until almost none is left or more captures hardly help; what is left is marked
unsure and shows the best guess.

Where it fails: objects thinner than a pixel of a capture, which a ray may pass without notice; mirrors, glass
and gloss, whose lit colour depends on the viewpoint; a rim of half a capture's pixel around silhouettes,
where the nearest pixel may show the other side; surfaces seen at a grazing angle by every centre.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.captures.source import Source
from omniscv.captures.view import Capture
from omniscv.compose.grid import Grid
from omniscv.compose.layers import Layers, layers_of
from omniscv.compose.listed import Listed
from omniscv.compose.maps import Maps, filter_for, unit
from omniscv.compose.march import Shell, march, shell
from omniscv.compose.reachable import look_around, reachable
from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.plan import PROBE_MODES, Plan, Station

FILTERS = ("auto", "nearest", "bilinear", "bicubic")
DEFAULT_ERROR_PX = 0.5
_TRIES = 4
"""How many centres, nearest first, a ray is followed through."""
_ENOUGH = 0.003
"""Part of the rays that may stay unsure."""
_MOST_ROUNDS = 5
_MOST_AT_ONCE = 8
_NEIGHBOURHOODS = 128
_FAR = 1e6  # metres: where the direction to a point of the sky is the ray's own
_WORTH = 100
"""Rays that a new centre must promise to resolve: fewer are cheaper left marked."""

Progress = Callable[[int, int], None]


@dataclass(eq=False)
class _Rays:
    """The image's valid rays, in the world, and what is known of each."""

    pixels: NDArray[np.int64]
    origins_w: Array
    directions_w: Array
    group: NDArray[np.int64]
    steps: Array
    station: NDArray[np.int64]
    reach: Array
    sure: NDArray[np.bool_]
    error_px: Array


@dataclass(eq=False)
class _Seen:
    """What was captured at a centre."""

    station: Station
    shell: Shell
    captures: dict[str, list[Capture]]


def reproject(
    plan: Plan,
    source: Source,
    modes: Sequence[str],
    *,
    max_error_px: float = DEFAULT_ERROR_PX,
    filter: str = "auto",
    progress: Progress | None = None,
) -> Layers:
    """The layers of an image whose plan has few centres.

    Args:
        plan: world-aligned faces at each centre; if it can be extended, it is.
        source: where captures come from.
        modes: which layers; depth is captured in any case.
        max_error_px: rays whose predicted error is larger are unsure.
        filter: for lit: nearest, bilinear, bicubic or auto, which is bilinear.
        progress: called with (captures done, captures known to be needed).

    Returns:
        The layers, with ``unsure``.

    Raises:
        ArgumentError: a filter that this strategy has not, or a bound that is not positive.
        SourceError, RecordError: a capture could not be had.
    """
    if filter not in FILTERS:
        raise ArgumentError(f"filter: expected one of {', '.join(FILTERS)} to reproject; got {filter!r}")
    if not max_error_px > 0:
        raise ArgumentError(f"max_error_px: expected a number of pixels > 0, got {max_error_px!r}")
    grid = Grid(plan.camera)
    rays = _rays_of(plan, grid)
    open_air = np.ones(len(rays.pixels), np.bool_)
    if plan.probe is not None:
        taken = plan.probe.by_mode(PROBE_MODES, iter(source.capture(plan.probe.requests(PROBE_MODES))))
        open_air = reachable(look_around(plan, taken), rays.origins_w)
    asked = tuple(dict.fromkeys((*modes, "depth")))
    seen: list[_Seen] = []
    waiting: list[Station] = list(plan.stations)
    for _ in range(_MOST_ROUNDS):
        first = len(seen)
        for each in _captured(source, waiting, asked, len(seen), progress):
            seen.append(each)
        _follow(rays, seen, first, max_error_px)
        waiting = [] if plan.more is None else [plan.more(center_w) for center_w in _wanted(rays)]
        if not waiting:
            break
    rays.sure &= open_air
    return _composed(plan, source, modes, grid, rays, seen, "bilinear" if filter == "auto" else filter)


def _rays_of(plan: Plan, grid: Grid) -> _Rays:
    pixels = np.flatnonzero(grid.valid)
    rays = plan.camera.unproject()
    own = plan.camera.viewpoints()
    count = len(pixels)
    return _Rays(
        pixels,
        plan.pose.to_world(rays.origins.reshape(-1, 3)[pixels]),
        rays.directions.reshape(-1, 3)[pixels] @ plan.pose.R_w_c.T,
        own.index.ravel()[pixels].astype(np.int64),
        grid.steps.ravel()[pixels].astype(np.float64),
        np.full(count, -1),
        np.full(count, np.nan),
        np.zeros(count, np.bool_),
        np.full(count, np.inf),
    )


def _captured(
    source: Source, stations: Sequence[Station], modes: Sequence[str], before: int, progress: Progress | None
) -> Iterator[_Seen]:
    captures = source.capture(request for station in stations for request in station.requests(modes))
    for number, station in enumerate(stations, start=1):
        found = station.by_mode(modes, captures)
        views = tuple(capture.view for capture in found["depth"])
        planes = [capture.pixels for capture in found["depth"]]
        yield _Seen(station, shell(station.center_w, views, planes), found)
        if progress:
            progress(before + number, before + len(stations))


def _follow(rays: _Rays, seen: Sequence[_Seen], first: int, max_error_px: float) -> None:
    """Follows unsure rays through the nearest centres; those before ``first`` were tried already."""
    centers = np.array([each.shell.center_w for each in seen])
    unsure = np.flatnonzero(~rays.sure)
    away = ((rays.origins_w[unsure, None] - centers) ** 2).sum(axis=-1)
    nearest = np.argsort(away, axis=1, kind="stable")[:, :_TRIES]
    for rank in range(nearest.shape[1]):
        for number in range(first, len(seen)):
            mine = unsure[(nearest[:, rank] == number) & ~rays.sure[unsure]]
            if len(mine):
                _try(rays, mine, number, seen[number].shell, max_error_px)


def _try(rays: _Rays, mine: NDArray[np.int64], number: int, seen: Shell, max_error_px: float) -> None:
    reach, sure, error = march(seen, rays.origins_w[mine], rays.directions_w[mine])
    with np.errstate(divide="ignore", invalid="ignore"):
        error_px = np.where(error > 0, error / rays.steps[mine], 0.0)
    sure &= error_px <= max_error_px
    # A guess is better than none, and the nearer centre's is better than a farther one's.
    better = sure | (np.isnan(rays.reach[mine]) & ~np.isnan(reach))
    chosen = mine[better]
    rays.reach[chosen], rays.station[chosen] = reach[better], number
    rays.sure[chosen], rays.error_px[chosen] = sure[better], error_px[better]


def _wanted(rays: _Rays) -> list[Array]:
    """Where to capture next: origins of rays whose neighbourhoods hold the most unsure ones."""
    unsure = ~rays.sure
    if unsure.mean() <= _ENOUGH:
        return []
    groups = int(rays.group.max()) + 1
    reach = max(1, groups // _NEIGHBOURHOODS)
    count = np.bincount(rays.group[unsure], minlength=groups).astype(np.float64)
    around = np.convolve(count, np.ones(2 * reach + 1), "same")
    own = np.full(groups, -1)
    own[rays.group] = np.arange(len(rays.group))
    wanted: list[Array] = []
    while len(wanted) < _MOST_AT_ONCE and around.max() >= _WORTH:
        best = int(np.argmax(around))
        wanted.append(rays.origins_w[own[best]])
        around[max(0, best - 2 * reach) : best + 2 * reach + 1] = 0
    return wanted


def _composed(
    plan: Plan,
    source: Source,
    modes: Sequence[str],
    grid: Grid,
    rays: _Rays,
    seen: Sequence[_Seen],
    filter: str,
) -> Layers:
    """Takes every ray's values from the centre that it was followed through."""
    flat: dict[str, NDArray[Any]] = {}
    for number, each in enumerate(seen):
        mine = np.flatnonzero(rays.station == number)
        if not len(mine):
            continue
        met = np.where(np.isfinite(rays.reach[mine]), rays.reach[mine], _FAR)[:, None]
        toward = rays.origins_w[mine] + met * rays.directions_w[mine] - each.shell.center_w
        listed = Listed(toward)
        maps: Maps | None = None
        for mode in modes:
            if mode == "depth":
                continue
            faces = [capture.pixels for capture in each.captures[mode]]
            views = tuple(capture.view for capture in each.captures[mode])
            if maps is None or maps.views != views:  # masks may come from elsewhere than colours
                maps = Maps(listed, Listed.none, np.eye(3), views, listed.all)
            values = maps.sample(filter_for(mode, filter), faces)
            values = unit(values) if mode == "normal" else values
            if mode not in flat:
                flat[mode] = np.zeros((grid.valid.size, *values.shape[1:]), values.dtype)
            flat[mode][rays.pixels[mine]] = values
    if "depth" in modes:
        flat["depth"] = np.zeros(grid.valid.size, np.float32)
        flat["depth"][rays.pixels] = np.nan_to_num(rays.reach, nan=0.0, posinf=np.inf)
    shape = grid.valid.shape
    centers_w, unsure = np.zeros((grid.valid.size, 3)), np.zeros(grid.valid.size, np.bool_)
    centers_w[rays.pixels], unsure[rays.pixels] = rays.origins_w, ~rays.sure
    return layers_of(
        plan,
        source,
        grid.valid,
        {mode: values.reshape(*shape, *values.shape[1:]) for mode, values in flat.items()},
        centers_w.reshape(*shape, 3),
        seen[0].captures["depth"][0].provenance if seen else {},
        unsure.reshape(shape),
    )
