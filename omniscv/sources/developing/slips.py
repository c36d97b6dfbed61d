"""Faults of a cube's faces: a vignette, and faces that are turned by a fraction of a degree.

A vignette makes a crease at the edge of two faces: light falls towards it on both sides. Scenes have none on
average, so it is pooled from several places. Source: Y. Zheng et al., "Single-image vignetting correction",
CVPR 2008. A slip shifts fine texture along the edges of the face; what the rows of one face say is
subtracted, as oblique lines move along an edge, too.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from omniscv.geometry import Array, Pose, pinhole
from omniscv.light import light_of_codes
from omniscv.sources.base import Capture
from omniscv.sources.developing.cube import SIDES, Cube, Edge

POOLED = 16
"""Places of a recording, at most, that show its vignette."""

_CODES = (10, 245)  # beyond, pictures are too dark, or clipped
_DEEP = 1 / 16  # of a face's width: how far beside an edge creases are sampled
_SAMPLED_ROWS = 8  # there
_BLOCKS = 32  # along an edge
# The least loss of light in the corners that is applied:
_LEAST = 0.19  # logarithm
_ERRORS = 5  # in its standard errors
_NOISE = 0.01  # of logarithms of 8-bit codes
_ROUNDS = 20
_PRIOR = 1e-9


def pooled_vignette(cubes: Iterable[Cube], transfer: str) -> tuple[float, float] | None:
    """Return (a, b) of the logarithm ``-a r^2 - b r^4`` of light that cubes of one camera prove, or None.

    Args:
        cubes: of several places.
        transfer: of the colours: what their codes say of light.
    """
    creases = [_creases(cube, transfer) for cube in cubes]
    if not creases:
        return None
    parts = list(map(np.concatenate, zip(*creases, strict=True)))  # of 12 edges, (n, 3)
    fitted = _fitted(np.concatenate(parts))
    without_one = []  # the jackknife: what the other edges say
    for edge in range(len(parts)):
        without_one.append(_fitted(np.concatenate(parts[:edge] + parts[edge + 1 :])))
    corner = np.array((2.0, 4.0))  # r^2 and r^4 there
    lost = fitted @ corner
    left_out = np.array(without_one) @ corner
    error = np.sqrt(11 / 12 * ((left_out - left_out.mean()) ** 2).sum())
    if lost <= max(_LEAST, _ERRORS * error):
        return None
    return float(fitted[0]), float(fitted[1])


def _creases(cube: Cube, transfer: str) -> list[Array]:
    """By edge (n, 3): the mean logarithm of light of both faces beside it, less that on it; r^2 of both."""
    size = cube.pixels.shape[1]
    half = cube.pixels.shape[1] / 2 + cube.border
    deep = max(2, round(_DEEP * size))
    rows = np.unique(np.linspace(1, deep - 1, _SAMPLED_ROWS).astype(int))
    along = np.array_split((np.arange(size) + 0.5 - size / 2) / half, min(_BLOCKS, size))
    y = np.array([block.mean() for block in along])
    on_edge = size / 2 / half
    beside = (size / 2 - rows - 0.5) / half
    radii = np.stack(np.broadcast_arrays(beside[:, None] ** 2 + y**2, on_edge**2 + y**2), axis=-1)
    edges = []
    for edge in cube.edges:
        beside_a, beside_b = cube.lines(edge, deep)
        on_a, on_b = cube.at_edge(edge)
        usable = cube.continuous(edge)
        for codes in (beside_a, beside_b, on_a[None], on_b[None]):
            usable &= ((codes > _CODES[0]) & (codes < _CODES[1])).all(axis=(0, 2))
        light_beside = _log_light(beside_a, transfer)[rows] + _log_light(beside_b, transfer)[rows]
        crease = (light_beside - _log_light(on_a[None], transfer) - _log_light(on_b[None], transfer)) / 2
        usable_blocks = []
        medians = []
        for index, block in enumerate(np.array_split(np.arange(size), len(along))):
            columns = block[usable[block]]
            if len(columns):
                usable_blocks.append(index)
                medians.append(np.median(crease[:, columns], axis=1))
        logarithms = np.array(medians).reshape(len(usable_blocks), len(rows)).T
        parts = [logarithms[..., None], radii[:, usable_blocks]]
        edges.append(np.concatenate(parts, axis=-1).reshape(-1, 3))
    return edges


def _log_light(codes: Array, transfer: str) -> Array:
    """Return (rows, s) the mean logarithm of light of codes (rows, s, 3)."""
    return np.asarray(np.log(light_of_codes(np.clip(codes, 1, 255), transfer)).mean(axis=2))


def _fitted(creases: NDArray[np.float64]) -> Array:
    """Return (a, b) of the creases' logarithms, by least squares that outliers hardly change."""
    y, beside, on_edge = creases.T
    J = np.stack([on_edge - beside, on_edge**2 - beside**2], axis=1)
    x = np.zeros(2)
    for _ in range(_ROUNDS if len(y) else 0):
        off = y - J @ x
        scale = max(_NOISE, 1.4826 * float(np.median(np.abs(off))))
        weighted = J / (1 + (off / scale) ** 2)[:, None] ** 2
        x = np.linalg.solve(weighted.T @ J + _PRIOR * np.eye(2), weighted.T @ y)
    return x


