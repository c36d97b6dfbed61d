"""The vignette of pictures without overscan, pooled from several places.

A vignette makes no step at the edge of two faces, as both are equally far from their middles there, but a
crease: light falls towards the edge on both sides. Scenes have no crease of their own on average.

Source: Y. Zheng et al., "Single-image vignetting correction", CVPR 2008 (symmetry of radial gradients).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from omniscv.geometry import Array
from omniscv.light import light_of_codes
from omniscv.sources.developing.cube import Cube

POOLED = 16
"""Places of a recording, at most, that show its vignette."""

_CODES = 10, 245  # beyond, pictures are too dark, or clipped
_DEEP, _ROWS, _BLOCKS = 1 / 16, 8, 32  # of a face's width, beside an edge; rows there, and blocks along it
_LEAST, _ERRORS = 0.19, 5  # the least logarithm in the corners that is applied, and in standard errors
_NOISE = 0.01  # of logarithms of 8-bit codes
_ROUNDS, _PRIOR = 20, 1e-9


def pooled_vignette(cubes: Iterable[Cube], transfer: str) -> tuple[float, float] | None:
    """Return (a, b) of the logarithm ``-a r^2 - b r^4`` of light; None where no vignette is proven.

    Args:
        cubes: of one camera.
        transfer: of their colours.
    """
    creases = [_creases(cube, transfer) for cube in cubes]
    if not creases:
        return None
    parts = [np.concatenate(of_edge) for of_edge in zip(*creases, strict=True)]  # of 12 edges, (n, 3)
    fitted = _fitted(np.concatenate(parts))
    without = np.array([_fitted(np.concatenate(parts[:i] + parts[i + 1 :])) for i in range(12)])
    corner = np.array((2.0, 4.0))  # r^2 and r^4 there
    lost, left_out = fitted @ corner, without @ corner
    error = np.sqrt(11 / 12 * ((left_out - left_out.mean()) ** 2).sum())
    return (float(fitted[0]), float(fitted[1])) if lost > max(_LEAST, _ERRORS * error) else None


def _creases(cube: Cube, transfer: str) -> list[Array]:
    """By edge (n, 3): the mean logarithm of light of both faces beside it, less that on it; r^2 of both."""
    size, half = cube.pixels.shape[1], cube.pixels.shape[1] / 2 + cube.border
    deep = max(2, round(_DEEP * size))
    rows = np.unique(np.linspace(1, deep - 1, _ROWS).astype(int))
    along = np.array_split((np.arange(size) + 0.5 - size / 2) / half, min(_BLOCKS, size))
    y = np.array([block.mean() for block in along])
    on_edge, beside = size / 2 / half, (size / 2 - rows - 0.5) / half
    radii = np.stack(np.broadcast_arrays(beside[:, None] ** 2 + y**2, on_edge**2 + y**2), axis=-1)
    edges = []
    for edge in cube.edges:
        both = [*cube.lines(edge, deep), *(line[None] for line in cube.at_edge(edge))]
        usable = np.all([((c > _CODES[0]) & (c < _CODES[1])).all(axis=(0, 2)) for c in both], axis=0)
        usable &= cube.continuous(edge)
        light = [np.log(light_of_codes(np.clip(c, 1, 255), transfer)).mean(axis=2) for c in both]
        crease = (light[0][rows] + light[1][rows] - light[2] - light[3]) / 2
        blocks = np.array_split(np.arange(size), len(along))
        usable_blocks = [i for i, block in enumerate(blocks) if usable[block].any()]
        medians = [np.median(crease[:, blocks[i][usable[blocks[i]]]], axis=1) for i in usable_blocks]
        of_edge = np.array(medians).reshape(len(usable_blocks), len(rows)).T
        edges.append(np.concatenate([of_edge[..., None], radii[:, usable_blocks]], axis=-1).reshape(-1, 3))
    return edges


def _fitted(creases: NDArray[np.float64]) -> Array:
    """Return (a, b) of the creases' logarithms, by least squares that outliers hardly change."""
    y, beside, on_edge = creases.T
    J, x = np.stack([on_edge - beside, on_edge**2 - beside**2], axis=1), np.zeros(2)
    for _ in range(_ROUNDS if len(y) else 0):
        off = y - J @ x
        scale = max(_NOISE, 1.4826 * float(np.median(np.abs(off))))
        weighted = J / (1 + (off / scale) ** 2)[:, None] ** 2
        x = np.linalg.solve(weighted.T @ J + _PRIOR * np.eye(2), weighted.T @ y)
    return x
