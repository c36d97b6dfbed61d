"""What a camera makes of light: exposure, vignette and bloom, then the tone curve. All are faults.

Scenes have colours as displays show them, in sRGB. With the fault ``tone`` they are decoded, the other faults
act on light as in an engine, and the tone curve makes codes of it; without it they act on codes. Written from
IEC 61966-2-1 and the engine's documentation of its film curve, and independent of ``omniscv``.
"""

import re

import cv2
import numpy as np
from numpy.typing import NDArray

from mock_server.faults import Faults
from mock_server.pixels import Bytes

Array = NDArray[np.float64]

TONES = ("srgb", "film", "linear")

_MIDDLE_GREY = {"": 0.5, "srgb": 0.18, "film": 0.18, "linear": 0.18}
_BLOOM = 1 / 8  # standard deviation, of the picture's width
_MIRRORED = 0.5
_TOE, _SHOULDER, _LINE = -0.390277, -0.606186, 0.901641  # log10 of light; film curve


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
        self._faults, self._gain, self._adapts = faults, 1.0, True
        self._vignette, self._bloom = faults.get("vignette"), faults.get("bloom")

    def on_command(self, text: str) -> None:
        """End the faults that a console command ends."""
        if re.fullmatch(r"vrun r\.Tonemapper\.Quality [01]\s*", text):
            self._vignette = None
        if re.fullmatch(r"vrun r\.BloomQuality 0\s*", text):
            self._bloom = None
        if re.fullmatch(r"vrun r\.EyeAdaptationQuality 0\s*", text):
            self._adapts, self._gain = False, 1.0

    def expose(self, color: Bytes, manual: bool = False, bias: float = 0.0) -> Bytes:
        """Return (H, W, 3) codes of a picture without faults, at a bias in stops; manual exposure holds."""
        drift = None if manual else self._faults.strike("exposure-drift")
        light = to_light(color / 255) if self._tone else color / 255
        if drift is not None and self._adapts:
            target = _MIDDLE_GREY[self._tone] / max(1 / 255, float(light.mean()))
            self._gain += drift.amount() * (target - self._gain)
        dark = self._faults.get("dark-manual") if manual else None
        gain = (1.0 if manual else self._gain) * 2 ** (bias - (dark.amount() if dark else 0.0))
        if self._tone in ("", "srgb") and gain == 1.0 and not (self._vignette or self._bloom):
            return color
        light = light * gain
        if self._vignette is not None:
            y, x = ((np.arange(n) + 0.5 - n / 2) / (n / 2) for n in color.shape[:2])
            squared_radius = (x[None, :] ** 2 + y[:, None] ** 2) / 2  # 1 in the corners
            light *= 1 - self._vignette.amount() * squared_radius[..., None]
        if self._bloom is not None:
            halo = cv2.GaussianBlur(light, (0, 0), _BLOOM * color.shape[1], borderType=cv2.BORDER_REPLICATE)
            light += self._bloom.amount() * (halo - light)
        if self._tone:
            light = (
                light if self._tone == "linear" else to_srgb(_film(light) if self._tone == "film" else light)
            )
        return np.clip(np.round(255 * light), 0, 255).astype(np.uint8)


def mixed(first: Array, second: Array, share: float = _MIRRORED) -> Array:
    """Return colours 0..1 whose light is that of two colours, ``share`` of the second."""
    one, other = (to_light(np.clip(color, 0, 1)) for color in (first, second))
    return to_srgb((1 - share) * one + share * other)


def to_light(color: Array) -> Array:
    """Return the light of sRGB colours 0..1."""
    return np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)


def to_srgb(light: Array) -> Array:
    """Return sRGB colours of light."""
    return np.where(
        light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 0.0031308) ** (1 / 2.4) - 0.055
    )


def _film(light: Array) -> Array:
    """The engine's default tone curve: a line in log10 of light between two logistic curves."""
    x = np.log10(np.maximum(light, 1e-9))
    line = 0.88 * (x + _LINE)
    toe = np.where(x < _TOE, 0.9 / (1 + np.exp(-1.76 / 0.45 * (x - _TOE))), line)
    shoulder = np.where(x > _SHOULDER, 1.04 - 1.56 / (1 + np.exp(1.76 / 0.78 * (x - _SHOULDER))), line)
    t = np.clip((x - _SHOULDER) / (_TOE - _SHOULDER), 0, 1)
    return toe + (shoulder - toe) * t * t * (3 - 2 * t)
