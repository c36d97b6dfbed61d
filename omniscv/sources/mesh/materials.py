"""What faces show: colours, pictures on them, holes by alpha; and the colours of points by a kernel."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from omniscv.compiled import fields, njit
from omniscv.geometry import Array

REPEAT = 0
CLAMP = 1
MIRROR = 2
"""What a picture shows beyond its border."""
LINEAR = np.array([c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in np.arange(256) / 255])
"""Light of the 256 codes of sRGB (IEC 61966-2-1)."""

CODES_BELOW = (LINEAR[1:] + LINEAR[:-1]) / 2
"""Light between two codes: the code of light is its place among these."""


@dataclass(frozen=True, eq=False)
class Texture:
    """A picture on faces.

    Attributes:
        pixels: (H, W, 4) uint8, sRGB and alpha.
        wrap: beyond its border, across and down.
        nearest: whether a point has the colour of its pixel, not one between pixels.
    """

    pixels: NDArray[np.uint8]
    wrap: tuple[int, int] = (REPEAT, REPEAT)
    nearest: bool = False


@dataclass(frozen=True, eq=False)
class Material:
    """What a face shows.

    Attributes:
        name: as in the file.
        color: linear RGBA.
        texture: that the colour is multiplied by, or None.
        cutoff: alpha below which the face has a hole; 0 for none.
        blended: whether the file wants alpha to be blended.
        double_sided: whether it is seen from behind, too.
        unlit: whether no lamp changes it.
    """

    name: str = ""
    color: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    texture: Texture | None = None
    cutoff: float = 0.0
    blended: bool = False
    double_sided: bool = True
    unlit: bool = False


@fields("uint8[:, ::1], int64[:, ::1], float32[:, ::1], int64[::1], float64[::1], float64[::1]")
class Palette(NamedTuple):
    """All materials, in arrays for a kernel.

    Attributes:
        pixels: (P, 4) of all pictures, row by row.
        pictures: (T, 6): first row, width, height, both wraps, nearest.
        color: (K, 4) linear RGBA of each material.
        picture: (K,) number of its picture, -1 for none.
        cutoff: (K,) alpha below which it has holes.
        linear: (256,) light of codes.
    """

    pixels: NDArray[np.uint8]
    pictures: NDArray[np.int64]
    color: NDArray[np.float32]
    picture: NDArray[np.int64]
    cutoff: Array
    linear: Array


def palette(materials: Sequence[Material], cut_blended: bool) -> Palette:
    """Return the arrays of materials; ``cut_blended``: blended ones have holes where alpha is below 1/2."""
    pixels = [np.zeros((1, 4), np.uint8)]
    rows: list[tuple[int, ...]] = []
    numbers: dict[int, int] = {}
    first = 1
    for material in materials:
        texture = material.texture
        if texture is None or id(texture) in numbers:
            continue
        numbers[id(texture)] = len(rows)
        height, width = texture.pixels.shape[:2]
        rows.append((first, width, height, *texture.wrap, texture.nearest))
        pixels.append(texture.pixels.reshape(-1, 4))
        first += width * height
    cutoff = []
    for material in materials:
        is_cut = material.blended and cut_blended
        cutoff.append(0.5 if is_cut else material.cutoff)
    return Palette(
        np.concatenate(pixels),
        np.array(rows or [(0, 1, 1, 0, 0, 0)], np.int64),
        np.array([material.color for material in materials], np.float32),
        np.array([numbers.get(id(material.texture), -1) for material in materials], np.int64),
        np.array(cutoff),
        LINEAR,
    )


@fields("int32[:, ::1], int32[::1], float32[:, ::1], float32[:, ::1]")
class Skin(NamedTuple):
    """What the faces of a model show: its faces, their materials, and ``uv`` and colours of its vertices."""

    faces: NDArray[np.int32]
    material: NDArray[np.int32]
    uv: NDArray[np.float32]
    colors: NDArray[np.float32]


def shades(palette: Palette, skin: Skin, face: NDArray[np.int32], weights: Array) -> NDArray[np.float32]:
    """Return (N, 4) linear RGBA of points on faces; 0 where the number of the ``face`` is negative.

    ``weights`` (N, 2) are those of each face's second and third vertex.
    """
    result = np.zeros((len(face), 4), np.float32)
    _shade(palette, skin, face, weights, result)
    return result


def codes_of_light(light: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return sRGB codes / 255 of light 0 to 1, by 4096 steps of its square root, to 1e-5."""
    root = np.sqrt(np.clip(light, 0, 1)) * (len(_CODES) - 1)
    below = np.minimum(root.astype(np.int32), len(_CODES) - 2)
    fraction = root - below
    return np.asarray(_CODES[below] * (1 - fraction) + _CODES[below + 1] * fraction, np.float32)