_BLUR_PX = 15  # on both sides: slower changes along an edge are no texture
_BLUR = np.full(2 * _BLUR_PX + 1, 1 / (2 * _BLUR_PX + 1))
_ROWS = 3  # from which the direction of lines is taken
_MOST_SLIP = 1 / 128  # of a face's width
# What shows a shift:
_TEXTURE = 1.0  # levels of texture
_ALIKE = 0.6  # correlation
_SLIP_PX = 0.6  # pictures without anti-aliasing shift texture by half a pixel
_NOISE_PX = 0.1
_REWEIGHTED = 20  # rounds of least squares
_LEAST_TURN = 1e-6  # rad: keeps the weights of turns above 0
_LEAST_PX = 512  # of a face: smaller ones are turned by less than their pixels show
# What proves a turn:
_SLIP_DEG = 0.05  # the least one
_PROVEN = 2  # edges on which it is seen


def straightened(capture: Capture, turn: Array) -> Capture:
    """Return a ``capture`` of a face that is turned, resampled; ground truth takes the nearest pixels.

    ``turn`` is its rotation vector (3,), radians, world frame.
    """
    import cv2
    from scipy.spatial.transform import Rotation  # slow to load

    view = capture.view
    R_w_c = capture.view.pose.R_w_c
    shown = replace(view, pose=Pose(np.zeros(3), Rotation.from_rotvec(turn).as_matrix() @ R_w_c))
    pixels = np.stack(np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5), axis=-1)
    rays_w = pinhole.rays(pixels, view.projection) @ R_w_c.T
    uv = shown.project(rays_w.reshape(-1, 3))[:, :2].reshape(pixels.shape).astype(np.float32) - 0.5
    filter_ = cv2.INTER_CUBIC if capture.mode == "lit" else cv2.INTER_NEAREST
    straight = cv2.remap(capture.pixels, uv, None, filter_, borderMode=cv2.BORDER_REPLICATE)
    straight.flags.writeable = False
    return replace(capture, pixels=straight, payload=None)


def proven_turns(cube: Cube) -> dict[int, Array]:
    """Return rotation vectors, world frame, radians, of faces of 512 px whose turn two edges prove."""
    if cube.pixels.shape[1] < _LEAST_PX:
        return {}
    turns, edge_counts = turns_of(cube)
    angles_deg = np.degrees(np.linalg.norm(turns, axis=1))
    proven = {}
    for face in range(6):
        if angles_deg[face] > _SLIP_DEG and edge_counts[face] >= _PROVEN:
            proven[face] = turns[face]
    return proven


