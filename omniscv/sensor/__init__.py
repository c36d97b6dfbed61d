"""A sensor and its lens: EMVA 1288's linear camera, behind composition.

The chain, each step of which can be left out::

    light -> shading -> blur -> glare -> mosaic -> electrons -> noise -> codes -> picture

Electrons of a pixel: ``n = Poisson(light * electrons * (1 + PRNU) + dark_current * exposure_s)``, at most
``full_well``. Its code: ``rint(gain (n + DSNU + read noise + row noise) + black_level)``, 0 to
``2^bits - 1``. Source: EMVA Standard 1288, Release 4.0 Linear, 2021.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import number, numbers, one_of, shown, text, whole_number, wrong
from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.geometry.arrays import Floats, Pixels, run
from omniscv.light import decode, encode
from omniscv.records import checked, optional, record
from omniscv.sensor import noise, optics
from omniscv.storage.bounded import MOST_PICTURE_BYTES, read_bytes

__all__ = ["PRESETS", "Sensor"]


Image = TypeVar("Image")  # an image in memory: omniscv.compose.image.OmniImage, which is beside this room

_FEWEST_BITS = 8
_MOST_BITS = 16
_MOST_KERNELS = 5  # of a blur, from the centre to the corners
_BLOCK_PX = 1 << 21  # pixels whose random words are in memory at a time

_PATTERNS = {"rggb": (0, 1, 1, 2), "bggr": (2, 1, 1, 0), "grbg": (1, 0, 2, 1), "gbrg": (1, 2, 0, 1)}
"""The channels of the pixels (0, 0), (0, 1), (1, 0), (1, 1) in (row, column), repeated over the image."""

_LUMINANCE = (0.2126, 0.7152, 0.0722)
"""What a sensor without filters sees of red, green and blue light of 1: the luminance of Rec. 709."""

_GLOBAL_SHUTTER = {"exposure_s": 0.01, "bits": 12, "black_level": 16.0, "mosaic": "rggb"}

PRESETS: Mapping[str, Mapping[str, Any]] = {
    # EMVA 1288 data of Matrix Vision's mvBlueFOX3-2051: 3.45 um, SNR_max 40.3 dB, DR 71.2 dB
    "imx250": {**_GLOBAL_SHUTTER, "full_well": 10_715.0, "read_noise": 2.33},
    # of its mvBlueFOX3-2024a: 5.86 um, SNR_max 45.1 dB, DR 73 dB
    "imx249": {**_GLOBAL_SHUTTER, "full_well": 32_360.0, "read_noise": 6.34},
    # A phone's, 1.4 um, rolling shutter. Lyu et al., Validation of image systems simulation technology using
    # a Cornell box, 2021, and the sensor of ISETCam that is calibrated there
    "imx363": {
        "exposure_s": 1 / 60, "bits": 10, "black_level": 64.0, "mosaic": "rggb",
        "full_well": 6_000.0, "read_noise": 5.0, "prnu": 0.007,
    },
}  # fmt: skip
"""Parameters of sensors by name. Full well and read noise of the first two follow from SNR_max and dynamic
range in the data sheets: ``full_well = SNR_max^2``, ``full_well / DR = sqrt(read_noise^2 + 1 / (12 gain^2)) +
1 / 2``. What a source does not say is 0. Light of 1.0 fills the well."""


def _electrons(name: str, value: object) -> float | tuple[float, ...]:
    """Return one number of electrons, or those of red, green and blue."""
    if not isinstance(value, list | tuple):
        return number(name, value, above=0)
    return tuple(number(name, item, above=0) for item in numbers(name, value, (3,)).tolist())


def _shading(name: str, value: object) -> optics.Shading:
    """Return a word, a path, or a table whose angles increase."""
    if isinstance(value, str | Path):
        return text(name, str(value))
    table = numbers(name, value, (None, 2))
    if len(table) < 2 or (np.diff(table[:, 0]) <= 0).any() or (table < 0).any():
        wanted = "natural, a file, or at least two pairs of increasing degrees and share of light"
        raise wrong(name, wanted, value)
    return tuple((degrees, share) for degrees, share in table.tolist())


def _lateral(name: str, value: object) -> tuple[float, float]:
    """Return the shares of red and blue, between -0.5 and 0.5."""
    red, blue = numbers(name, value, (2,)).tolist()
    return number(name, red, above=-0.5, below=0.5), number(name, blue, above=-0.5, below=0.5)


def _blur(name: str, value: object) -> tuple[float, ...]:
    """Return standard deviations, px, of one number or a few."""
    sigmas = numbers(name, value if isinstance(value, list | tuple) else [value], (None,)).tolist()
    if not 1 <= len(sigmas) <= _MOST_KERNELS:
        raise wrong(name, f"1 to {_MOST_KERNELS} standard deviations", value)
    return tuple(number(name, sigma, least=0) for sigma in sigmas)


def _option(reader: Callable[..., Any], help: str, **limits: Any) -> Any:
    """Return a field that may be None, whose preset or default then counts."""
    return checked(optional(partial(reader, **limits)), default=None, help=help)


_MOSAICS = ("none", "mono", *_PATTERNS)


@record
class Sensor:
    """Parameters of a lens and a sensor; plain values, as in the job's key ``sensor``.

    What is not given is the preset's, or stands in brackets. Twice the exposure time doubles ``exposure_s``
    and ``electrons``, a stop of aperture ``electrons``, twice the ISO ``gain``.

    Raises:
        ArgumentError: an unknown preset, or a value outside its domain.
    """

    preset: str | None = _option(one_of, f"parameters of a sensor: {', '.join(PRESETS)}", words=(*PRESETS,))
    seed: int = checked(whole_number, least=0, default=0, help="seed of all noise")
    electrons: Any = _option(_electrons, "electrons at light 1.0, or those of red, green, blue [full_well]")
    exposure_s: Any = _option(number, "seconds of dark current [0.01]", above=0)
    full_well: Any = _option(number, "most electrons of a pixel [10000]", above=0)
    dark_current: Any = _option(number, "electrons a second [0]", least=0)
    read_noise: Any = _option(number, "standard deviation of each pixel, electrons [0]", least=0)
    row_noise: Any = _option(number, "standard deviation of each row, electrons [0]", least=0)
    prnu: Any = _option(number, "standard deviation of the pixels' gain, a share [0]", least=0)
    dsnu: Any = _option(number, "standard deviation of the pixels' dark signal, electrons [0]", least=0)
    gain: Any = _option(number, "codes per electron [a full well gives the highest code]", above=0)
    black_level: Any = _option(number, "code without light [0]", least=0)
    bits: Any = _option(whole_number, "bits of a code, 8 to 16 [12]", least=_FEWEST_BITS, most=_MOST_BITS)
    mosaic: Any = _option(one_of, f"{', '.join(_MOSAICS)} [none: three codes a pixel]", words=_MOSAICS)
    shading: Any = _option(_shading, "natural, (degrees, share) pairs, or a vignette.png [none]")
    lateral: Any = _option(_lateral, "by what share the focal lengths of red and blue are longer [0, 0]")
    blur: Any = _option(_blur, "standard deviation, px; several: from centre to corner [0]")
    glare: Any = _option(number, "share of light spread over the image [0]", least=0, most=1)

    def __post_init__(self) -> None:
        given = PRESETS[self.preset] if self.preset else {}
        for name, value in {**_DEFAULTS, **given}.items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, value)
        if self.electrons is None:
            object.__setattr__(self, "electrons", self.full_well)
        if self.black_level >= 2**self.bits - 1:
            raise wrong("black_level", f"less than {2**self.bits - 1}", self.black_level)
        if self.gain is None:
            object.__setattr__(self, "gain", (2**self.bits - 1 - self.black_level) / self.full_well)

    @property
    def electrons_by_channel(self) -> tuple[float, float, float]:
        """Electrons of light 1.0 behind the red, green and blue filter."""
        if not isinstance(self.electrons, tuple):
            return self.electrons, self.electrons, self.electrons
        red, green, blue = self.electrons
        return red, green, blue

    def to_dict(self) -> dict[str, Any]:
        """Return its parameters as plain values; of a vignette's file the checksum, not the path.

        Raises:
            ArgumentError: the file cannot be read.
        """
        values = asdict(self)
        if isinstance(self.shading, str) and self.shading != optics.NATURAL:
            try:
                content = read_bytes(Path(self.shading), MOST_PICTURE_BYTES)
            except ArgumentError as cause:
                wanted = "expected natural, a table, or a file that can be read"
                raise ArgumentError(f"shading: {wanted}, got {shown(self.shading)}: {cause}") from cause
            values["shading"] = {"sha256": hashlib.sha256(content).hexdigest()}
        return {key: _plain(value) for key, value in values.items()}

    def exposed(self, stops: float) -> Sensor:
        """Return the sensor exposed for 2^stops times as long."""
        electrons = tuple(count * 2.0**stops for count in self.electrons_by_channel)
        return replace(self, exposure_s=self.exposure_s * 2.0**stops, electrons=electrons)

    def check(self, camera: Camera) -> None:
        """Refuse a camera that cannot have the sensor's shading or lateral colour."""
        self.lateral_cameras(camera)
        if self.shading == optics.NATURAL:
            optics.check_natural(camera)

    def lateral_cameras(self, camera: Camera) -> tuple[Camera, Camera] | None:
        """Return the cameras that red and blue light see through; None without lateral colour."""
        if self.lateral == (0.0, 0.0):
            return None
        red_share, blue_share = self.lateral
        return optics.magnified(camera, red_share), optics.magnified(camera, blue_share)

    def irradiance(self, camera: Camera, light: Floats) -> Floats:
        """Return the light (H, W, 3) float32 on the sensor: after shading, blur and glare.

        Args:
            camera: the lens.
            light: (H, W, 3) float32 that it sees.
        """
        if self.shading is not None:
            light = light * optics.shading(camera, self.shading)[..., None]
        if not self.glare and not any(self.blur):
            return light
        valid = camera.valid()
        if any(self.blur):
            light = optics.blur(light, self.blur, valid)
        if self.glare:
            light = optics.glare(light, self.glare, valid)
        return light

    def expose(
        self, light: Pixels, camera: str = "", frame: Any = None, transfer: str = "linear"
    ) -> NDArray[np.uint16]:
        """Return the codes of light on the sensor.

        Args:
            light: (h, w, 3) floats, 1.0 is the white of 8 bits; or uint8 codes of a transfer.
            camera: its name; PRNU and DSNU are the same in all its frames.
            frame: plain values that identify the frame; all other noise follows from them.
            transfer: of codes.

        Returns:
            (h, w) uint16; (h, w, 3) without a mosaic.
        """
        key = noise.key(self.seed, camera, frame)
        key_of_camera = noise.key(self.seed, camera)
        codes = []
        for i, (plane, pattern) in enumerate(self._planes(light, transfer)):
            linear = np.ascontiguousarray(decode(plane, transfer))
            codes.append(self._expose(linear, pattern, i, key, key_of_camera))
        return codes[0] if len(codes) == 1 else np.stack(codes, axis=-1)

    def _planes(self, light: Pixels, transfer: str) -> list[tuple[Pixels, tuple[int, ...]]]:
        """Return the planes (h, w) that the sensor has, and their channels as :data:`_PATTERNS`."""
        if self.mosaic == "none":
            return [(light[..., channel], (channel,) * 4) for channel in range(3)]
        if self.mosaic == "mono":
            return [(decode(light, transfer) @ np.array(_LUMINANCE, np.float32), (1, 1, 1, 1))]
        pattern = _PATTERNS[self.mosaic]
        plane = np.empty(light.shape[:2], light.dtype)
        for i, channel in enumerate(pattern):
            pixels = (slice(i // 2, None, 2), slice(i % 2, None, 2))
            plane[pixels] = light[..., channel][pixels]
        return [(plane, pattern)]

    def _expose(
        self, light: Floats, pattern: tuple[int, ...], plane: int, key: Any, fixed: Any
    ) -> NDArray[np.uint16]:
        """Return the codes (h, w) uint16 of a plane.

        Args:
            light: (h, w) on the plane.
            pattern: the channels of its even rows, then of odd ones.
            plane: its number.
            key: of the noise of this frame.
            fixed: the key of the noise that all frames of the camera share.
        """
        codes = np.empty(light.shape, np.uint16)
        (height, width) = light.shape
        step = max(1, _BLOCK_PX // width)
        electrons = np.array([self.electrons_by_channel[channel] for channel in pattern]).reshape(2, 2)
        dark = self.dark_current * self.exposure_s
        of_sensor = (dark, self.full_well, self.read_noise, self.gain, self.black_level, 2.0**self.bits - 1)
        patterns = _fixed_patterns(tuple(fixed.tolist()), plane, light.shape, (self.prnu, self.dsnu))
        for first in range(0, height, step):
            rows = slice(first, min(first + step, height))
            count = rows.stop - first
            words = noise.words(key, noise.PIXEL, plane, first * width, count * width).reshape(-1, width)
            offsets = self.row_noise * noise.normals(key, noise.ROW, plane, first, count)
            of_rows = np.column_stack([electrons[np.arange(first, rows.stop) & 1], offsets])
            arrays = (light[rows], words, patterns[rows], of_rows, codes[rows])
            run(noise.expose, arrays, noise.quantiles(), np.array(of_sensor))
        return codes

    def develop(self, codes: NDArray[np.uint16]) -> NDArray[np.uint8]:
        """Return the picture (H, W, 3), sRGB, of codes: demosaicing, black level, white balance, transfer.

        White is light of 1, as in ``lit``, or what fills the well, if that is less. Demosaicing is OpenCV's,
        edge-aware.
        """
        import cv2  # slow to load

        shift = 16 - self.bits
        scaled = codes << np.uint16(shift)
        if self.mosaic in _PATTERNS:
            scaled = cv2.demosaicing(scaled, getattr(cv2, f"COLOR_Bayer{self.mosaic.upper()}2RGB_EA"))
        elif self.mosaic == "mono":
            scaled = np.repeat(scaled[..., None], 3, axis=-1)
        most = min(self.full_well, (2**self.bits - 1 - self.black_level) / self.gain)
        white = self.gain * min(1.0, most / max(self.electrons_by_channel))
        tones = [_tone(count * white, self.black_level, shift) for count in self.electrons_by_channel]
        return np.asarray(cv2.LUT(scaled, np.stack(tones, axis=-1)[None]))

    def apply(
        self, image: Image, camera: str = "", time: float | None = None, lateral: Sequence[Image] = ()
    ) -> Image:
        """Return an image with the further layers ``raw``, of a mosaic, and ``sensor``, the picture.

        Noise follows from seed, camera, the image's pose and its time.

        Args:
            image: with ``lit``; of an unknown transfer it is taken as sRGB.
            camera: its name.
            time: seconds, of images at one pose.
            lateral: images of :meth:`lateral_cameras` at the same pose.

        Raises:
            ArgumentError: an image without ``lit``.
        """
        seen: Any = image
        light = seen["lit"]
        transfer = "srgb" if seen.transfer == "unknown" else seen.transfer
        if lateral:
            light = light.copy()
        others: Any = zip((0, 2), lateral, strict=False)
        for channel, other in others:
            both = other.valid & seen.valid
            light[..., channel][both] = other["lit"][..., channel][both]
        if self.shading is not None or self.glare or any(self.blur):
            light = self.irradiance(seen.camera, decode(light, transfer))
        frame = [seen.pose.position.tolist(), seen.pose.rotation.tolist(), time]
        codes = self.expose(light, camera, frame, transfer=transfer)
        layers = {**seen.layers, "sensor": self.develop(codes)}
        if codes.ndim == 2:
            layers["raw"] = codes
        provenance = {**seen.provenance, "sensor": self.to_dict()}
        sensed: Image = replace(seen, layers=layers, provenance=provenance)
        return sensed


_DEFAULTS: Mapping[str, Any] = {
    "exposure_s": 0.01, "full_well": 10_000.0, "dark_current": 0.0, "read_noise": 0.0, "row_noise": 0.0,
    "prnu": 0.0, "dsnu": 0.0, "black_level": 0.0, "bits": 12, "mosaic": "none", "lateral": (0.0, 0.0),
    "blur": (0.0,), "glare": 0.0,
}  # fmt: skip


def _plain(value: Any) -> Any:
    """Return tuples as lists."""
    return [_plain(item) for item in value] if isinstance(value, tuple) else value


@lru_cache(8)
def _fixed_patterns(
    key: tuple[int, ...], plane: int, size: tuple[int, int], scales: tuple[float, float]
) -> Floats:
    """Return (height, width, 2), the PRNU and DSNU of a camera; cached, because all its frames have them."""
    patterns = np.zeros((*size, 2), np.float32)
    for i, (purpose, scale) in enumerate(zip((noise.PRNU, noise.DSNU), scales, strict=True)):
        if scale:
            values = noise.normals(np.array(key, np.uint64), purpose, plane, 0, size[0] * size[1])
            patterns[..., i] = np.asarray(scale * values, np.float32).reshape(size)
    return patterns


@lru_cache(8)
def _tone(white: float, black: float, shift: int) -> NDArray[np.uint8]:
    """Return sRGB (65536,) of a channel's codes, shifted to 16 bits; white is ``white`` above ``black``."""
    light = (np.arange(1 << 16) / 2.0**shift - black) / white
    return np.asarray(encode(np.asarray(light, np.float32), "srgb"))
