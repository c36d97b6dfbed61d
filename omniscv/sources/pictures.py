"""Pictures in files, panoramas as six faces, and six faces in memory as a source."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omniscv import modalities
from omniscv.arguments import number, numbers, shown, within
from omniscv.errors import ArgumentError, MissingCaptureError
from omniscv.geometry import Array, Pose, cube_rotations, pinhole
from omniscv.modalities import Transfer
from omniscv.sources.base import Capabilities, Capture, ObjectTable, Request, Source, View
from omniscv.storage.bounded import library_error

NAMES = tuple(name for name, _ in cube_rotations())
Pixels = NDArray[Any]


class PictureSource(Source):
    """Pictures that are there, replayed as a recording's are.

    Args:
        captures: of one scene.
        objects: as masks show them.
        transfer: of colours.
    """

    def __init__(
        self, captures: Sequence[Capture], objects: ObjectTable | None = None, transfer: Transfer = "unknown"
    ) -> None:
        self._captures = {capture.request: capture for capture in captures}
        self._views = tuple(dict.fromkeys(capture.view for capture in captures))
        self._objects = objects or ObjectTable({})
        modes = frozenset(capture.mode for capture in captures)
        self._capabilities = Capabilities(modes=modes, dialect="pictures", transfer=transfer)

    @property
    def capabilities(self) -> Capabilities:
        return self._capabilities

    def recorded_views(self) -> tuple[View, ...]:
        return self._views

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        for request in requests:
            if request not in self._captures:
                raise MissingCaptureError(f"expected one of {len(self._captures)} pictures, got {request}")
            yield self._captures[request]

    def objects(self) -> ObjectTable:
        return self._objects


def from_faces(
    faces: Mapping[str, ArrayLike],
    *,
    position: ArrayLike = (0.0, 0.0, 0.0),
    yaw_deg: float = 0.0,
    fov_deg: float = 90.0,
    objects: ObjectTable | None = None,
    transfer: Transfer = "unknown",
    **modes: Mapping[str, ArrayLike],
) -> PictureSource:
    """Return a source of six faces around one optical centre.

    Args:
        faces: colours by name (front, right, back, left, up, down): (s, s, 3) uint8 or float32. The lower
            edge of up and the upper edge of down touch front.
        position: (3,) of the centre, world frame, metres.
        yaw_deg: of the front face, to the left.
        fov_deg: of every face, at least 90.
        objects: of masks.
        transfer: of colours.
        modes: the same faces in other modes, such as ``depth`` ((s, s), planar metres) and ``object_mask``.

    Raises:
        ArgumentError: other names, or faces that are not square and of one size and type.
    """
    number("fov_deg", fov_deg, least=90, below=180)
    center_w = numbers("position", position, (3,))
    turn_w = turn_about_z(yaw_deg)
    captures = []
    for mode, named in {"lit": faces, **modes}.items():
        row = modalities.get(mode)
        if set(named) != set(NAMES):
            raise ArgumentError(f"{mode}: expected faces {', '.join(NAMES)}; got {shown(', '.join(named))}")
        arrays: dict[str, NDArray[Any]] = {name: np.asarray(named[name]) for name in NAMES}
        kinds = {(array.shape, array.dtype.name) for array in arrays.values()}
        edges = {shape[:2] for shape, _ in kinds}
        if len(kinds) > 1 or len(set(*edges)) > 1 or not all(map(row.fits, arrays.values())):
            wanted = f"six square faces of one size, {' or '.join(row.dtypes)}"
            raise ArgumentError(f"{mode}: expected {wanted}, got {shown(sorted(kinds))}")
        for name, R_w_c in cube_rotations():
            edge = arrays[name].shape[0]
            view = View(Pose(center_w, turn_w @ R_w_c), fov_deg, edge, edge)
            captures.append(Capture(Request(view, row.name), view, arrays[name]))
    return PictureSource(captures, objects, transfer)


def turn_about_z(yaw_deg: float) -> Array:
    """Return the rotation (3, 3) to the left in the world frame."""
    return Pose.from_angles((0, 0, 0), yaw_deg=yaw_deg).R_w_c @ Pose.from_angles((0, 0, 0)).R_w_c.T


def read_picture(file: Path) -> Pixels:
    """Return (H, W, 3) of colours, (H, W) or (H, W, C) of others; uint8, uint16 or float32."""
    import OpenImageIO

    from omniscv.sources.codecs import MAX_PIXELS  # imports numba

    with within(file.name):
        if file.suffix == ".npy":
            pixels = np.load(file, allow_pickle=False)
            return np.asarray(pixels, np.float32) if pixels.dtype.kind == "f" else pixels
        source = OpenImageIO.ImageInput.open(str(file))
        if source is None:
            raise ArgumentError(f"expected a picture, got: {shown(library_error(OpenImageIO))}")
        spec = source.spec()
        if not 0 < spec.width * spec.height <= MAX_PIXELS:
            raise ArgumentError(f"expected at most {MAX_PIXELS} pixels, got {spec.width} x {spec.height}")
        formats = {"uint8": "uint8", "uint16": "uint16"}
        pixels = source.read_image(0, 0, 0, min(spec.nchannels, 3), formats.get(str(spec.format), "float"))
        if pixels is None:
            raise ArgumentError(f"expected a picture, got: {shown(library_error(source))}")
        return pixels if pixels.shape[-1] == 3 else np.repeat(pixels[..., :1], 3, axis=-1)


def to_faces(picture: Pixels, mode: str, of_openexr: int = 0) -> list[tuple[Pixels, Array, float]]:
    """Return six faces of a panorama (H, W, 3), twice as fine as its equator.

    Returns:
        Pixels, rotation (3, 3) and field of view in degrees, of each face.

    Colours are bilinear; depth along the ray is the nearest pixel's, and becomes planar (h, w).
    """
    import cv2

    height, width = picture.shape[:2]
    edge = width // 2
    wrapped = np.pad(picture, ((1, 1), (1, 1), (0, 0)), mode="wrap")
    wrapped[0], wrapped[-1] = wrapped[1], wrapped[-2]  # beyond a pole, its own row
    faces = []
    for _, R_w_c in cube_rotations():
        pixels = np.stack(np.meshgrid(*[np.arange(edge) + 0.5] * 2), axis=-1)
        x, y, z = np.moveaxis(pinhole.rays(pixels, pinhole.Projection(*4 * [edge / 2])) @ R_w_c.T, -1, 0)
        u = 0.5 - np.arctan2(y, x) / (2 * np.pi)
        v = np.arctan2(np.hypot(x, y), z) / np.pi
        # Columns: centres at +0.5; OpenEXR's first and last are the same meridian.
        u_px = u * (width - 1) if of_openexr else u * width - 0.5
        v_px = v * (height - 1) if of_openexr else v * height - 0.5
        maps = (np.float32(u_px + 1), np.float32(v_px + 1))
        filter_ = cv2.INTER_LINEAR if mode == "lit" else cv2.INTER_NEAREST
        face: Pixels = cv2.remap(wrapped, *maps, filter_)
        if mode == "depth":
            lengths = View(Pose(np.zeros(3), R_w_c), 90, edge, edge).ray_lengths()
            face = np.asarray(face[..., 0] / lengths, np.float32)
        faces.append((face, R_w_c, 90.0))
    return faces
