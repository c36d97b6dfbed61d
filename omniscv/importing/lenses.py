"""The lenses of imported pictures, read by the declared keys of :mod:`omniscv.calibration`, and panoramas."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import number, numbers, shown, within
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose, cube_rotations, pinhole
from omniscv.geometry.arrays import Mask
from omniscv.geometry.precision import STEP
from omniscv.pictures.forms import Pixels
from omniscv.records import mapping
from omniscv.sources.base import Lens, View
from omniscv.storage.bounded import MOST_JSON_BYTES, decode_text, parse_json, read_bytes

_SCALE = 6553.5  # of depth in Replica's cam_params.json
_SAME_SHAPE = 0.01  # of a lens and its picture
_WIDEST = np.tan(np.radians(60))  # half a flat picture: beyond, four pixels show what one has shown
_NARROWEST = 0.01  # half a flat picture that is one
_ROWS = 64  # of a face that are looked up at a time
_PLACES = 32  # of a pixel, that OpenCV tells apart
# The largest flat picture that a lens shows all over:
_SIDE = 33  # points of a side that must be shown
_HALVINGS = 40  # of the search
_NEAR = 1e-4  # tangent near the axis, at which its focal length is taken


Maps = tuple[Pixels, Pixels]
"""Columns and rows of the pixels to take."""


class Pinhole(NamedTuple):
    """Focal lengths and centre in px of a size, pixel centres at .5, and OpenCV's distortion."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: float
    height: float
    distortion: tuple[float, ...] = ()

    @property
    def is_bent(self) -> bool:
        """Whether pictures have distortion."""
        return any(self.distortion)

    def scaled(self, width: int, height: int) -> Pinhole:
        """Return the lens of pictures of ``width`` by ``height`` px; ArgumentError for another shape."""
        across = width / self.width
        down = height / self.height
        if abs(across / down - 1) > _SAME_SHAPE:
            expected = f"expected the shape of {self.width:g} x {self.height:g}, as its lens"
            raise ArgumentError(f"{expected}, got {width} x {height}")
        return Pinhole(
            fx=self.fx * across,
            fy=self.fy * down,
            cx=self.cx * across,
            cy=self.cy * down,
            width=width,
            height=height,
            distortion=self.distortion,
        )

    def view(self, pose: Pose) -> View:
        """Return the view of a picture without distortion."""
        lens = Lens(self.fy / self.fx, self.cx / self.width - 0.5, self.cy / self.height - 0.5)
        fov_deg = pinhole.fov_deg(self.width, self.fx)
        return View(pose, fov_deg, int(self.width), int(self.height), None if lens == Lens() else lens)

    @property
    def flat(self) -> tuple[Maps, Pinhole]:
        """The pixels, as OpenCV counts them, of a picture without distortion that is shown all over; its
        lens."""
        import cv2

        K = np.array([[self.fx, 0, self.cx - 0.5], [0, self.fy, self.cy - 0.5], [0, 0, 1]])
        size = (int(self.width), int(self.height))
        bent = np.array(self.distortion)
        K_new, _ = cv2.getOptimalNewCameraMatrix(K, bent, size, 0)
        maps = cv2.initUndistortRectifyMap(K, bent, None, K_new, size, cv2.CV_32FC1)
        (fx, _, cx), (_, fy, cy) = K_new[:2].tolist()
        return maps, Pinhole(fx, fy, cx + 0.5, cy + 0.5, *size)


FACE = Pinhole(1, 1, 1, 1, 2, 2)
"""Of a face of a cube."""


