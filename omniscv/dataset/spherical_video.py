"""Spherical Video V2: the boxes of an MP4 file that make players show it as a sphere.

Google's specification of Spherical Video V2, https://github.com/google/spatial-media. The boxes ``st3d`` and
``sv3d``
go to the end of the video's sample entry, and the boxes around it grow.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Literal, NamedTuple

import numpy as np

from omniscv.errors import ArgumentError

Stereo = Literal["mono", "top-bottom", "left-right"]
_STEREO_MODES: dict[str, int] = {"mono": 0, "top-bottom": 1, "left-right": 2}

_WAY = (b"mdia", b"minf", b"stbl")
_BEFORE_ENTRIES = 16  # bytes of stsd, its header included, before the first sample entry
_OFFSETS = {b"stco": ">u4", b"co64": ">u8"}


class _Box(NamedTuple):
    kind: bytes
    start: int
    end: int


def metadata(stereo: Stereo = "mono", program: str = "omniscv") -> bytes:
    """Return the boxes of a full equirectangular video that looks along its middle."""
    head = _box(b"svhd", bytes(4) + program.encode() + b"\0")
    projection = _box(b"proj", _box(b"prhd", bytes(16)) + _box(b"equi", bytes(20)))
    return _box(b"st3d", bytes(4) + bytes([_STEREO_MODES[stereo]])) + _box(b"sv3d", head + projection)


def tagged(video: bytes, stereo: Stereo = "mono") -> bytes:
    """Return an MP4 file, all in memory, with the boxes in its first video track.

    Args:
        video: the file's bytes.
        stereo: how the pictures of two eyes are placed, if there are two.

    Raises:
        ArgumentError: no MP4 file with a video track.
    """
    added = metadata(stereo)
    way = _video_entry(video)
    entry = way[-1]
    result = bytearray(video[: entry.end] + added + video[entry.end :])
    for box in way:
        struct.pack_into(">I", result, box.start, box.end - box.start + len(added))
    moov = way[0]
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
    way = [trak]
    for kind in _WAY:
        inside = _child(data, way[-1], kind)
        if inside is None:
            break
        way.append(inside)
    return way


def _tracks(data: bytes | bytearray, moov: _Box) -> list[_Box]:
    return [box for box in _boxes(data, moov.start + 8, moov.end) if box.kind == b"trak"]


def _video_entry(video: bytes) -> list[_Box]:
    """The boxes around the sample entry of the first video track, outermost first, and the entry."""
    for moov in [box for box in _boxes(video, 0, len(video)) if box.kind == b"moov"]:
        for trak in _tracks(video, moov):
            way = _tables(video, trak)
            if len(way) <= len(_WAY) or _child(video, way[2], b"vmhd") is None:
                continue
            stsd = _child(video, way[-1], b"stsd")
            entries = [] if stsd is None else list(_boxes(video, stsd.start + _BEFORE_ENTRIES, stsd.end))
            if stsd is not None and entries:
                return [moov, *way, stsd, entries[0]]
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
