"""Work in blocks on all cores, for functions that let go of Python's lock (NumPy, OpenCV, nogil kernels)."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")

_WORTH_IT = 1 << 16
"""Elements below which handing work to another thread costs more than it gains."""


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def blocks(function: Callable[[slice], R], count: int, elements: int | None = None) -> list[R]:
    """``function`` of slices that cover ``range(count)``, side by side; results in order.

    Args:
        function: called with each slice.
        count: how many rows there are.
        elements: how much work that is; the count if not given.
    """
    parts = cores() if (elements or count) >= _WORTH_IT else 1
    edges = [count * i // parts for i in range(parts + 1)]
    return side_by_side(function, [slice(a, b) for a, b in pairwise(edges)])


def side_by_side(function: Callable[[T], R], items: Sequence[T]) -> list[R]:
    """``function`` of every item, on all cores; results in order, the first error raised."""
    if len(items) < 2 or cores() < 2:
        return [function(item) for item in items]
    return list(_pool().map(function, items))


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(cores(), thread_name_prefix="omniscv")