@dataclass(frozen=True)
class Wide:
    """A lens of another model with one centre, such as a fisheye."""

    camera: Any
    is_bent = True

    def scaled(self, width: int, height: int) -> Wide:
        """Return the lens; ArgumentError for pictures of another size than ``width`` by ``height`` px."""
        if (width, height) != (self.camera.width, self.camera.height):
            expected = f"expected {self.camera.width} x {self.camera.height}, as its lens"
            raise ArgumentError(f"{expected}, got {width} x {height}")
        return self

    @cached_property
    def flat(self) -> tuple[Maps, Pinhole]:
        """The pixels, as OpenCV counts them, of the largest flat picture of at most 120 degrees that is shown
        all over; its lens."""
        size = np.array([self.camera.width, self.camera.height])
        across, down = size / size.max()
        side = np.linspace(-1, 1, _SIDE)
        ends = np.ones(_SIDE)
        x = np.stack([side, -ends, side, ends])
        y = np.stack([-ends, side, ends, side])

        def is_shown(reach: float) -> bool:
            points = np.stack([x * across * reach, y * down * reach, np.ones_like(x)], axis=-1)
            return bool(self.camera.project(points)[1].all())

        low = 0.0
        high = _WIDEST
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            if is_shown(middle):
                low = middle
            else:
                high = middle
        near = self.camera.project([[_NEAR, 0, 1], [-_NEAR, 0, 1], [0, _NEAR, 1], [0, -_NEAR, 1]])[0]
        focal = max(float(near[0, 0] - near[1, 0]), float(near[2, 1] - near[3, 1])) / (2 * _NEAR)
        if not (low > _NARROWEST and focal > 0):
            raise ArgumentError(f"expected a lens that looks ahead, got {self.camera!r}")
        width = 2 * max(1, int(low * focal * across))
        height = 2 * max(1, int(low * focal * down))
        x, y = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(height) + 0.5 - height / 2)
        pixels, _ = self.camera.project(np.stack([x / focal, y / focal, np.ones_like(x)], axis=-1))
        u, v = np.moveaxis((pixels - 0.5).astype(np.float32), -1, 0)
        return (u, v), Pinhole(focal, focal, width / 2, height / 2, width, height)


def straight(
    pixels: Pixels, lens: Pinhole | Wide, mode: str, step_m: float | Pixels = 0.0
) -> tuple[Pixels, Pinhole]:
    """Return the flat picture of a bent one, sampled as by :func:`to_faces`, and its lens.

    Args:
        pixels: of the bent picture: colours, masks, or depth along the ray.
        lens: of it.
        mode: ``lit``, ``object_mask`` or ``depth``.
        step_m: between two numbers that depth was stored in, of all or (H, W); 0 of float32.
    """
    maps, flat = lens.flat
    layers = []
    for layer, filter_ in _layers(pixels, mode, step_m, 1 / flat.fx, _beyond):
        layers.append(_remap(layer, filter_, maps))
    return _of_layers(layers, mode), flat


def of_values(
    values: Mapping[str, Any], form: str, size: tuple[int, int], shift_px: float | None = None
) -> Pinhole | Wide | None:
    """Return the lens of values that a file of a form of :func:`omniscv.calibration.formats` would hold.

    None for a panorama.

    Args:
        values: of the file.
        form: its name.
        size: width and height of the picture, px, where the values have none.
        shift_px: added to the centre to make it ours; None for that of the form.
    """
    from omniscv.calibration.files import read_values  # slow to load

    return _lens(read_values(values, form, size, shift_px))


def of_keys(name: str, value: object, size: tuple[int, int]) -> Pinhole | Wide:
    """Return the lens of keys of a layout; ``centers`` is where the first pixel has its centre.

    Args:
        name: of the keys, for messages.
        value: a mapping with them.
        size: width and height of the picture, px.
    """
    values = mapping(name, value)
    center = number(f"{name}.centers", values.pop("centers", 0.5))
    if center not in (0, 0.5):
        raise ArgumentError(f"{name}.centers: expected 0.5 or 0, got {center:g}")
    lens = of_values(values, "intrinsics", size, 0.5 - center)
    assert lens is not None  # the form has none
    return lens


def of_layout(value: Any, folder: Path, size: tuple[int, int]) -> tuple[Pinhole | Wide, Array]:
    """Return the lens of the key ``intrinsics`` of a layout, and its centre (3,) in the frame of its poses.

    Args:
        value: of the key. ``file`` names JSON with fx, fy, cx and cy, or a text of a matrix, in the line that
            starts with ``row``.
        folder: of the pictures; the file is there or in the folder around it.
        size: width and height of the pictures, px.
    """
    values = mapping("intrinsics", value)
    name = values.pop("file", "")
    if name == "":
        return of_keys("intrinsics", values, size), np.zeros(3)
    row = values.pop("row", "")
    center = values.pop("centers", 0.5)
    file = folder / name
    above = folder.absolute().parent / name
    if not file.exists() and above.exists():
        file = above
    with within(file.name):
        content = read_bytes(file, MOST_JSON_BYTES)
        if file.suffix == ".json":
            projection, size = _matrix_of_json(parse_json(content), size)
        else:
            projection = _matrix_of_text(decode_text(content, "replace"), row)
        keys = {
            "fx": float(projection[0, 0]),
            "fy": float(projection[1, 1]),
            "cx": float(projection[0, 2]),
            "cy": float(projection[1, 2]),
            "centers": float(center),
        }
        lens = of_keys("intrinsics", keys, size)
        return lens, np.asarray(-np.linalg.solve(projection[:, :3], projection[:, 3]))


