"""Flaws of captures: what some faults of :mod:`mock_server.faults` do to pose, depth, pixels and light.

Scenes have colours as displays show them, in sRGB. With the fault ``tone`` they are decoded, the faults of
light (exposure, vignette, bloom) act on it as in an engine, and the tone curve makes codes of it; without it
they act on codes. Written from IEC 61966-2-1 and the engine's documentation of its film curve, and
independent of ``omniscv``.
"""

import dataclasses
import random
import re
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mock_server.faults import Faults
from mock_server.scene import ViewHits

Triple = tuple[float, float, float]
Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]

_STEEP_DEG = 45.0
_DEPTH_RANGE_M = 100.0

TONES = ("srgb", "film", "linear")
_MIDDLE_GREY = {"": 0.5, "srgb": 0.18, "film": 0.18, "linear": 0.18}
_BLOOM = 1 / 8  # standard deviation, of the picture's width
# log10 of light; film curve
_TOE = -0.390277
_SHOULDER = -0.606186
_LINE = 0.901641


def turned(rotation: Triple, degrees: float) -> Triple:
    """Return a ``rotation``, turned by ``degrees`` about the vertical if it looks steeply up or down."""
    pitch, yaw, roll = rotation
    return pitch, yaw + degrees * (abs((pitch + 180) % 360 - 180) > _STEEP_DEG), roll


def jittered(rotation: Triple, degrees: float, generator: random.Random) -> Triple:
    """Return a ``rotation`` with pitch and yaw off by up to ``degrees``, drawn evenly by ``generator``."""
    pitch, yaw, roll = rotation
    pitch += generator.uniform(-degrees, degrees)
    yaw += generator.uniform(-degrees, degrees)
    return pitch, yaw, roll


def rounded_far_away(location: Triple, km: float) -> Triple:
    """Return a ``location``, cm, in single precision, as ``km`` from the world's origin along each axis."""
    offset = np.float32(1e5 * km)
    x, y, z = location
    return _rounded(x, offset), _rounded(y, offset), _rounded(z, offset)


def _rounded(value: float, offset: np.float32) -> float:
    return float(np.float32(value + offset) - offset)


def in_steps(depth: Array, bits: float) -> Array:
    """Return depth in 2^bits even steps up to 100 m, as in integer images."""
    step = _DEPTH_RANGE_M / 2**bits
    return np.asarray(np.round(np.minimum(depth, _DEPTH_RANGE_M) / step) * step)


def in_bits(depth: Array, bits: float) -> Array:
    """Return depth with a mantissa of so many bits: 23 float32, 10 half floats, 7 bfloat16."""
    mantissa, exponent = np.frexp(depth)
    return np.asarray(np.ldexp(np.round(mantissa * 2 ** (bits + 1)) / 2 ** (bits + 1), exponent))


def blurred(image: Bytes, px: float) -> Bytes:
    """Return the ``image`` of a mask with edges as anti-aliasing makes them: blended over ``px`` pixels."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), px) if px > 0 else image, np.uint8)


def recoloured(image: Bytes, levels: float, generator: random.Random) -> Bytes:
    """Return the ``image`` of a mask, every channel off by up to so many ``levels``.

    They are drawn evenly by a random generator whose seed ``generator`` draws.
    """
    rng = np.random.default_rng(generator.getrandbits(32))
    noise = rng.uniform(-levels, levels, image.shape)
    return np.clip(np.round(image + noise), 0, 255).astype(np.uint8)


def through_jpeg(image: Bytes, loss: float) -> Bytes:
    """Return an image that was a JPEG of quality ``100 - loss``, in full colour resolution."""
    options = [cv2.IMWRITE_JPEG_QUALITY, round(100 - loss), cv2.IMWRITE_JPEG_SAMPLING_FACTOR, 0x111111]
    return np.asarray(cv2.imdecode(cv2.imencode(".jpg", image, options)[1], cv2.IMREAD_COLOR), np.uint8)


def distorted(image: NDArray[Any], corner: float) -> NDArray[Any]:
    """Return the ``image`` of a lens that sees farther out, by the squared radius from the middle.

    Args:
        image: (H, W) or (H, W, C).
        corner: by which share the radius of what the corners show is larger.
    """
    height, width = image.shape[:2]
    v, u = np.mgrid[:height, :width] + 0.5
    x = 2 * u / width - 1
    y = 2 * v / height - 1
    factor = 1 + corner * (x**2 + y**2) / 2
    across = np.float32((x * factor + 1) * width / 2 - 0.5)
    down = np.float32((y * factor + 1) * height / 2 - 0.5)
    return np.asarray(cv2.remap(image, across, down, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE))


def shifted(image: Bytes, px: float) -> Bytes:
    """Return an ``image``, shifted to the right by ``px`` pixels."""
    matrix = np.array([[1.0, 0.0, px], [0.0, 1.0, 0.0]])
    size = image.shape[1], image.shape[0]
    return np.asarray(cv2.warpAffine(image, matrix, size, borderMode=cv2.BORDER_REPLICATE), np.uint8)


def cast(image: Bytes, share: float, generator: random.Random) -> Bytes:
    """Return an ``image`` with its first channel brighter and its last darker, or the other way.

    They change by up to a ``share``, drawn evenly by the ``generator``.
    """
    off = generator.uniform(-share, share)
    return np.asarray(np.clip(np.round(image * np.array([1 + off, 1.0, 1 - off])), 0, 255), np.uint8)


def radial(depth: Array, share: float, view: ViewHits) -> Array:
    """Return planar ``depth`` that goes a ``share`` of the way to the distance along a ``view``'s rays."""
    is_surface = np.isfinite(view.depth)
    farther = np.where(is_surface, view.distance, 0) - np.where(is_surface, view.depth, 0)
    return depth + share * farther


