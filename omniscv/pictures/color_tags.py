"""What files say of their colours, and what is done with it: one list of tags for all forms.

========== ============================== ===============================================================
form       tag                            what is done
========== ============================== ===============================================================
PNG        ``cICP``                       sRGB stays; linear, powers, BT.2020 and Display P3 are converted;
                                          PQ, HLG and other curves are refused
PNG        ``iCCP``                       as ICC profiles
PNG        ``sRGB``                       stays
PNG        ``gAMA``, ``cHRM``             1/2.2 stays, other powers and primaries are converted
JPEG, TIFF ICC profile                    sRGB stays, others are converted by LittleCMS; refused where that
and so on                                 fails, or for floats
EXR        ``chromaticities``             converted to those of Rec. 709, white stays white
Radiance   ``EXPOSURE``, ``COLORCORR``    divided out
Radiance   ``PRIMARIES``                  as those of EXR
Radiance   ``GAMMA``, ``FORMAT`` of XYZ   refused
TGA        gamma other than 1 and 2.2     refused
========== ============================== ===============================================================

:func:`omniscv.sources.tagged_colors.converted` does it. Of several tags of a PNG the first in this order
counts. 8-bit colours are sRGB without a tag, and floats are light of Rec. 709. What is turned, or no RGB at
all, :mod:`omniscv.pictures.foreign` refuses.
"""

import re
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from zlib_ng import zlib_ng

from omniscv.arguments import shown
from omniscv.errors import ArgumentError
from omniscv.pictures import png
from omniscv.storage.bounded import open_regular

REC_709 = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)
_BT_2020 = (0.708, 0.292, 0.17, 0.797, 0.131, 0.046, 0.3127, 0.329)
_DISPLAY_P3 = (0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3127, 0.329)
"""x and y of red, green, blue and white."""
_SAME_XY = 2e-3  # of chromaticities that are rounded

_CICP_PRIMARIES = {1: REC_709, 2: REC_709, 9: _BT_2020, 12: _DISPLAY_P3}
_CICP_CURVES = {2: 0.0, 13: 0.0, 8: 1.0, 4: 2.2, 5: 2.8}
"""By number of H.273: the power of a code that is light, 0 of sRGB."""
_GAMMA = 1 / 2.2  # of a PNG that is taken as sRGB
_SAME_GAMMA = 2e-3  # of gammas that are rounded
_LONGEST_PROFILE = 1 << 24  # bytes
_RADIANCE_HEADER = 1 << 14  # bytes
_RADIANCE_WORD = re.compile(r"\s*([A-Z]+)\s*=\s*(.*?)\s*")


class Colors(NamedTuple):
    """What a file says of its colours.

    Attributes:
        power: of a code that is light; 0: codes are sRGB. Floats are light.
        primaries: x and y of red, green, blue and white.
        gain: by which light is multiplied, of red, green and blue.
        profile: of ICC, in place of the others.
        refused: what cannot be converted, for people.
        tag: the name of the tag, for people.
    """

    power: float = 0.0
    primaries: Sequence[float] = REC_709
    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)
    profile: bytes = b""
    refused: str = ""
    tag: str = ""

    @property
    def is_plain(self) -> bool:
        """Whether colours are as they are without a tag."""
        same = np.abs(np.subtract(self.primaries, REC_709)).max() <= _SAME_XY
        return same and not (self.power or self.profile or self.refused) and self.gain == (1, 1, 1)