def _matrix_of_json(data: Any, size: tuple[int, int]) -> tuple[Array, tuple[int, int]]:
    """Return the projection (3, 4) of a lens at the origin, and its size, px, where the JSON has that."""
    data = data.get("camera", data)
    if data.get("scale", _SCALE) != _SCALE:
        raise ArgumentError(f"scale: expected {_SCALE:g} of a metre, got {shown(data['scale'])}")
    size = (int(data.get("w", size[0])), int(data.get("h", size[1])))
    projection = np.array([[data["fx"], 0, data["cx"], 0], [0, data["fy"], data["cy"], 0], [0, 0, 1, 0]])
    return projection, size


def _matrix_of_text(content: str, row: str) -> Array:
    """Return the projection (3, 4) of 9, 12 or 16 numbers, in the lines of a text that start with ``row``."""
    words: list[str] = []
    for line in content.splitlines():
        if line.startswith(row):
            words += line.removeprefix(row).split()
    projection = numbers("matrix", [number(row or "matrix", word) for word in words], (None,))
    if projection.size == 9:
        return np.column_stack([projection.reshape(3, 3), np.zeros(3)])
    return projection.reshape(-1, 4)[:3]


def of_file(file: Path, size: tuple[int, int]) -> Pinhole | Wide | None:
    """Return the lens of a lens file of any form, for pictures of a size; None for a panorama."""
    from omniscv.calibration import load  # slow to load

    with within("intrinsics"):
        try:
            cameras = load(file)
        except ArgumentError:  # it does not hold the size, or is wrong
            cameras = load(file, size=size)
        if len(cameras) != 1:
            raise ArgumentError(f"{file}: expected a file of one camera, got {shown([*cameras])}")
        return _lens(next(iter(cameras.values())))


def _lens(camera: Any) -> Pinhole | Wide | None:
    if camera.name == "equirectangular":
        return None
    if not camera.central:
        raise ArgumentError(f"expected a lens with one centre, got {camera.name}")
    if camera.name != "pinhole" or camera.skew or camera.fov_deg is not None:
        return Wide(camera)
    terms = camera.distortion.tolist()
    count = next(count for count in (0, 5, 8, 12) if not any(terms[count:]))
    return Pinhole(
        fx=camera.fx,
        fy=camera.fy,
        cx=camera.cx,
        cy=camera.cy,
        width=camera.width,
        height=camera.height,
        distortion=tuple(terms[:count]),
    )


def to_faces(
    picture: Pixels, mode: str, of_openexr: int = 0, step_m: float | Pixels = 0.0
) -> Iterator[tuple[Pixels, Array, float]]:
    """Yield six faces of a panorama (H, W, ...), twice as fine as its equator: pixels, rotation (3, 3), and
    degrees.

    Colours are bilinear, and so is 1 / distance between four pixels of one surface. Masks, and distances
    beside an edge, are the nearest pixel's. Depth of faces is (h, w, 2): planar, and how far the distance may
    be off.

    Args:
        picture: colours, masks, or depth along the ray.
        mode: ``lit``, ``object_mask`` or ``depth``.
        of_openexr: 1 if the first and the last column show one meridian, of OpenEXR's axes; else 0.
        step_m: between two numbers that depth was stored in, of all or (H, W); 0 of float32.
    """

    height, width = picture.shape[:2]
    edge = width // 2
    layers = _layers(picture, mode, step_m, 2 * np.pi / width, _around)
    for _, R_w_c in cube_rotations():
        faces = [np.empty((edge, edge, *layer.shape[2:]), layer.dtype) for layer, _ in layers]
        for first in range(0, edge, _ROWS):
            rows = slice(first, min(first + _ROWS, edge))
            pixels = np.stack(np.meshgrid(np.arange(edge) + 0.5, np.arange(edge)[rows] + 0.5), axis=-1)
            rays = pinhole.rays(pixels, pinhole.Projection(*4 * [edge / 2]))
            x, y, z = np.moveaxis(rays @ R_w_c.T, -1, 0)
            u = 0.5 - np.arctan2(y, x) / (2 * np.pi)
            v = np.arctan2(np.hypot(x, y), z) / np.pi
            # Columns: centres at +0.5; OpenEXR's first and last are the same meridian.
            u_px = u * (width - 1) if of_openexr else u * width - 0.5
            v_px = v * (height - 1) if of_openexr else v * height - 0.5
            for face, (layer, filter_) in zip(faces, layers, strict=True):
                face[rows] = _remap(layer, filter_, (u_px, v_px))
        pixels = _of_layers(faces, mode)
        if mode == "depth":
            pixels[..., 0] /= View(Pose(np.zeros(3), R_w_c), 90, edge, edge).ray_lengths()
        yield pixels, R_w_c, 90.0


