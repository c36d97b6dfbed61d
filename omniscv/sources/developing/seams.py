"""Seams between the six faces of a cube: measured, explained by gains, and closed.

Engines compute bloom, reflections and exposure for each picture alone. Exposure multiplies light, so gains
are estimated in its logarithm, robustly, and count only where they explain the steps. What is left is closed
by a membrane: the smoothest correction that removes the steps, falls off within a tenth of a face and stops
at outlines. Faces with overscan fade into each other instead. Both are cosmetic: colours become continuous,
not truer.

Sources: M. Brown, D. G. Lowe, IJCV 74, 2007 (gains); M. J. Black, A. Rangarajan, IJCV 19, 1996 (graduated
non-convexity); P. Perez et al., "Poisson image editing", 2003, and Z. Farbman et al., 2009 (membranes).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from omniscv.geometry import Array
from omniscv.light import decode, encode, light_of_codes
from omniscv.sources.base import View
from omniscv.sources.developing.cube import Cube, Edge
from omniscv.sources.developing.slips import shifts_of

_BLOCKS = 64  # of an edge, for gains
_CODES = (10, 245)  # beyond, pictures are too dark, or clipped
_SCALES = (1.0, 0.3, 0.1, 0.05, 0.03, 0.02)  # of residuals of gains, lowered step by step
_PRIOR = 0.02 / 0.5  # noise of a block by the spread of gains
# Gains are applied:
_EXPLAINED = 0.3  # if they explain more than this share of the steps
_GAIN = 0.01  # if a gain differs from 1 by more
_GAINS = (0.25, 4.0)  # if all lie between these
# Faces are of several places or instants if texture moves:
_FEWEST_EDGES = 4  # on so many edges
_MOST_SHIFT_PX = 2.0  # by more
_FEWEST_OF_FACE = 2  # edges that show a face's gain
_CLIPPED = 1e-3  # share of the pixels
_SPARSE = 4  # one of so many pixels tells how large changes are
_SAMPLES = 128  # of an overlap, along an edge
_RESIDUAL = 0.03  # of the logarithm, counts as unexplained

_CELLS = 64  # of the membrane, along a face
_REACH = 0.1  # face widths within which a correction falls to 1/e
_OUTLINE = 12.0  # levels between cells at which a correction stops
_COUPLING = 20.0
_SURE = 1.5  # steps within so many of their standard errors are texture
# What the cells leave of a step is
_SMOOTH_PX = 8  # smoothed along the edge, and
_FADE_PX = 16  # faded out into the face.
_OVERLAP = 1 / 32  # of a face beyond each side, from which faces fade into each other


class Gains(NamedTuple):
    """Factors of light that bring faces together.

    ``vignette`` is (a, b) of the logarithm ``-a r^2 - b r^4`` of light, which fits the laws of engines and of
    lenses; ``r^2`` is 2 in the corners of pictures. Overscan shows it, or several places together.
    """

    gains: Array  # (6,) of mean 1 (geometric): multiply light by them
    explained: float  # share of the steps that they explain, 0 to 1
    proven: bool  # whether they explain enough to be applied, and change anything
    vignette: tuple[float, float] = (0.0, 0.0)

    @property
    def lost(self) -> float:
        """The share of light that is lost in the corners."""
        return 1 - float(np.exp(-2 * self.vignette[0] - 4 * self.vignette[1]))


def estimate_gains(cube: Cube, transfer: str) -> Gains:
    """Return the gains of the faces of a ``cube``, by a robust fit to the logarithms of light along edges.

    ``transfer`` is what its codes say of light.
    """
    rows = []
    differences = []
    for edge in cube.edges:
        a, b = cube.at_edge(edge)
        usable = np.all((np.minimum(a, b) > _CODES[0]) & (np.maximum(a, b) < _CODES[1]), axis=-1)
        usable &= cube.continuous(edge)
        light_a = light_of_codes(np.clip(a, 1, 255), transfer)
        light_b = light_of_codes(np.clip(b, 1, 255), transfer)
        ratio = np.log(light_a / light_b).mean(axis=-1)
        for block in np.array_split(np.arange(len(ratio)), min(_BLOCKS, len(ratio))):
            ratios = ratio[block[usable[block]]]
            if ratios.size:
                rows.append((edge.a, edge.b))
                differences.append(float(np.median(ratios)))
    return _fit(np.array(rows), np.array(differences), np.zeros((len(rows), 2)))


def estimate_in_overlap(views: Sequence[View], pixels: NDArray[np.uint8], transfer: str) -> Gains:
    """Return gains and vignette of faces wider than 90 degrees, by rays that two of them see.

    Args:
        views: of the six faces.
        pixels: (6, h, h, 3) of them.
        transfer: what their codes say of light.
    """
    rows = []
    differences = []
    squared_radii = []
    every = max(1, pixels.shape[1] // _SAMPLES)
    samples = np.s_[::every, ::every]
    radii = _squared_radii(pixels.shape[1])
    for a, b, band, at_px, weight in _overlaps(views):
        at = np.rint(at_px[samples]).astype(int)
        here = pixels[a][band][samples]
        x, y = np.moveaxis(np.clip(at, 0, pixels.shape[1] - 1), -1, 0)
        there = pixels[b][y, x]
        clear = (np.minimum(here, there) > _CODES[0]) & (np.maximum(here, there) < _CODES[1])
        usable = (weight[samples] > 0) & clear.all(axis=-1)
        ratio = np.log(light_of_codes(here[usable], transfer) / light_of_codes(there[usable], transfer))
        differences.append(ratio.mean(axis=-1))
        rows.append(np.broadcast_to((a, b), (usable.sum(), 2)))
        squared_radii.append(np.stack([radii[band][samples][usable], radii[y, x][usable]], axis=1))
    return _fit(np.concatenate(rows), np.concatenate(differences), np.concatenate(squared_radii))


def _fit(index: NDArray[Any], y: Array, squared_radii: Array) -> Gains:
    """Gains and vignette that explain ``y``, (n,) logarithms of light of faces ``index`` (n, 2)."""
    pairs = np.unique(index, axis=0) if len(y) else np.zeros((0, 2), int)
    if np.bincount(pairs.ravel(), minlength=6).min() < _FEWEST_OF_FACE:
        return Gains(np.ones(6), 0.0, False)
    J = np.zeros((len(y), 8))
    x = np.zeros(8)
    J[np.arange(len(y)), index[:, 0]] = 1
    J[np.arange(len(y)), index[:, 1]] = -1
    J[:, 6] = squared_radii[:, 0] - squared_radii[:, 1]
    J[:, 7] = squared_radii[:, 0] ** 2 - squared_radii[:, 1] ** 2
    prior = np.eye(8) * _PRIOR**2 * len(y) / 12
    for scale in _SCALES:
        for _ in range(5):
            off = y + J @ x
            weighted = J * (1 / (1 + (off / scale) ** 2) ** 2)[:, None]
            x -= np.linalg.solve(weighted.T @ J + prior, weighted.T @ off + prior @ x)
    before = _unexplained(y)
    explained = float(1 - _unexplained(y + J @ x) / before) if before > 0 else 0.0
    gains = Gains(np.exp(x[:6] - x[:6].mean()), explained, False, (float(x[6]), float(x[7])))
    changes = max(np.abs(gains.gains - 1).max(), abs(gains.lost)) > _GAIN
    return gains._replace(proven=bool(explained > _EXPLAINED and changes))


def _unexplained(residuals: Array) -> float:
    """Return the number of residuals that count as unexplained; smaller ones count in part."""
    return float(np.minimum((residuals / _RESIDUAL) ** 2, 1).sum())


def _squared_radii(size: int) -> Array:
    """(size, size) squared distances from the middle of a picture, 2 in its corners."""
    x = (2 * np.arange(size) + 1) / size - 1
    return np.asarray(x[None] ** 2 + x[:, None] ** 2)


def apply_gains(pixels: NDArray[np.uint8], gains: Gains, transfer: str) -> NDArray[np.uint8]:
    """Return ``pixels`` (6, s, s, 3) without vignette, their light times ``gains``, lowered if many clip.

    ``transfer`` is what the codes say of light.
    """
    squared_radii = _squared_radii(pixels.shape[1])[..., None]
    factor = np.exp(gains.vignette[0] * squared_radii + gains.vignette[1] * squared_radii**2)
    light = decode(pixels, transfer) * (gains.gains[:, None, None, None] * factor).astype(np.float32)
    white = decode(np.full(1, 255, np.uint8), transfer)[0]
    if (light > white).mean() > _CLIPPED:
        light /= gains.gains.max()
    return encode(light, transfer)


@dataclass(frozen=True, eq=False)
class Mended:
    """Colours of one place, (h, w, 3) each, whose faces agree at their edges.

    ``relit`` (h, w) uint8 is 255 where the colour changed; ``report`` is for the image's JSON: steps across
    edges before and after, gains, changes, or why it was refused.
    """

    pixels: tuple[NDArray[Any], ...]
    relit: tuple[NDArray[np.uint8], ...]
    report: dict[str, Any]


def mend(
    views: Sequence[View],
    pixels: Sequence[NDArray[Any]],
    method: str,
    transfer: str,
    masks: Sequence[NDArray[Any]] = (),
    vignette: tuple[float, float] | None = None,
) -> Mended:
    """Return the colours of one place, with gains or closed where it is a cube; else as captured.

    Args:
        views, pixels: of one centre; (h, w, 3) of each.
        method: ``gains`` or ``close``.
        transfer: of the colours; gains need to know it.
        masks: of the objects in each view, whose outlines are no seams.
        vignette: of the camera, as :class:`Gains` has it, for faces without overscan, which do not show it.
    """
    cube = Cube.of(views, pixels, masks)
    if cube is None:
        return _refused(pixels, "expected six 8-bit faces of a cube")
    shifts = np.abs([*shifts_of(cube).values()])
    if len(shifts) >= _FEWEST_EDGES and np.median(shifts) > _MOST_SHIFT_PX:
        moved = f"texture that moves by {np.median(shifts):.1f} px at edges"
        return _refused(pixels, f"expected faces of one place and instant, got {moved}")
    colors = np.stack(pixels)
    gains = _gains_of(cube, views, colors, transfer, vignette)
    in_range = _GAINS[0] < gains.gains.min() and gains.gains.max() < _GAINS[1]
    report: dict[str, Any] = {"steps": _in_numbers(cube.steps()), "explained": gains.explained}
    removed_vignette = False
    if gains.proven and in_range and transfer != "unknown":
        colors = apply_gains(colors, gains, transfer)
        report |= {"gains": gains.gains.round(4).tolist(), "vignette": round(gains.lost, 4)}
        removed_vignette = abs(gains.lost) > _GAIN
    elif method == "gains":
        why = f"gains explain {gains.explained:.2f} of the steps, transfer {transfer}"
        return _refused(pixels, why, report)
    if method == "close":
        if _is_wide(cube):
            report["faded_px"] = cube.border
            colors = cross_fade(views, colors)
        else:
            colors = _with_closed_seams(cube, colors)
    steps = cube.recolored(colors).steps()
    # A vignette has no step at an edge, so removing one need not make steps smaller.
    if not removed_vignette and np.abs(steps).mean() > np.abs(cube.steps()).mean():
        return _refused(pixels, "expected smaller steps, got larger ones", report)
    return _mended(pixels, colors, {**report, "steps_after": _in_numbers(steps)})


def _mended(pixels: Sequence[NDArray[Any]], colors: NDArray[np.uint8], report: dict[str, Any]) -> Mended:
    """Return mended colours (6, h, h, 3) with what has changed of the pixels as captured."""
    change = np.abs(colors.astype(np.int16) - np.stack(pixels))
    report["mean_change"] = float(change.mean())
    report["change_p99"] = float(np.quantile(change[:, ::_SPARSE, ::_SPARSE], 0.99))
    colors.flags.writeable = False
    relit = np.where(change.any(axis=-1), np.uint8(255), np.uint8(0))
    return Mended(tuple(colors), tuple(relit), report)


def _is_wide(cube: Cube) -> bool:
    """Return whether faces were captured with enough overscan to fade into each other."""
    return bool(cube.border >= _OVERLAP * cube.pixels.shape[1])


def _gains_of(
    cube: Cube,
    views: Sequence[View],
    colors: NDArray[np.uint8],
    transfer: str,
    vignette: tuple[float, float] | None,
) -> Gains:
    """Return the gains of faces (6, h, h, 3), with the camera's vignette where they do not show it."""
    if _is_wide(cube):
        return estimate_in_overlap(views, colors, transfer)
    gains = estimate_gains(cube, transfer)
    if not vignette:
        return gains
    factors = gains.gains if gains.proven else np.ones(6)
    return gains._replace(gains=factors, vignette=vignette, proven=True)