def of_png(payload: bytes) -> Colors:
    """Return what the chunks of a PNG say."""
    chunks: dict[bytes, bytes] = {}
    for name, data in png.chunks(payload):
        if name != b"IDAT":
            chunks[name] = bytes(data)
    cicp = chunks.get(b"cICP", b"")
    if len(cicp) == 4:
        code, curve, matrix, full = cicp
        if code in _CICP_PRIMARIES and curve in _CICP_CURVES and matrix == 0 and full == 1:
            return Colors(_CICP_CURVES[curve], _CICP_PRIMARIES[code], tag="cICP")
        return Colors(refused=f"cICP {'-'.join(map(str, cicp))}")
    if b"iCCP" in chunks:
        packed = chunks[b"iCCP"].partition(b"\0")[2][1:]
        return Colors(profile=_inflated(packed), tag="its ICC profile")
    if b"sRGB" in chunks or len(chunks.get(b"gAMA", b"")) != 4:
        return Colors()
    gamma = struct.unpack(">I", chunks[b"gAMA"])[0] / 100_000
    if gamma == 0:
        return Colors(refused="gAMA 0")
    power = 0.0 if abs(gamma - _GAMMA) <= _SAME_GAMMA else 1 / gamma
    primaries: Sequence[float] = REC_709
    if len(chunks.get(b"cHRM", b"")) == 32:
        white_first = [value / 100_000 for value in struct.unpack(">8I", chunks[b"cHRM"])]
        primaries = (*white_first[2:], *white_first[:2])
    return Colors(power, primaries, tag="gAMA")


def _inflated(packed: bytes) -> bytes:
    """Return an ICC profile, at most ``_LONGEST_PROFILE`` bytes of it."""
    try:
        return zlib_ng.decompressobj().decompress(packed, _LONGEST_PROFILE)
    except zlib_ng.error as cause:  # type: ignore[misc]  # its stub says an instance
        raise ArgumentError(f"expected an ICC profile, got one that does not decode: {cause}") from cause


def of_spec(file: Path, spec: Any, form: str) -> Colors:
    """Return what a file of another form than PNG says.

    Args:
        file: its path, from which Radiance's header is read.
        spec: OpenImageIO's description of the picture, ``ImageSpec``.
        form: OpenImageIO's name of the form.
    """
    if form == "hdr":
        return _of_radiance(file)
    if form == "openexr":
        xy = spec.getattribute("chromaticities")
        is_known = isinstance(xy, tuple) and len(xy) == 8
        return Colors(primaries=xy, tag="chromaticities") if is_known else Colors()
    gamma = spec.get_float_attribute("oiio:Gamma", 0.0)
    if form == "targa" and gamma and min(abs(gamma - 1), abs(gamma - 2.2)) > 0.01:
        return Colors(refused=f"a gamma of {gamma:g}")
    profile = spec.getattribute("ICCProfile")
    if profile is None:
        return Colors()
    return Colors(profile=np.asarray(profile, np.uint8).tobytes(), tag="its ICC profile")


def _of_radiance(file: Path) -> Colors:
    """Return what the header of a Radiance picture says."""
    with open_regular(file) as opened:
        header = opened.read(_RADIANCE_HEADER).partition(b"\n\n")[0].decode("latin-1")
    gain = np.ones(3)
    primaries: Sequence[float] = REC_709
    for line in header.splitlines():
        match = _RADIANCE_WORD.fullmatch(line)
        if match is None:
            continue
        word, text = match.groups()
        if word in ("EXPOSURE", "COLORCORR"):
            gain /= _numbers(word, text, 1 if word == "EXPOSURE" else 3)
        elif word == "PRIMARIES":
            primaries = _numbers(word, text, 8).tolist()
        elif (word == "GAMMA" and _numbers(word, text, 1) != 1) or (word == "FORMAT" and "xyz" in text):
            return Colors(refused=f"{word}={text}")
    red, green, blue = gain.tolist()
    return Colors(primaries=primaries, gain=(red, green, blue), tag="EXPOSURE and PRIMARIES")


def _numbers(word: str, text: str, count: int) -> NDArray[np.float64]:
    """Return so many numbers above 0 of a word of Radiance's header; ArgumentError for others."""
    try:
        values = np.array([float(value) for value in text.split()])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or not (np.isfinite(values) & (values > 0)).all():
        raise ArgumentError(f"{word}: expected {count} numbers above 0, got {shown(text)}")
    return values
