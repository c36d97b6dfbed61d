"""Metadata that makes viewers show equirectangular pictures and videos as spheres.

Pictures get Photo Sphere metadata in the namespace GPano,
https://developers.google.com/streetview/spherical-metadata: an ``iTXt`` chunk of PNG, an ``APP1`` segment of
JPEG. Videos get the boxes ``st3d`` and ``sv3d`` of Spherical Video V2,
https://github.com/google/spatial-media, at the end of the video's sample entry. Pixels stay as they are.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np

from omniscv.arguments import number
from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.storage.local import whole_file

PICTURE_SUFFIXES = ("png", "jpg")
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


def photo_sphere_fields(camera: Camera, pose: Pose, north_deg: float = 0.0) -> dict[str, str]:
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


def with_photo_sphere(picture: bytes, camera: Camera, pose: Pose, north_deg: float = 0.0) -> bytes:
    """Return a PNG or JPEG file with Photo Sphere metadata, its pixels untouched.

    Args:
        picture: the file's bytes, without an XMP packet.
        camera, pose, north_deg: as :func:`photo_sphere_fields`.

    Raises:
        ArgumentError: another camera, or bytes that are neither PNG nor JPEG.
    """
    xmp = packet(photo_sphere_fields(camera, pose, north_deg))
    if picture.startswith(_PNG_SIGNATURE):
        not_compressed_no_language = bytes(4)
        chunk = b"iTXt" + b"XML:com.adobe.xmp\0" + not_compressed_no_language + xmp
        written = struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk))
        return picture[:_PNG_HEADER_END] + written + picture[_PNG_HEADER_END:]
    if picture.startswith(_JPEG_START):
        start = len(_JPEG_START)
        if picture[start : start + 2] == _JPEG_JFIF:  # JFIF's own segment comes first
            start += 2 + struct.unpack_from(">H", picture, start + 2)[0]
        segment = b"\xff\xe1" + struct.pack(">H", 2 + len(_JPEG_XMP) + len(xmp)) + _JPEG_XMP + xmp
        return picture[:start] + segment + picture[start:]
    raise ArgumentError(f"picture: expected a PNG or JPEG file, got one that starts with {picture[:8]!r}")


def tag_picture(path: Path, camera: Camera, pose: Pose, north_deg: float = 0.0) -> None:
    """Add Photo Sphere metadata to a file; see :func:`with_photo_sphere`."""
    tagged = with_photo_sphere(path.read_bytes(), camera, pose, north_deg)
    with whole_file(path) as part:
        part.write_bytes(tagged)


def _degrees(value: float) -> str:
    return f"{round(value, 6) + 0.0:.6f}".rstrip("0").rstrip(".")


# -- videos ----------------------------------------------------------------------------------------------

_MONO = 0
_BOXES = (b"mdia", b"minf", b"stbl")
_BEFORE_ENTRIES = 16  # bytes of stsd, its header included, before the first sample entry
_OFFSETS = {b"stco": ">u4", b"co64": ">u8"}


class _Box(NamedTuple):
    kind: bytes
    start: int
    end: int


def video_boxes() -> bytes:
    """Return the boxes of a full equirectangular video that looks along its middle."""
    head = _box(b"svhd", bytes(4) + b"omniscv" + b"\0")
    projection = _box(b"proj", _box(b"prhd", bytes(16)) + _box(b"equi", bytes(20)))
    return _box(b"st3d", bytes(4) + bytes([_MONO])) + _box(b"sv3d", head + projection)


def with_video_boxes(video: bytes) -> bytes:
    """Return an MP4 file, all in memory, with the boxes in its first video track.

    Args:
        video: the file's bytes.

    Raises:
        ArgumentError: no MP4 file with a video track.
    """
    added = video_boxes()
    path = _video_entry(video)
    entry = path[-1]
    result = bytearray(video[: entry.end] + added + video[entry.end :])
    for box in path:
        struct.pack_into(">I", result, box.start, box.end - box.start + len(added))
    moov = path[0]
    media_moves = any(box.kind == b"mdat" and box.start > moov.start for box in _boxes(video, 0, len(video)))
    if media_moves:
        _move_chunks(result, _Box(moov.kind, moov.start, moov.end + len(added)), len(added))
    return bytes(result)


def _box(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", 8 + len(content)) + kind + content


def _boxes(data: bytes | bytearray, start: int, end: int) -> Iterator[_Box]:
    """The boxes between two offsets, one after the other."""
    while start + 8 <= end:
        size, kind = struct.unpack_from(">I4s", data, start)
        if size == 1:
            (size,) = struct.unpack_from(">Q", data, start + 8)
        size = size or end - start
        if size < 8 or start + size > end:
            return
        yield _Box(kind, start, start + size)
        start += size


def _child(data: bytes | bytearray, box: _Box, kind: bytes) -> _Box | None:
    """The first box of a kind in a box; None without one."""
    return next((each for each in _boxes(data, box.start + 8, box.end) if each.kind == kind), None)


def _tables(data: bytes | bytearray, trak: _Box) -> list[_Box]:
    """The boxes from a track to its sample table, outermost first, as far as they are there."""
    path = [trak]
    for kind in _BOXES:
        inside = _child(data, path[-1], kind)
        if inside is None:
            break
        path.append(inside)
    return path


def _tracks(data: bytes | bytearray, moov: _Box) -> list[_Box]:
    return [box for box in _boxes(data, moov.start + 8, moov.end) if box.kind == b"trak"]


def _video_entry(video: bytes) -> list[_Box]:
    """The boxes around the sample entry of the first video track, outermost first, and the entry."""
    for moov in [box for box in _boxes(video, 0, len(video)) if box.kind == b"moov"]:
        for trak in _tracks(video, moov):
            path = _tables(video, trak)
            if len(path) <= len(_BOXES) or _child(video, path[2], b"vmhd") is None:
                continue
            stsd = _child(video, path[-1], b"stsd")
            entries = [] if stsd is None else list(_boxes(video, stsd.start + _BEFORE_ENTRIES, stsd.end))
            if stsd is not None and entries:
                return [moov, *path, stsd, entries[0]]
    raise ArgumentError("video: expected an MP4 file with a video track, got none")


def _move_chunks(data: bytearray, moov: _Box, by: int) -> None:
    """Add to the offsets of all chunks, which lie behind the boxes that have grown."""
    for trak in _tracks(data, moov):
        for kind, layout in _OFFSETS.items():
            table = _child(data, _tables(data, trak)[-1], kind)
            if table is not None:
                (count,) = struct.unpack_from(">I", data, table.start + 12)
                view = np.frombuffer(data, layout, count, table.start + 16)
                view += by