IMAGES: tuple[tuple[str, str, Callable[[Bytes, float, random.Random], Bytes]], ...] = (
    ("mask-blur", "object_mask", lambda image, px, _: blurred(image, px)),
    ("mask-noise", "object_mask", recoloured),
    ("lit-offset", "lit", lambda image, px, _: shifted(image, px)),
    ("mask-offset", "object_mask", lambda image, px, _: shifted(image, px)),
    ("color-cast", "lit", cast),
    ("distortion", "", lambda image, corner, _: distorted(image, corner)),
    ("jpeg", "", lambda image, loss, _: through_jpeg(image, loss)),
)
"""The faults of images in their order: name, mode (empty for all), and what they do."""

DEPTHS: tuple[tuple[str, Callable[[Array, float, ViewHits], Array]], ...] = (
    ("depth-scale", lambda depth, share, _: depth * (1 + share)),
    ("distortion", lambda depth, corner, _: distorted(depth, corner)),
    ("radial-depth", radial),
    ("far-plane", lambda depth, most, _: np.minimum(depth, most)),
    ("depth-bits", lambda depth, bits, _: in_steps(depth, bits)),
    ("depth-mantissa", lambda depth, bits, _: in_bits(depth, bits)),
)
"""The faults of depth in their order: name, and what they do."""


class Film:
    """A camera's light, with the faults exposure-drift, vignette, bloom and tone.

    Raises:
        ValueError: an unknown tone.
    """

    def __init__(self, faults: Faults) -> None:
        tone = faults.get("tone")
        self._tone = str(tone.value) if tone else ""
        if tone and self._tone not in TONES:
            raise ValueError(f"fault tone: expected one of {', '.join(TONES)}; got {self._tone!r}")
        self._faults = faults
        self._gain = 1.0
        self._adapts = True
        self._vignette = faults.get("vignette")
        self._bloom = faults.get("bloom")

    def on_command(self, text: str) -> None:
        """End the faults that a console command ends."""
        if re.fullmatch(r"vrun r\.Tonemapper\.Quality [01]\s*", text):
            self._vignette = None
        if re.fullmatch(r"vrun r\.BloomQuality 0\s*", text):
            self._bloom = None
        if re.fullmatch(r"vrun r\.EyeAdaptationQuality 0\s*", text):
            self._adapts = False
            self._gain = 1.0

    def expose(self, color: Bytes, manual: bool = False, bias: float = 0.0) -> Bytes:
        """Return the codes of a picture as the camera exposes it.

        Args:
            color: (H, W, 3) uint8, the codes of the picture without faults.
            manual: whether exposure stays as it is; else it follows the light, by the fault exposure-drift.
            bias: of the exposure, stops.
        """
        drift = None if manual else self._faults.strike("exposure-drift")
        light = to_light(color / 255) if self._tone else color / 255
        if drift is not None and self._adapts:
            target = _MIDDLE_GREY[self._tone] / max(1 / 255, float(light.mean()))
            self._gain += drift.amount() * (target - self._gain)
        gain = self._manual_gain(bias) if manual else self._gain * 2**bias
        if self._tone in ("", "srgb") and gain == 1.0 and not (self._vignette or self._bloom):
            return color
        light = self._through_lens(light * gain)
        if self._tone == "film":
            light = _film(light)
        if self._tone in ("srgb", "film"):
            light = to_srgb(light)
        return np.clip(np.round(255 * light), 0, 255).astype(np.uint8)

    def _manual_gain(self, bias: float) -> float:
        """Return the gain of manual exposure at a bias in stops, with the fault dark-manual."""
        dark = self._faults.get("dark-manual")
        stops = bias - (dark.amount() if dark else 0.0)
        return float(1.0 * 2**stops)

    def _through_lens(self, light: Array) -> Array:
        """Return (H, W, 3) light with the faults vignette and bloom; it may be changed in place."""
        height, width = light.shape[:2]
        if self._vignette is not None:
            x = (np.arange(width) + 0.5 - width / 2) / (width / 2)
            y = (np.arange(height) + 0.5 - height / 2) / (height / 2)
            squared_radius = (x[None, :] ** 2 + y[:, None] ** 2) / 2  # 1 in the corners
            light *= 1 - self._vignette.amount() * squared_radius[..., None]
        if self._bloom is not None:
            halo = cv2.GaussianBlur(light, (0, 0), _BLOOM * width, borderType=cv2.BORDER_REPLICATE)
            light += self._bloom.amount() * (halo - light)
        return light