def _with_closed_seams(cube: Cube, colors: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return (6, h, h, 3) colours of a cube whose seams are closed; its border changes as the edges do."""
    inner = cube.recolored(colors)
    change = close(inner) - inner.pixels.astype(np.int16)
    border = (cube.border, cube.border)
    wide = np.pad(change, ((0, 0), border, border, (0, 0)), mode="edge")
    return np.asarray(np.clip(colors + wide, 0, 255), np.uint8)


def _refused(pixels: Sequence[NDArray[Any]], why: str, report: dict[str, Any] | None = None) -> Mended:
    relit = tuple(np.zeros(picture.shape[:2], np.uint8) for picture in pixels)
    return Mended(tuple(pixels), relit, {**(report or {}), "refused": why})


def _in_numbers(steps: Array) -> dict[str, float]:
    """Median, 90th percentile and largest of steps, levels."""
    return {
        "median": float(np.median(steps)),
        "p90": float(np.quantile(steps, 0.9)),
        "worst": float(steps.max()),
    }


def close(cube: Cube) -> NDArray[np.uint8]:
    """Return (6, s, s, 3) pixels whose seams are closed by a membrane on the cube, in codes."""
    import cv2

    size = cube.pixels.shape[1]
    cells = min(_CELLS, size)
    smooth = []
    for face in _membrane(cube, cells):
        smooth.append(cv2.resize(face, (size, size), interpolation=cv2.INTER_LINEAR))
    corrected = cube.pixels + np.stack(smooth)
    fade = np.clip(1 - np.arange(min(_FADE_PX, size // 2)) / _FADE_PX, 0, 1)[:, None, None] ** 2
    left = np.zeros_like(corrected)
    for edge in cube.edges:
        half = _left_over(corrected, edge, cube.continuous(edge)) / 2
        np.rot90(left[edge.a], edge.side_a)[: len(fade)] -= fade * half
        np.rot90(left[edge.b], edge.side_b)[: len(fade)] += fade * half[::-1]
    return np.asarray(np.clip(np.rint(corrected + left), 0, 255), np.uint8)


def cross_fade(views: Sequence[View], pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return ``pixels`` (6, h, h, 3) of six ``views`` wider than 90 degrees that fade into each other."""
    import cv2

    half = views[0].width / 2
    focal = views[0].focal_px
    x = np.abs(np.arange(views[0].width, dtype=np.float32) + np.float32(0.5 - half)) / np.float32(focal)
    own = half / focal - np.maximum(x[None], x[:, None])
    total = np.tile(own, (6, 1, 1))
    light = own[..., None] * pixels
    for face, other, band, at_px, weight in _overlaps(views):
        seen = cv2.remap(pixels[other], at_px, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        total[face][band] += weight
        light[face][band] += weight[..., None] * seen
    faded = pixels.copy()
    shared = total > own
    faded[shared] = np.rint(light[shared] / total[shared][:, None])
    return faded


def _overlaps(
    views: Sequence[View],
) -> Iterator[tuple[int, int, tuple[Any, ...], NDArray[Any], NDArray[Any]]]:
    """Yield a face and one beside it, and of the band (rows, columns) that both show the other's px (h, w, 2)
    and its weight (h, w), 0 at its border.
    """
    half = views[0].width / 2
    focal = views[0].focal_px
    reach = half / focal
    x = ((np.arange(views[0].width) + 0.5 - half) / focal).astype(np.float32)
    rays = np.stack([*np.meshgrid(x, x), np.ones((len(x), len(x)), np.float32)], axis=-1)
    for (a, here), (b, there) in permutations(enumerate(views), 2):
        R_there_here = (there.pose.R_w_c.T @ here.pose.R_w_c).astype(np.float32)
        side = R_there_here[2]  # the other's optical axis
        if abs(side[2]) > 0.5:
            continue  # the face behind
        beyond = rays @ side > 1 / reach
        band = np.ix_(beyond.any(axis=1), beyond.any(axis=0))
        toward = rays[band] @ R_there_here.T
        at = toward[..., :2] / toward[..., 2:]
        yield a, b, band, at * focal + half - 0.5, np.maximum(reach - np.abs(at).max(axis=-1), 0)


def _membrane(cube: Cube, cells: int) -> NDArray[np.float32]:
    """(6, cells, cells, 3) the correction of least ``w |grad u|^2 + m (u_a - u_b + D)^2 + u^2 / l^2``."""
    index = np.arange(6 * cells * cells).reshape(6, cells, cells)
    pairs, weights = _within_faces(cube, index)
    pull = np.zeros((index.size, 3))
    for edge in cube.edges:
        a = np.rot90(index[edge.a], edge.side_a)[0]
        b = np.rot90(index[edge.b], edge.side_b)[0][::-1]
        step, share = _steps_of_cells(cube, edge, cells)
        pairs.append(np.stack([a, b]))
        weights.append(_COUPLING * share)
        np.add.at(pull, a, -_COUPLING * share[:, None] * step)
        np.add.at(pull, b, _COUPLING * share[:, None] * step)
    membrane = _solve(np.concatenate(pairs, axis=1), np.concatenate(weights), pull, cells)
    return np.asarray(membrane, np.float32).reshape(6, cells, cells, 3)


def _within_faces(
    cube: Cube, index: NDArray[np.int64]
) -> tuple[list[NDArray[np.int64]], list[NDArray[np.float64]]]:
    """Return pairs (2, n) of cells that are neighbours in a face, across and down, and their weights (n,).

    ``index`` (6, cells, cells) are the numbers of the cells.
    """
    import cv2

    cells = index.shape[1]
    means = np.zeros((*index.shape, 3), np.float32)
    for face, pixels in enumerate(cube.pixels):
        size = (cells, cells)
        means[face] = cv2.resize(pixels.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    middles = ((np.arange(cells) + 0.5) * cube.pixels.shape[1] / cells).astype(int)
    labels = cube.labels[:, middles[:, None], middles]
    pairs = []
    weights = []
    for axis in (1, 2):
        first = np.take(index, np.arange(cells - 1), axis=axis).ravel()
        second = np.take(index, np.arange(1, cells), axis=axis).ravel()
        change = np.abs(np.diff(means, axis=axis)).max(axis=-1).ravel()
        is_one_object = np.diff(labels, axis=axis).ravel() == 0
        pairs.append(np.stack([first, second]))
        weights.append(is_one_object / (1 + (change / _OUTLINE) ** 2))
    return pairs, weights


def _solve(pairs: NDArray[np.int64], weights: Array, pull: Array, cells: int) -> Array:
    """Return (N, 3) the membrane of N cells: pairs (2, n) with their weights (n,), pulled by (N, 3)."""
    from scipy.sparse import coo_array, csc_array, diags_array
    from scipy.sparse.linalg import splu

    i, j = pairs
    off = coo_array((-weights, (i, j)), (len(pull), len(pull))).tocsr()
    off = off + off.T
    diagonal = -off.sum(axis=1) + 1 / (_REACH * cells) ** 2
    matrix = csc_array(off + diags_array(diagonal))
    factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    return np.asarray(factors.solve(pull))


def _steps_of_cells(cube: Cube, edge: Edge, cells: int) -> tuple[Array, Array]:
    """(cells, 3) median step a - b, 0 where it is no more than texture; (cells,) share without outlines."""
    a, b = cube.at_edge(edge)
    clear = cube.continuous(edge)
    counts = np.zeros(cells)
    medians = np.zeros((cells, 3))
    spread = np.zeros((cells, 3))
    for cell, block in enumerate(np.array_split(np.arange(len(a)), cells)):
        steps = (a - b)[block[clear[block]]]
        counts[cell] = len(steps)
        if len(steps):
            medians[cell] = np.median(steps, axis=0)
            spread[cell] = np.median(np.abs(steps - medians[cell]), axis=0)
    lines_a, lines_b = cube.lines(edge)
    beside = np.maximum(np.abs(lines_a[0] - lines_a[1]), np.abs(lines_b[0] - lines_b[1]))
    inside = np.array([np.median(block, axis=0) for block in np.array_split(beside, cells)])
    error = 1.4826 * spread * np.sqrt(np.pi / 2 / np.maximum(counts, 1))[:, None] + inside / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        sure = np.where(medians == 0, 0, np.maximum(0, 1 - (_SURE * error / medians) ** 2))
    return np.asarray(medians * sure), counts * cells / len(a)


def _left_over(corrected: NDArray[Any], edge: Edge, continuous: NDArray[np.bool_]) -> Array:
    """(s, 3) what is left of the step a - b, smoothed along the edge; in the order of a; 0 at outlines."""
    import cv2

    a = np.rot90(corrected[edge.a], edge.side_a)
    b = np.rot90(corrected[edge.b], edge.side_b)[:, ::-1]
    step = ((1.5 * a[0] - 0.5 * a[1]) - (1.5 * b[0] - 0.5 * b[1])) * continuous[:, None]
    smooth = cv2.blur(step[None], (_SMOOTH_PX, 1), borderType=cv2.BORDER_REPLICATE)[0]
    return np.asarray(smooth * continuous[:, None])