def turns_of(cube: Cube) -> tuple[Array, NDArray[np.int64]]:
    """Return how faces are turned against the others, by the shift of fine texture along their edges.

    (6, 3) rotation vectors, world frame, radians, of few faces; and (6,) on how many edges each turn is seen.
    """
    known = shifts_of(cube)
    if not known:
        return np.zeros((6, 3)), np.zeros(6, np.int64)
    A = np.zeros((len(known), 6, 3))
    for row, edge in zip(A, known, strict=True):
        view = cube.views[edge.a]
        middle = view.pose.R_w_c @ np.add(SIDES[edge.side_a], (0, 0, 1))
        along = view.pose.R_w_c @ np.cross((0, 0, 1), SIDES[edge.side_a])
        # A face that is turned by w shows a direction d where d - w x d would be.
        row[edge.a] = np.cross(middle, along) * view.focal_px
        row[edge.b] = -row[edge.a]
    y = np.array([*known.values()])
    turns = _few_turns(A, y)
    of_face = (A * turns).sum(axis=2)  # (edges, 6) px that each face's turn explains
    explained = np.abs(of_face.sum(axis=1) - y) < np.abs(y) / 2
    proof = (np.abs(y) > _SLIP_PX) & explained
    return turns, (proof[:, None] & (np.abs(of_face) > np.abs(y)[:, None] / 2)).sum(axis=0)


def shifts_of(cube: Cube) -> dict[Edge, float]:
    """Return by how many px texture is shifted along the edges that show it."""
    shifts = {}
    for edge in cube.edges:
        lines_a, lines_b = cube.lines(edge, _ROWS + 1)
        a = lines_a.mean(axis=-1)
        b = lines_b.mean(axis=-1)
        moved = [_shift_along(a[0], b[0]), _shift_along(a[-1], a[0]), _shift_along(b[0], b[-1])]
        if not np.isnan(moved).any():
            shifts[edge] = moved[0] - (moved[1] + moved[2]) / (2 * _ROWS)
    return shifts


def _shift_along(a: Array, b: Array) -> float:
    """Px by which b (s,) shows the texture of a (s,) farther along; NaN where there is too little."""
    texture_a = _texture(a)
    texture_b = _texture(b)
    most = max(2, round(_MOST_SLIP * len(a)))
    inner = texture_a[most : len(a) - most]
    correlations = []
    for shift in range(-most, most + 1):
        there = texture_b[most + shift : len(a) - most + shift]
        norm = max(np.sqrt((inner**2).sum() * (there**2).sum()), 1e-9)
        correlations.append((inner * there).sum() / norm)
    best = int(np.argmax(correlations))
    if inner.std() < _TEXTURE or correlations[best] < _ALIKE or not 0 < best < 2 * most:
        return float("nan")
    before, here, after = correlations[best - 1 : best + 2]  # of a parabola, whose top is between pixels
    return float(best - most + (before - after) / (2 * (before - 2 * here + after)))


def _texture(line: Array) -> Array:
    """Return (s,) the fast changes along a line (s,)."""
    slow = np.convolve(np.pad(line, _BLUR_PX, "edge"), _BLUR, "valid")[: len(line)]
    return np.asarray(line - slow)


def _few_turns(A: Array, y: Array) -> Array:
    """Return (6, 3) turns of the faces, radians, few of them not 0, that explain the measured shifts.

    The least squares are repeated with weights by the size of each turn, so that small turns vanish.

    Args:
        A: (N, 6, 3) px that a turn of each face by 1 rad about each axis shifts the texture at N edges.
        y: (N,) px, measured.
    """
    flat = A.reshape(len(A), 18)
    x = np.zeros(18)
    weights = np.ones(18)
    noise = _NOISE_PX**2 * np.eye(len(A))
    for _ in range(_REWEIGHTED):
        scaled = flat * weights
        x = weights * (scaled.T @ np.linalg.solve(scaled @ scaled.T + noise, y))
        size = np.linalg.norm(x.reshape(6, 3), axis=1)
        relative = (size + _LEAST_TURN) / (size.max() + _LEAST_TURN)
        weights = np.repeat(np.sqrt(relative), 3)
    return x.reshape(6, 3)
