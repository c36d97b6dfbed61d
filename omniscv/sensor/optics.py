"""Effects of a lens on light: shading, blur, veiling glare, lateral colour.

Composed pixels are radiance. A lens turns it into irradiance, and shading is the ratio of the two.

Here are also the photometric files of TUM's monocular visual odometry datasets, which DSO reads. An image is
``I = G(t V B)``: irradiance B, vignette V, exposure time t, response G.

pcalib.txt     one line of 256 increasing numbers: the inverse response, light 0 to 255 of each code
vignette.png   grey, 16 bits when written, of the image's size: the vignette, relative to its largest value
times.txt      a line for each image: its name or number, its time in seconds, its exposure in milliseconds

Source: Engel, Usenko, Cremers, A photometrically calibrated benchmark for monocular visual odometry, 2016.
"""

from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from omniscv.arguments import within
from omniscv.cameras import Camera, Pinhole, RollingShutter, from_dict
from omniscv.cameras.fisheyes import Fisheye
from omniscv.cameras.radial import Lens
from omniscv.errors import ArgumentError
from omniscv.geometry.arrays import Floats, Mask
from omniscv.geometry.trajectory import decimal
from omniscv.light import light_of_codes
from omniscv.pictures import foreign, png
from omniscv.storage.local import whole_file, write_text

Shading = str | tuple[tuple[float, float], ...]
"""``natural``, the path of a vignette, or (degrees off the axis, share of light)."""

NATURAL = "natural"
_STEP_PX = 1e-3  # of differences

RESPONSE = "pcalib.txt"
VIGNETTE = "vignette.png"
TIMES = "times.txt"


@lru_cache(8)
def shading(camera: Camera, by: Shading) -> Floats:
    """Return the share of light (H, W) that reaches each pixel, relative to the axis; 0 outside the view.

    ``natural`` is the law of cosines of the camera's own projection, for an entrance pupil whose area is the
    same from all directions: a pixel's solid angle, relative to that on the axis. It is 1 for equisolid
    lenses and sin(theta) / theta for equidistant ones. The pupil of a pinhole camera is flat, which adds a
    cosine to cos^3: cos^4.

    Args:
        camera: a lens, or a rolling shutter with one.
        by: ``natural``, the path of a vignette, or a table.

    Raises:
        ArgumentError: ``natural`` for a camera that is no lens, or a vignette of another size.
    """
    if isinstance(by, str) and by != NATURAL:
        return read_vignette(Path(by), (camera.height, camera.width))
    camera = _lens(camera)
    rays = camera.unproject()
    cosine = np.where(rays.valid, rays.directions[..., 2], 0)
    if not isinstance(by, str):
        degrees, shares = np.array(by).T
        table = np.interp(np.degrees(np.arccos(np.clip(cosine, -1, 1))), degrees, shares)
        return np.asarray(table * rays.valid, np.float32)
    check_natural(camera)
    pupil = cosine if isinstance(camera, Pinhole) else 1.0
    middle, _ = camera.project(np.array([0.0, 0.0, 1.0]))
    share = pupil * _solid_angles(camera, camera.pixels()) / _solid_angles(camera, middle)
    return np.asarray(np.where(np.isfinite(share) & rays.valid, share, 0), np.float32)


def check_natural(camera: Camera) -> None:
    """Refuse natural shading of a camera that is no lens."""
    if not isinstance(_lens(camera), Fisheye | Lens):
        wanted = "expected a fisheye or a calibrated lens for natural shading"
        raise ArgumentError(f"shading: {wanted}, got {camera.name}; give a table or a file")


def _lens(camera: Camera) -> Camera:
    """Return the lens of a camera; of a rolling shutter the lens at rest."""
    return camera.base if isinstance(camera, RollingShutter) else camera


def _solid_angles(camera: Camera, pixels: Any) -> Any:
    """Return steradians per square px at pixels (..., 2): by differences, one-sided at the rim."""
    across = _change_per_px(camera, pixels, np.array([_STEP_PX, 0.0]))
    down = _change_per_px(camera, pixels, np.array([0.0, _STEP_PX]))
    return np.linalg.norm(np.cross(across, down), axis=-1)


def _change_per_px(camera: Camera, pixels: Any, step: Any) -> Any:
    """Return how directions change per px at pixels (..., 2) along a step (2,) of ``_STEP_PX``."""
    middle = camera.unproject(pixels).directions
    after = camera.unproject(pixels + step).directions
    before = camera.unproject(pixels - step).directions
    span = 2.0 - np.isnan(after) - np.isnan(before)
    after = np.where(np.isnan(after), middle, after)
    before = np.where(np.isnan(before), middle, before)
    return (after - before) / (span * _STEP_PX)


