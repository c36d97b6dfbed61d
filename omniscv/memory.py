"""How the C library of this process treats freed memory."""

import ctypes
import sys

# The parameters of glibc's mallopt(3).
_TRIM_THRESHOLD, _TOP_PAD, _MMAP_THRESHOLD = -1, -2, -3
_MB = 1 << 20


def keep_freed_memory() -> None:
    """Let this process keep up to 512 MB of freed memory, for the arrays of its next images.

    By default glibc returns every large array to the system, which clears pages for the next one: a tenth of
    the time of an image, and more with several threads, which all wait while pages are returned. The command
    line and the workers of clusters call this once. With other C libraries than glibc it does nothing.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if mallopt is None:
        return
    if not mallopt(_MMAP_THRESHOLD, 256 * _MB):
        mallopt(_MMAP_THRESHOLD, 32 * _MB)  # the most before glibc 2.35
    mallopt(_TRIM_THRESHOLD, 512 * _MB)
    mallopt(_TOP_PAD, 16 * _MB)
