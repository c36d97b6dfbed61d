"""The lenses of imported pictures: read by the declared keys of :mod:`omniscv.calibration`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from omniscv.arguments import number, numbers, shown, within
from omniscv.errors import ArgumentError
from omniscv.geometry import Array, Pose, pinhole
from omniscv.pictures.forms import Pixels
from omniscv.records import mapping
from omniscv.sources.base import Lens, View
from omniscv.storage.bounded import MOST_JSON_BYTES, parse_json, read_bytes

_SCALE = 6553.5  # of depth in Replica's cam_params.json
_SAME_SHAPE = 0.01  # of a lens and its picture
_WIDEST = np.tan(np.radians(60))  # half a flat picture: beyond, four pixels show what one has shown
_NARROWEST = 0.01  # half a flat picture that is one
_SIDE, _HALVINGS, _NEAR = 33, 40, 1e-4  # points of a side; steps of a search; tangent near the axis


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
        """Return the lens of pictures of another size; ArgumentError for another shape."""
        across, down = width / self.width, height / self.height
        if abs(across / down - 1) > _SAME_SHAPE:
            expected = f"expected the shape of {self.width:g} x {self.height:g}, as its lens"
            raise ArgumentError(f"{expected}, got {width} x {height}")
        px = self.fx * across, self.fy * down, self.cx * across, self.cy * down
        return Pinhole(*px, width, height, self.distortion)

    def view(self, pose: Pose) -> View:
        """Return the view of a picture without distortion."""
        lens = Lens(self.fy / self.fx, self.cx / self.width - 0.5, self.cy / self.height - 0.5)
        size = int(self.width), int(self.height)
        return View(pose, pinhole.fov_deg(self.width, self.fx), *size, None if lens == Lens() else lens)

    def straight(self, pixels: Pixels, blend: bool) -> tuple[Pixels, Pinhole]:
        """Return a picture without distortion, of what it shows all over, and its lens."""
        import cv2

        K = np.array([[self.fx, 0, self.cx - 0.5], [0, self.fy, self.cy - 0.5], [0, 0, 1]])
        size, bent = (int(self.width), int(self.height)), np.array(self.distortion)
        K_new, _ = cv2.getOptimalNewCameraMatrix(K, bent, size, 0)
        maps = cv2.initUndistortRectifyMap(K, bent, None, K_new, size, cv2.CV_32FC1)
        (fx, _, cx), (_, fy, cy) = K_new[:2].tolist()
        straight = cv2.remap(pixels, *maps, cv2.INTER_LINEAR if blend else cv2.INTER_NEAREST)
        return straight, Pinhole(fx, fy, cx + 0.5, cy + 0.5, *size)


FACE = Pinhole(1, 1, 1, 1, 2, 2)
"""Of a face of a cube."""


@dataclass(frozen=True)
class Wide:
    """A lens of another model with one centre, such as a fisheye: ``straight`` makes its pictures flat."""

    camera: Any
    is_bent = True

    def scaled(self, width: int, height: int) -> Wide:
        """Return the lens; ArgumentError for pictures of another size."""
        size = self.camera.width, self.camera.height
        if (width, height) != size:
            raise ArgumentError(f"expected {size[0]} x {size[1]}, as its lens, got {width} x {height}")
        return self

    def straight(self, pixels: Pixels, blend: bool) -> tuple[Pixels, Pinhole]:
        """Return the largest flat picture of at most 120 degrees that the picture shows all over."""
        import cv2

        maps, lens = self._flat
        return cv2.remap(pixels, *maps, cv2.INTER_LINEAR if blend else cv2.INTER_NEAREST), lens

    @cached_property
    def _flat(self) -> tuple[tuple[Pixels, Pixels], Pinhole]:
        """The pixels to take, as OpenCV counts them, and the flat picture's lens."""
        width, height = self.camera.width, self.camera.height
        side = np.linspace(-1, 1, _SIDE)
        ends = np.ones(_SIDE)
        border = np.concatenate([[[side, sign * ends], [sign * ends, side]] for sign in (-1, 1)])
        x, y = np.moveaxis(border, 1, 0)
        across, down = np.array([width, height]) / max(width, height)

        def shown_all(reach: float) -> bool:
            points = np.stack([x * across * reach, y * down * reach, np.ones_like(x)], axis=-1)
            return bool(self.camera.project(points)[1].all())

        low, high = 0.0, _WIDEST
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            low, high = (middle, high) if shown_all(middle) else (low, middle)
        near = self.camera.project([[_NEAR, 0, 1], [-_NEAR, 0, 1], [0, _NEAR, 1], [0, -_NEAR, 1]])[0]
        focal = max(float(near[0, 0] - near[1, 0]), float(near[2, 1] - near[3, 1])) / (2 * _NEAR)
        if not (low > _NARROWEST and focal > 0):
            raise ArgumentError(f"expected a lens that looks ahead, got {self.camera!r}")
        w, h = (2 * max(1, int(low * focal * share)) for share in (across, down))
        x, y = np.meshgrid(np.arange(w) + 0.5 - w / 2, np.arange(h) + 0.5 - h / 2)
        pixels, _ = self.camera.project(np.stack([x / focal, y / focal, np.ones_like(x)], axis=-1))
        u, v = np.moveaxis((pixels - 0.5).astype(np.float32), -1, 0)
        return (u, v), Pinhole(focal, focal, w / 2, h / 2, w, h)


