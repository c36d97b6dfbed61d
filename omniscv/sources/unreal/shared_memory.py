"""Pictures by shared memory, from a game on the same Windows machine.

A region holds the last capture of a camera in a mode, and no lock or number says which (supplement to the
protocol reference, section 2.5). So a picture is copied before the next one of its kind is requested, and the
count in each reply must have grown. This was not run on Windows: tests put another reader in place of
:func:`windows_region`.
"""

import io
import json
import math
import os
import re
from collections.abc import Callable

import numpy as np

from omniscv.arguments import shown
from omniscv.errors import BadReplyError
from omniscv.sources.unreal.protocol import Reply

ReadRegion = Callable[[str, int], bytes]
"""Return a copy of so many bytes of a region, by its name; OSError if there is none, or a smaller one."""

_NAME = re.compile(r"UnrealCV_[\w-]{1,200}", re.ASCII)
_MOST_BYTES, _MOST_TEXT = 1 << 30, 1 << 14
_NUMBERS = ("num_bytes", "offset_bytes", "frame")
_READ_ONLY = 4  # FILE_MAP_READ


def windows_region(name: str, size: int) -> bytes:
    """Read a region that exists; Python's own ``mmap`` would make a new, black one for a wrong name."""
    import ctypes

    kernel = ctypes.WinDLL("kernel32", use_last_error=True)  # type: ignore[attr-defined,unused-ignore]
    kernel.OpenFileMappingW.restype = kernel.MapViewOfFile.restype = ctypes.c_void_p
    handle = kernel.OpenFileMappingW(_READ_ONLY, False, name)
    if not handle:
        raise OSError(f"there is no region {name}")
    try:
        start = kernel.MapViewOfFile(ctypes.c_void_p(handle), _READ_ONLY, 0, 0, ctypes.c_size_t(size))
        if not start:
            raise OSError(f"the region {name} is smaller than {size} bytes")
        try:
            return ctypes.string_at(start, size)
        finally:
            kernel.UnmapViewOfFile(ctypes.c_void_p(start))
    finally:
        kernel.CloseHandle(ctypes.c_void_p(handle))


def region_reader(endpoint: object) -> ReadRegion | None:
    """Return how this process reads regions of a game at an endpoint; None where it cannot."""
    local = isinstance(endpoint, tuple) and endpoint[0] in ("localhost", "127.0.0.1", "::1")
    return windows_region if local and os.name == "nt" else None


class SharedPictures:
    """Reads the pictures of one connection; a fault of it is a BadReplyError."""

    def __init__(self, read: ReadRegion) -> None:
        self._read = read
        self._frames: dict[str, int] = {}

    def payload(self, reply: Reply) -> bytes:
        """Return the picture that a reply describes, as NPY: colours RGB, depth as over the wire.

        To be called at once, before the next request of its kind overwrites the region.
        """
        try:
            fields = json.loads(reply[:_MOST_TEXT])
            name, mode, dtype = (str(fields[key]) for key in ("name", "modality", "dtype"))
            size, start, frame, *shape = map(int, [*(fields[key] for key in _NUMBERS), *fields["shape"]])
        except (ValueError, TypeError, KeyError, RecursionError) as cause:
            raise BadReplyError(f"expected a region of shared memory, got {shown(reply[:100])}") from cause
        item = {"uint8": 1, "float32": 4}.get(dtype, 0)
        fits = 0 < size <= _MOST_BYTES and size == item * math.prod(shape) and min(shape) > 0
        if not _NAME.fullmatch(name) or start != 0 or not fits or shape[2:] != [4] * (item == 1):
            raise BadReplyError(f"expected a picture of UnrealCV in a region, got {shown(reply[:100])}")
        if frame <= self._frames.get(mode, 0):
            raise BadReplyError(f"expected a new capture in {name}, got number {frame} again")
        self._frames[mode] = frame
        try:
            pixels = np.frombuffer(self._read(name, size), dtype).reshape(shape)
        except (OSError, ValueError) as cause:
            raise BadReplyError(f"expected {size} bytes of shared memory; {cause}") from cause
        buffer = io.BytesIO()
        np.save(buffer, np.ascontiguousarray(pixels[..., 2::-1] if item == 1 else pixels))
        return buffer.getvalue()