def blur(light: Floats, sigmas: tuple[float, ...], valid: Mask) -> Floats:
    """Return light (H, W, 3) blurred by Gaussian kernels of unit sum.

    Args:
        light: (H, W, 3).
        sigmas: standard deviations, px, from the image's centre to its corners at equal steps of the radius;
            between two, both blurred images are blended.
        valid: (H, W) the view: pixels outside have no weight.
    """
    import cv2  # slow to load

    weight = valid.astype(np.float32)
    known = light * weight[..., None]

    def blurred(sigma: float) -> Floats:
        if sigma == 0:
            return known
        size = 2 * int(np.ceil(4 * sigma)) + 1
        total = cv2.GaussianBlur(known, (size, size), sigma, borderType=cv2.BORDER_CONSTANT)
        weights = cv2.GaussianBlur(weight, (size, size), sigma, borderType=cv2.BORDER_CONSTANT)
        return np.asarray(total / np.maximum(weights, 1e-6)[..., None] * weight[..., None])

    if len(sigmas) == 1:
        return blurred(sigmas[0])
    height, width = valid.shape
    y = np.arange(height)[:, None] + 0.5 - height / 2
    x = np.arange(width) + 0.5 - width / 2
    radius = np.hypot(x, y) / np.hypot(width, height) * 2 * (len(sigmas) - 1)
    total = np.zeros_like(light)
    for k, sigma in enumerate(sigmas):
        share = np.clip(1 - np.abs(radius - k), 0, 1).astype(np.float32)
        total += share[..., None] * blurred(sigma)
    return total


def glare(light: Floats, share: float, valid: Mask) -> Floats:
    """Return light (H, W, 3) of which a share is spread evenly over the view.

    Args:
        light: (H, W, 3).
        share: what black in a white field becomes: the veiling glare index of ISO 9358.
        valid: (H, W) the view.
    """
    mean = light[valid].mean(axis=0, dtype=np.float64) if valid.any() else np.zeros(3)
    veil = np.asarray(share * mean, np.float32)
    return np.where(valid[..., None], (1 - np.float32(share)) * light + veil, light)


def magnified(camera: Camera, share: float) -> Camera:
    """Return a lens with a focal length that is longer by a share, as for another colour.

    Args:
        camera: with a focal length, or two.
        share: of the focal length that is added; negative for a shorter one.

    Raises:
        ArgumentError: a camera without a focal length.
    """
    described = camera.to_dict()
    if isinstance(camera, RollingShutter):
        base = magnified(camera.base, share).to_dict()
        del base["width"], base["height"]
        return from_dict({**described, "base": base})
    focal: dict[str, Any] = {key: described[key] for key in ("fx", "fy") if key in described}
    if not focal and isinstance(camera, Fisheye | Pinhole):
        described.pop("fov_deg", None)
        focal["focal"] = camera.focal
    if not focal:
        raise ArgumentError(f"lateral: expected a lens with a focal length, got {camera.name}; leave it out")
    for key, value in focal.items():
        described[key] = value * (1 + share)
    return from_dict(described)


def write_response(path: Path, transfer: str) -> Path:
    """Write the inverse response of a ``transfer`` of :mod:`omniscv.light` to ``path``, and return it."""
    light = light_of_codes(np.arange(256), transfer)
    return write_text(path, " ".join(f"{value:.9g}" for value in 255 * light / light[-1]) + "\n")


def read_vignette(path: Path, size: tuple[int, int] | None = None) -> Floats:
    """Return the vignette (H, W), relative to its largest value.

    Args:
        path: a grey picture of 8 or 16 bits.
        size: (H, W) that it must have, px; None: any.
    """
    with within(path):
        pixels = foreign.read(path).pixels
    if size is not None and pixels.shape[:2] != size:
        wanted = f"expected a vignette of the image's size, {size[1]} x {size[0]}"
        raise ArgumentError(f"{path}: {wanted}, got {pixels.shape[1]} x {pixels.shape[0]}")
    return np.asarray(pixels[..., 0] / np.float32(max(1, pixels.max())), np.float32)


def write_vignette(path: Path, shading: Any) -> Path:
    """Write ``shading``, shares of light (H, W), to ``path`` as 16 bits of the largest, and return the
    path."""
    largest = float(np.max(shading)) or 1.0
    with whole_file(path) as part:
        part.write_bytes(png.encode(np.rint(65535 * np.asarray(shading) / largest).astype(np.uint16)))
    return path


def write_times(path: Path, frames: Iterable[tuple[str, int, float]]) -> Path:
    """Write the ``times.txt`` of frames, and return the path.

    Args:
        path: the file.
        frames: name, time in nanoseconds and exposure in seconds of each.
    """
    text = ""
    for name, time_ns, exposure_s in frames:
        text += f"{name} {decimal(time_ns)} {1e3 * exposure_s:.9g}\n"
    return write_text(path, text)