def of_values(
    values: Mapping[str, Any], form: str, size: tuple[int, int], shift_px: float | None = None
) -> Pinhole | Wide | None:
    """Return the lens of values that a file of a form would hold; None for a panorama.

    Args:
        values: by key; without a size that of ``size``, px, is taken.
        form: of :func:`omniscv.calibration.formats`.
        size: of the picture.
        shift_px: added to the centre to make it ours, if it is not that of the form.
    """
    from omniscv.calibration.files import read_values  # slow to load

    return _lens(read_values(values, form, size, shift_px))


def of_keys(name: str, value: object, size: tuple[int, int]) -> Pinhole | Wide:
    """Return the lens of ``intrinsics`` of a layout; ``centers`` is where the first pixel has its centre."""
    values = mapping(name, value)
    center = number(f"{name}.centers", values.pop("centers", 0.5))
    if center not in (0, 0.5):
        raise ArgumentError(f"{name}.centers: expected 0.5 or 0, got {center:g}")
    lens = of_values(values, "intrinsics", size, 0.5 - center)
    assert lens is not None  # the form has none
    return lens


def of_layout(value: Any, folder: Path, size: tuple[int, int]) -> tuple[Pinhole | Wide, Array]:
    """Return the lens of the key ``intrinsics`` of a layout, and its centre (3,) in the frame of its poses.

    ``file`` names JSON with fx, fy, cx and cy, or a text of a matrix, in the line that starts with ``row``.
    """
    values = mapping("intrinsics", value)
    if (name := values.pop("file", "")) == "":
        return of_keys("intrinsics", values, size), np.zeros(3)
    row, center = values.pop("row", ""), values.pop("centers", 0.5)
    file = next(
        (at / name for at in (folder, folder.absolute().parent) if (at / name).exists()), folder / name
    )
    with within(file.name):
        content = read_bytes(file, MOST_JSON_BYTES)
        if file.suffix == ".json":
            data = parse_json(content)
            data = data.get("camera", data)
            if data.get("scale", _SCALE) != _SCALE:
                raise ArgumentError(f"scale: expected {_SCALE:g} of a metre, got {shown(data['scale'])}")
            size = int(data.get("w", size[0])), int(data.get("h", size[1]))
            P = np.array([[data["fx"], 0, data["cx"], 0], [0, data["fy"], data["cy"], 0], [0, 0, 1, 0]])
        else:
            lines = content.decode("utf-8", "replace").splitlines()
            words = " ".join(line.removeprefix(row) for line in lines if line.startswith(row)).split()
            P = numbers("matrix", [number(row or "matrix", word) for word in words], (None,))
            P = np.column_stack([P.reshape(3, 3), np.zeros(3)]) if P.size == 9 else P.reshape(-1, 4)[:3]
        keys = {"fx": P[0, 0], "fy": P[1, 1], "cx": P[0, 2], "cy": P[1, 2], "centers": center}
        lens = of_keys("intrinsics", {key: float(number) for key, number in keys.items()}, size)
        return lens, -np.linalg.solve(P[:, :3], P[:, 3])


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
    count = next(n for n in (0, 5, 8, 12) if not any(terms[n:]))
    size = camera.width, camera.height
    return Pinhole(camera.fx, camera.fy, camera.cx, camera.cy, *size, tuple(terms[:count]))
