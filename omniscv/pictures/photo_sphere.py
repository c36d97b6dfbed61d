"""Photo Sphere metadata: which part of a sphere a panorama shows, and how its camera was held.

Source: https://developers.google.com/streetview/spherical-metadata. The packet of XMP is read as text,
without a parser of XML: entities of a hostile file mean nothing here.
"""

import re
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import number, shown
from omniscv.errors import ArgumentError, BadReplyError
from omniscv.pictures import MAX_PIXELS, png
from omniscv.pictures.forms import Pixels
from omniscv.storage.bounded import MOST_PICTURE_BYTES, open_regular

_NAMESPACE = r"http://ns\.google\.com/(?:photos/1\.0/panorama|videos/1\.0/spherical)/"
_PREFIX = re.compile(rf"xmlns:([\w-]+)\s*=\s*[\"']{_NAMESPACE}[\"']")
_PACKET = re.compile(rb"<x:xmpmeta.*?</x:xmpmeta>|<rdf:RDF.*?</rdf:RDF>", re.DOTALL)
_JPEG = b"\xff\xd8"
_JPEG_XMP = b"http://ns.adobe.com/xap/1.0/\0"
_JPEG_APP1 = 0xE1
_JPEG_SCAN = 0xDA
_PNG_XMP = b"XML:com.adobe.xmp"
_MOST_XMP = 1 << 22  # bytes
_TEXTS = (".npy", ".hdf5", ".h5", ".exr", ".hdr")
"""Suffixes of files that hold no XMP."""
_WHOLE_PX = 0.02  # by which an edge of a resized crop may lie beside a pixel's

_CROP = (
    "CroppedAreaLeftPixels",
    "CroppedAreaTopPixels",
    "CroppedAreaImageWidthPixels",
    "CroppedAreaImageHeightPixels",
)
_FULL = ("FullPanoWidthPixels", "FullPanoHeightPixels")
_EYES = {"top-bottom": "the upper half", "left-right": "the left half"}
_MONO = ("", "mono", "none")


class PhotoSphere(NamedTuple):
    """What a picture says of itself.

    Attributes:
        full: width and height of the whole sphere, px; zeros where it is not said.
        crop: left, top, width and height of the picture in it, px; zeros where it is not said.
        heading_deg: of the middle of the whole, clockwise from north; None where it is not said.
        pitch_deg: of the middle, above the horizon.
        roll_deg: of the camera, right side down.
    """

    full: tuple[float, float] = (0.0, 0.0)
    crop: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    heading_deg: float | None = None
    pitch_deg: float = 0.0
    roll_deg: float = 0.0

    @property
    def is_cropped(self) -> bool:
        """Whether the picture shows a part of the sphere."""
        return any(self.crop) and self.crop != (0.0, 0.0, *self.full)

    @property
    def is_posed(self) -> bool:
        """Whether it says how the camera was held."""
        return self.heading_deg is not None or bool(self.pitch_deg or self.roll_deg)

    @property
    def angles_deg(self) -> tuple[float, float, float]:
        """Yaw, pitch and roll as of :meth:`omniscv.geometry.Pose.from_angles`, where X is north."""
        return -(self.heading_deg or 0.0), self.pitch_deg, self.roll_deg

    @property
    def share(self) -> float:
        """The share of the whole picture, 2:1, that is there."""
        return self.crop[2] * self.crop[3] / (self.full[0] * self.full[1]) if self.is_cropped else 1.0

    def whole(self, pixels: Pixels) -> tuple[Pixels, NDArray[np.bool_]]:
        """Return the whole panorama, 2:1, and which of its pixels the picture shows; the others are 0.

        Args:
            pixels: (H, W, ...) of the picture, or of another one of the same view, in another size.

        Raises:
            ArgumentError: a size that the metadata do not fit.
        """
        height, width = pixels.shape[:2]
        if not self.is_cropped:
            return pixels, np.ones((height, width), np.bool_)
        scale = width / self.crop[2]
        edges = scale * np.array([*self.full, *self.crop])
        whole = np.round(edges).astype(int)
        if np.abs(edges - whole).max() > _WHOLE_PX or whole[5] != height:
            expected = (
                f"expected a picture of {self.crop[2]:g} x {self.crop[3]:g} px, as its Photo Sphere data"
            )
            raise ArgumentError(f"{expected}, got {width} x {height}; resize it, or remove the data")
        full_width, full_height, left, top = whole[:4].tolist()
        if full_width * full_height > MAX_PIXELS:
            raise ArgumentError(
                f"FullPanoWidthPixels: expected {MAX_PIXELS} pixels at most, got {full_width} x {full_height}"
            )
        result = np.zeros((full_height, full_width, *pixels.shape[2:]), pixels.dtype)
        is_shown = np.zeros((full_height, full_width), np.bool_)
        columns = (left + np.arange(width)) % full_width  # a crop may lie across the seam
        result[top : top + height, columns] = pixels
        is_shown[top : top + height, columns] = True
        return result, is_shown