def blended(pane: ViewHits, behind: ViewHits) -> Array:
    """Return (H, W, 3) colours of a view with a half transparent ``pane``, and of that ``behind`` it."""
    color = pane.paint()
    return np.where((pane.label != behind.label)[..., None], mixed(color, behind.paint()), color)


def mirrored(view: ViewHits, at: Any, rays: Array, center: Array, trace: Callable[..., Any]) -> Array:
    """Return (H, W, 3) colours of a view in which an object mirrors what it faces, with half of the light.

    Args:
        view: (H, W), without mirrors.
        at: (H, W) bool, the pixels of the object.
        rays: (H, W, 3) unit directions, in the scene's frame.
        center: (3,) the optical centre, metres, in the scene's frame.
        trace: a function of origins and directions (N, 3) that returns their hits.
    """
    color = view.paint()
    normal = view.normal[at]
    rays = rays[at]
    points = center + rays * view.distance[at][:, None]
    away = rays - 2 * (rays * normal).sum(axis=-1, keepdims=True) * normal
    color[at] = mixed(color[at], trace(points + 1e-6 * normal, away).color)
    return color


def domed(view: ViewHits, rays: Array, length: Array, radius_m: float, label: int) -> ViewHits:
    """Return the ``view`` with a sphere around the camera as background.

    Args:
        view: (H, W), without the sphere.
        rays: (H, W, 3) unit directions, in the scene's frame.
        length: (H, W) of the rays per metre of depth.
        radius_m: of the sphere.
        label: of the sphere.
    """
    sky = view.distance > radius_m
    return dataclasses.replace(
        view,
        label=np.where(sky, label, view.label).astype(np.uint16),
        depth=np.where(sky, radius_m / length, view.depth),
        distance=np.where(sky, radius_m, view.distance),
        normal=np.where(sky[..., None], -rays, view.normal),
    )


def mixed(first: Array, second: Array) -> Array:
    """Return colours 0..1 whose light is half that of the ``first`` and half that of the ``second``."""
    first_light = to_light(np.clip(first, 0, 1))
    second_light = to_light(np.clip(second, 0, 1))
    return to_srgb(0.5 * first_light + 0.5 * second_light)


def to_light(color: Array) -> Array:
    """Return the light of sRGB colours 0..1."""
    return np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)


def to_srgb(light: Array) -> Array:
    """Return sRGB colours of light."""
    curve = 1.055 * np.maximum(light, 0.0031308) ** (1 / 2.4) - 0.055
    return np.where(light <= 0.0031308, 12.92 * light, curve)


def _film(light: Array) -> Array:
    """The engine's default tone curve: a line in log10 of light between two logistic curves."""
    x = np.log10(np.maximum(light, 1e-9))
    line = 0.88 * (x + _LINE)
    toe = np.where(x < _TOE, 0.9 / (1 + np.exp(-1.76 / 0.45 * (x - _TOE))), line)
    shoulder = np.where(x > _SHOULDER, 1.04 - 1.56 / (1 + np.exp(1.76 / 0.78 * (x - _SHOULDER))), line)
    t = np.clip((x - _SHOULDER) / (_TOE - _SHOULDER), 0, 1)
    return toe + (shoulder - toe) * t * t * (3 - 2 * t)