_SQUARES = (np.arange(4097) / 4096) ** 2
_CODES = np.where(
    _SQUARES <= 0.0031308, 12.92 * _SQUARES, 1.055 * np.maximum(_SQUARES, 1e-9) ** (1 / 2.4) - 0.055
).astype(np.float32)
"""sRGB codes / 255 of light, by 4096 steps of its square root."""


@njit(nogil=True)
def _wrapped(i: int, size: int, wrap: int) -> int:
    """Return the pixel of a row or column that stands at a place, inside or beyond the border."""
    if wrap == 1:
        return min(max(i, 0), size - 1)
    if wrap == 2:
        i = i % (2 * size)
        return i if i < size else 2 * size - 1 - i
    return i % size


@njit(
    "Palette, Skin, int32[::1], float64[:, ::1], out float32[:, ::1]",
    nogil=True,
    error_model="numpy",
)
def _shade(  # noqa: PLR0915 - a kernel
    palette: Any, skin: Any, face: Any, weights: Any, result: Any
) -> None:
    linear = palette.linear
    for i in range(face.shape[0]):
        if face[i] < 0:
            continue
        a = skin.faces[face[i], 0]
        b = skin.faces[face[i], 1]
        c = skin.faces[face[i], 2]
        wb = weights[i, 0]
        wc = weights[i, 1]
        wa = 1.0 - wb - wc
        k = skin.material[face[i]]
        for j in range(4):
            own = wa * skin.colors[a, j] + wb * skin.colors[b, j] + wc * skin.colors[c, j]
            result[i, j] = own * palette.color[k, j]
        p = palette.picture[k]
        if p < 0:
            continue
        first = palette.pictures[p, 0]
        width = palette.pictures[p, 1]
        height = palette.pictures[p, 2]
        u = (wa * skin.uv[a, 0] + wb * skin.uv[b, 0] + wc * skin.uv[c, 0]) * width
        v = (wa * skin.uv[a, 1] + wb * skin.uv[b, 1] + wc * skin.uv[c, 1]) * height
        if not (abs(u) < 1e9 and abs(v) < 1e9):
            u = 0.0
            v = 0.0
        if palette.pictures[p, 5]:
            u = np.floor(u) + 0.5
            v = np.floor(v) + 0.5
        left = np.floor(u - 0.5)
        top = np.floor(v - 0.5)
        x = u - 0.5 - left
        y = v - 0.5 - top
        x0 = _wrapped(int(left), width, palette.pictures[p, 3])
        x1 = _wrapped(int(left) + 1, width, palette.pictures[p, 3])
        y0 = first + width * _wrapped(int(top), height, palette.pictures[p, 4])
        y1 = first + width * _wrapped(int(top) + 1, height, palette.pictures[p, 4])
        pixels = palette.pixels
        for j in range(4):
            if j < 3:
                upper = linear[pixels[y0 + x0, j]] * (1 - x) + linear[pixels[y0 + x1, j]] * x
                lower = linear[pixels[y1 + x0, j]] * (1 - x) + linear[pixels[y1 + x1, j]] * x
            else:
                upper = (pixels[y0 + x0, j] * (1 - x) + pixels[y0 + x1, j] * x) / 255
                lower = (pixels[y1 + x0, j] * (1 - x) + pixels[y1 + x1, j] * x) / 255
            result[i, j] *= upper * (1 - y) + lower * y