def _layers(
    picture: Pixels,
    mode: str,
    step_m: float | Pixels,
    pixel_rad: float,
    around: Callable[[Pixels], Pixels],
) -> list[tuple[Pixels, int]]:
    """Return what of a picture is remapped, with a pixel more on every side, and OpenCV's filter of each; of
    depth distances, their error and that between pixels, their inverses, and where these are not known."""
    import cv2

    linear = cv2.INTER_LINEAR
    nearest = cv2.INTER_NEAREST
    if mode != "depth":
        return [(around(picture), linear if mode == "lit" else nearest)]
    inverse, change, bends, known = _inverse(picture, step_m, pixel_rad, around)
    off = cv2.dilate(around(bends + change / _PLACES), np.ones((3, 3)))[1:-1, 1:-1]
    return [
        (around(picture), nearest),
        (around(_error(inverse, change + 0.25 * bends, known, step_m)), nearest),
        (around(_error(inverse, off, known, step_m)), nearest),
        (around(np.where(known, inverse, 0).astype(np.float32)), linear),
        (around((~known).astype(np.float32)), linear),
    ]


def _remap(layer: Pixels, filter_: int, maps: tuple[Array, Array] | Maps) -> Pixels:
    """Return the pixels of a layer, which has one more on every side, at columns and rows."""
    import cv2

    x = np.asarray(maps[0] + 1, np.float32)
    y = np.asarray(maps[1] + 1, np.float32)
    return np.asarray(cv2.remap(layer, x, y, filter_))


def _of_layers(layers: list[Pixels], mode: str) -> Pixels:
    """Return what :func:`_layers` become when they are remapped: pixels; of depth with their error."""
    import cv2

    if mode != "depth":
        return layers[0]
    distance, beside, error, inverse, unknown = layers
    blended = (unknown == 0) & (inverse > 0)
    distance = np.divide(1, inverse, out=distance, where=blended)
    error = cv2.dilate(np.where(blended, error, beside), np.ones((3, 3)))
    return np.stack([distance, error], axis=-1).astype(np.float32)


def _error(inverse: Array, change: Array, known: Mask, step_m: float | Pixels) -> NDArray[np.float32]:
    """Return how far distances may be off whose inverse is off by ``change``, metres."""
    with np.errstate(divide="ignore", invalid="ignore"):
        error = np.where(change < inverse, change / (inverse * (inverse - change)), np.inf) + step_m / 2
    error[~known] = np.inf
    none = known & (inverse == 0)
    error[none] = np.where(np.broadcast_to(step_m, none.shape)[none] > 0, np.inf, 0)
    return np.asarray(error, np.float32)


def _inverse(
    distance: Pixels, step_m: float | Pixels, pixel_rad: float, around: Callable[[Pixels], Pixels]
) -> tuple[Array, Array, Array, Mask]:
    """Return 1 / distance of (H, W) pixels, half its change to the next pixel, and its second
    difference, summed over both axes; and whether the neighbours are on the same surface."""
    with np.errstate(divide="ignore"):
        inverse = 1 / np.asarray(distance, np.float64)  # linear in the direction, on planes
    rows = around(inverse)
    here = rows[1:-1, 1:-1]
    change = np.zeros_like(inverse)
    bends = np.zeros_like(inverse)
    curved = 2 - 2 * np.cos(pixel_rad)  # of a plane, between pixels of one angle
    known = np.ones(inverse.shape, np.bool_)
    for before, after in ((rows[1:-1, :-2], rows[1:-1, 2:]), (rows[:-2, 1:-1], rows[2:, 1:-1])):
        bend = np.abs(before - 2 * here + after)
        change += 0.5 * np.maximum(np.abs(before - here), np.abs(after - here))
        bends += bend
        known &= bend <= (STEP + curved + 2 * step_m * here) * here
    return inverse, change, bends, known


def _beyond(layer: Pixels) -> Pixels:
    """Return (H, W, ...) pixels with those beyond the border, which are as at it."""
    return np.pad(layer, ((1, 1), (1, 1), (0, 0))[: layer.ndim], mode="edge")


def _around(layer: Pixels) -> Pixels:
    """Return (H, W, ...) a panorama's pixels with those beyond its border: on the other side, and over the
    poles."""
    over = np.roll(layer[[0, -1]], layer.shape[1] // 2, 1)
    rows = np.concatenate([over[:1], layer, over[1:]])
    return np.pad(rows, ((0, 0), (1, 1), (0, 0))[: layer.ndim], mode="wrap")