def read_photo_sphere(file: Path) -> PhotoSphere | None:
    """Return what a picture says of the sphere that it shows; None of a picture that says nothing.

    Raises:
        ArgumentError: it is no equirectangular panorama of one eye, or what it says contradicts itself.
    """
    fields = _fields(_packet(file))
    if not fields:
        return None
    projection = fields.get("ProjectionType", "equirectangular")
    if projection.lower() != "equirectangular":
        raise ArgumentError(f"ProjectionType: expected equirectangular, got {shown(projection)}")
    stereo = fields.get("StereoMode", "").lower()
    if stereo not in _MONO:
        half = _EYES.get(stereo, "the picture of one eye")
        raise ArgumentError(
            f"StereoMode: expected mono, got {shown(stereo)}; cut {half} out, and remove the key"
        )
    full = (_of(fields, _FULL[0]), _of(fields, _FULL[1]))
    crop = (_of(fields, _CROP[0]), _of(fields, _CROP[1]), _of(fields, _CROP[2]), _of(fields, _CROP[3]))
    _check(full, crop)
    heading_deg = _of(fields, "PoseHeadingDegrees") if "PoseHeadingDegrees" in fields else None
    pitch_deg = number("PosePitchDegrees", fields.get("PosePitchDegrees", "0"), least=-90, most=90)
    return PhotoSphere(full, crop, heading_deg, pitch_deg, _of(fields, "PoseRollDegrees"))


def _check(full: tuple[float, float], crop: tuple[float, float, float, float]) -> None:
    """Raise ArgumentError for a part that is none of a sphere."""
    left, top, width, height = crop
    if not any(crop):
        return
    if min(width, height, *full) <= 0:
        raise ArgumentError(f"{_FULL[0]}: expected sizes of the whole and of the crop, got {full} and {crop}")
    if abs(full[0] - 2 * full[1]) > 1:
        raise ArgumentError(f"{_FULL[0]}: expected twice the height, got {full[0]:g} x {full[1]:g}")
    inside = 0 <= left < full[0] and top >= 0 and top + height <= full[1] and width <= full[0]
    if not inside:
        raise ArgumentError(f"{_CROP[0]}: expected a crop within {full[0]:g} x {full[1]:g} px, got {crop}")


def _of(fields: Mapping[str, str], name: str) -> float:
    return number(name, fields.get(name, "0"))


def _fields(packet: str) -> dict[str, str]:
    """Return the fields of a packet of XMP that Google's namespaces have: attributes, or elements of text."""
    fields: dict[str, str] = {}
    for prefix in dict.fromkeys(_PREFIX.findall(packet)):
        attribute = rf"\b{prefix}:(\w+)\s*=\s*(?:\"([^\"]*)\"|'([^']*)')"
        for name, double, single in re.findall(attribute, packet):
            fields[name] = double or single
        for name, content in re.findall(rf"<{prefix}:(\w+)[^>/]*>([^<]*)</{prefix}:", packet):
            fields[name] = content.strip()
    return fields


def _packet(file: Path) -> str:
    """Return the packet of XMP of a picture; empty without one."""
    if file.suffix.lower() in _TEXTS:
        return ""
    with open_regular(file, most=MOST_PICTURE_BYTES) as opened:
        content = opened.read()
    if content.startswith(_JPEG):
        return _jpeg_packet(content)
    if content.startswith(png.SIGNATURE):
        return _png_packet(content)
    match = _PACKET.search(content)
    return match[0][:_MOST_XMP].decode("utf-8", "replace") if match else ""


def _jpeg_packet(content: bytes) -> str:
    """Return the packet of the first segment of a JPEG that holds one."""
    at = len(_JPEG)
    while content[at : at + 1] == b"\xff" and at + 4 <= len(content):
        kind = content[at + 1]
        size = int.from_bytes(content[at + 2 : at + 4], "big")
        segment = content[at + 4 : at + 2 + size]
        if kind == _JPEG_APP1 and segment.startswith(_JPEG_XMP):
            return segment.removeprefix(_JPEG_XMP).decode("utf-8", "replace")
        if kind == _JPEG_SCAN:
            break
        at += 2 + size
    return ""


def _png_packet(content: bytes) -> str:
    """Return the packet of a PNG's text, which may be compressed."""
    try:
        for name, data in png.chunks(content):
            keyword, _, after = bytes(data).partition(b"\0") if name == b"iTXt" else (b"", b"", b"")
            if keyword != _PNG_XMP or len(after) < 2:
                continue
            text = after[2:].partition(b"\0")[2].partition(b"\0")[2]
            if after[0]:
                text = zlib.decompressobj().decompress(text, _MOST_XMP)
            return text.decode("utf-8", "replace")
    except (BadReplyError, zlib.error):
        return ""  # reading the pixels says what is wrong with the file
    return ""
