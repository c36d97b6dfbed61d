"""From light to a sensor's codes, and from its codes to a picture: mosaic, noise, ADC; development."""

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from omniscv.geometry.arrays import Floats, Pixels, run
from omniscv.light import decode, encode
from omniscv.sensor import noise

if TYPE_CHECKING:
    from omniscv.sensor.sensor import Sensor

MOSAICS = {"rggb": (0, 1, 1, 2), "bggr": (2, 1, 1, 0), "grbg": (1, 0, 2, 1), "gbrg": (1, 2, 0, 1)}
"""The channel of the pixels (0, 0), (0, 1), (1, 0), (1, 1) in (row, column), repeated over the image."""

LUMINANCE = (0.2126, 0.7152, 0.0722)
"""What a sensor without filters sees of red, green and blue light of 1: the luminance of Rec. 709."""

_BLOCK_PX = 1 << 21
"""Pixels whose random words are in memory at a time."""


def expose(
    sensor: "Sensor",
    light: Pixels,
    camera: str = "",
    frame: Any = None,
    corner: tuple[int, int] = (0, 0),
    width: int | None = None,
    transfer: str = "linear",
) -> NDArray[np.uint16]:
    """Return the codes of light on the sensor, or on a part of it: those of the whole, to the bit.

    Args:
        sensor: with its parameters.
        light: (h, w, 3) floats, 1.0 is the white of 8 bits; or uint8 codes of a transfer.
        camera: its name; PRNU and DSNU are the same in all its frames.
        frame: plain values that say what the frame is; all else that is random follows from it.
        corner: (row, column) of the part's first pixel.
        width: of the whole sensor; the light's if not given.
        transfer: of codes.

    Returns:
        (h, w) uint16; (h, w, 3) without a mosaic.
    """
    width = light.shape[1] if width is None else width
    if sensor.mosaic == "none":
        planes = [light[..., channel] for channel in range(3)]
        patterns = [(channel,) * 4 for channel in range(3)]
    elif sensor.mosaic == "mono":
        planes = [decode(light, transfer) @ np.array(LUMINANCE, np.float32)]
        patterns = [(1, 1, 1, 1)]
    else:
        pattern = MOSAICS[sensor.mosaic]
        at = [pattern[2 * ((corner[0] + i // 2) % 2) + (corner[1] + i % 2) % 2] for i in range(4)]
        plane = np.empty(light.shape[:2], light.dtype)
        for i, channel in enumerate(at):
            plane[i // 2 :: 2, i % 2 :: 2] = light[i // 2 :: 2, i % 2 :: 2, channel]
        planes, patterns = [plane], [pattern]
    of_frame, fixed = noise.key(sensor.seed, camera, frame), noise.key(sensor.seed, camera)
    codes = []
    for k, (pixels, pattern) in enumerate(zip(planes, patterns, strict=True)):
        plane = np.ascontiguousarray(decode(pixels, transfer))
        codes.append(_plane(sensor, plane, pattern, k, of_frame, fixed, corner, width))
    return codes[0] if len(codes) == 1 else np.stack(codes, axis=-1)


def _plane(
    sensor: "Sensor", light: Floats, pattern: tuple[int, ...], plane: int, key: Any, fixed: Any,
    corner: tuple[int, int], width: int,
) -> NDArray[np.uint16]:  # fmt: skip
    """Return the codes of a plane; ``pattern`` has the channels of its even rows, then of its odd ones."""
    codes, (top, left) = np.empty(light.shape, np.uint16), corner
    height, columns = light.shape
    step = max(1, _BLOCK_PX // width)
    electrons = np.array([sensor.electrons_by_channel[channel] for channel in pattern]).reshape(2, 2)
    patterns = [
        _fixed_pattern(tuple(fixed.tolist()), purpose, plane, top * width, height, width, scale)
        for purpose, scale in ((noise.PRNU, sensor.prnu), (noise.DSNU, sensor.dsnu))
    ]
    for first in range(0, height, step):
        rows = slice(first, min(first + step, height))
        numbers, across = np.arange(top + first, top + rows.stop), slice(left, left + columns)
        words = noise.words(key, noise.PIXEL, plane, int(numbers[0]) * width, len(numbers) * width)
        offsets = sensor.row_noise * noise.normals(key, noise.ROW, plane, int(numbers[0]), len(numbers))
        fixed_rows = [each[rows, across] for each in patterns]
        words = words.reshape(-1, width)[:, across]
        run(
            noise.expose, (light[rows], words, *fixed_rows, offsets, numbers, codes[rows]),
            noise.quantiles(), electrons, left, sensor.dark_current * sensor.exposure_s, sensor.full_well,
            sensor.read_noise, sensor.gain, sensor.black_level, 2.0**sensor.bits - 1,
        )  # fmt: skip
    return codes


@lru_cache(16)
def _fixed_pattern(
    key: tuple[int, ...], purpose: int, plane: int, start: int, height: int, width: int, scale: float
) -> Floats:
    """Return (height, width) of a camera's fixed pattern; kept, because all its frames have it."""
    if scale == 0:
        return np.zeros((height, width), np.float32)
    drawn = noise.normals(np.array(key, np.uint64), purpose, plane, start, height * width)
    return np.asarray(scale * drawn, np.float32).reshape(height, width)


def develop(sensor: "Sensor", codes: NDArray[np.uint16]) -> NDArray[np.uint8]:
    """Return the picture (H, W, 3), sRGB, of codes: demosaicing, black level, white balance, transfer.

    White is light of 1, as in ``lit``, or what fills the well, if that is less. Demosaicing
    is OpenCV's, edge-aware.
    """
    import cv2  # slow to load

    shift = 16 - sensor.bits
    scaled = codes << np.uint16(shift)
    if sensor.mosaic in MOSAICS:
        scaled = cv2.demosaicing(scaled, getattr(cv2, f"COLOR_Bayer{sensor.mosaic.upper()}2RGB_EA"))
    elif sensor.mosaic == "mono":
        scaled = np.repeat(scaled[..., None], 3, axis=-1)
    most = min(sensor.full_well, (2**sensor.bits - 1 - sensor.black_level) / sensor.gain)
    white = sensor.gain * min(1.0, most / max(sensor.electrons_by_channel))
    tones = [_tone(each * white, sensor.black_level, shift) for each in sensor.electrons_by_channel]
    return np.asarray(cv2.LUT(scaled, np.stack(tones, axis=-1)[None]))


@lru_cache(8)
def _tone(white: float, black: float, shift: int) -> NDArray[np.uint8]:
    """Return sRGB (65536,) of a channel's codes, shifted to 16 bits; white is ``white`` above ``black``."""
    light = (np.arange(1 << 16) / 2.0**shift - black) / white
    return np.asarray(encode(np.asarray(light, np.float32), "srgb"))
