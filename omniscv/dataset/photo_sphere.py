"""Photo Sphere metadata: what viewers need to show an equirectangular picture as a sphere.

The namespace is GPano, https://developers.google.com/streetview/spherical-metadata. The packet goes into
the file beside its pixels, which stay as they are: an ``iTXt`` chunk of PNG, an ``APP1`` segment of JPEG.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from xml.sax.saxutils import quoteattr

from omniscv.arguments import number
from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.storage.local import whole_file

SUFFIXES = ("png", "jpg")
"""Of the files that can hold the metadata."""

_NAMESPACE = "http://ns.google.com/photos/1.0/panorama/"
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_HEADER_END = 8 + 25  # the signature, and IHDR
_JPEG_START = b"\xff\xd8"
_JPEG_XMP = b"http://ns.adobe.com/xap/1.0/\0"
_JPEG_JFIF = b"\xff\xe0"


def refuses(camera: Camera) -> str | None:
    """Return why a camera's pictures cannot be spheres, in one line; None where they can."""
    if camera.name != "equirectangular":
        return f"Photo Sphere metadata: expected an equirectangular camera, got {camera.name}"
    return None


def fields(camera: Camera, pose: Pose, north_deg: float = 0.0) -> dict[str, str]:
    """Return the GPano fields of a picture.

    Args:
        camera: an equirectangular one.
        pose: of the camera.
        north_deg: the compass heading of the world's X axis, degrees clockwise from north.

    Raises:
        ArgumentError: another camera.
    """
    if reason := refuses(camera):
        raise ArgumentError(reason)
    yaw, pitch, roll = pose.angles()
    width, height = str(camera.width), str(camera.height)
    return {
        "ProjectionType": "equirectangular",
        "UsePanoramaViewer": "True",
        "CroppedAreaImageWidthPixels": width,
        "CroppedAreaImageHeightPixels": height,
        "FullPanoWidthPixels": width,
        "FullPanoHeightPixels": height,
        "CroppedAreaLeftPixels": "0",
        "CroppedAreaTopPixels": "0",
        "PoseHeadingDegrees": _degrees((number("north_deg", north_deg) - yaw) % 360),
        "PosePitchDegrees": _degrees(pitch),
        "PoseRollDegrees": _degrees(roll),
    }


def packet(fields: dict[str, str]) -> bytes:
    """Return fields as an XMP packet, UTF-8."""
    written = " ".join(f"GPano:{name}={quoteattr(value)}" for name, value in fields.items())
    return (
        '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        f'<rdf:Description rdf:about="" xmlns:GPano="{_NAMESPACE}" {written}/></rdf:RDF></x:xmpmeta>'
    ).encode()


def tagged(picture: bytes, camera: Camera, pose: Pose, north_deg: float = 0.0) -> bytes:
    """Return a PNG or JPEG file with Photo Sphere metadata, its pixels untouched.

    Args:
        picture: the file's bytes, without an XMP packet.
        camera, pose, north_deg: as :func:`fields`.

    Raises:
        ArgumentError: another camera, or bytes that are neither PNG nor JPEG.
    """
    xmp = packet(fields(camera, pose, north_deg))
    if picture.startswith(_PNG_SIGNATURE):
        chunk = (
            b"iTXt" + b"XML:com.adobe.xmp\0" + bytes(4) + xmp
        )  # not compressed, no language, no other keyword
        written = struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk))
        return picture[:_PNG_HEADER_END] + written + picture[_PNG_HEADER_END:]
    if picture.startswith(_JPEG_START):
        start = len(_JPEG_START)
        if picture[start : start + 2] == _JPEG_JFIF:  # JFIF's own segment comes first
            start += 2 + struct.unpack_from(">H", picture, start + 2)[0]
        segment = b"\xff\xe1" + struct.pack(">H", 2 + len(_JPEG_XMP) + len(xmp)) + _JPEG_XMP + xmp
        return picture[:start] + segment + picture[start:]
    raise ArgumentError(f"picture: expected a PNG or JPEG file, got one that starts with {picture[:8]!r}")


def tag(path: Path, camera: Camera, pose: Pose, north_deg: float = 0.0) -> None:
    """Add Photo Sphere metadata to a file; see :func:`tagged`."""
    found = tagged(path.read_bytes(), camera, pose, north_deg)
    with whole_file(path) as part:
        part.write_bytes(found)


def _degrees(value: float) -> str:
    return f"{round(value, 6) + 0.0:.6f}".rstrip("0").rstrip(".")
