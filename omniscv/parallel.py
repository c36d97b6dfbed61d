"""Threads on all cores, for functions that release the GIL: NumPy, OpenCV, compiled kernels.

The calling thread works on the items too, and free threads of one pool help. So no call waits for work that
has not started, and calls may be nested, in any thread and in forked children.
"""

import ctypes
import os
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from functools import cache, cached_property
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")

_limit = sys.maxsize
MIN_PARALLEL_ELEMENTS = 1 << 16  # below it, another thread costs more time than it saves


def cores() -> int:
    """Return how many cores this process may use."""
    available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(available, _limit)


def limit(most: int) -> None:
    """Limit the cores that this process uses from now on, as one of several processes of a machine."""
    global _limit
    _limit = most
    _pool.cache_clear()


def blocks(function: Callable[[slice], R], count: int, elements: int | None = None) -> list[R]:
    """Return the results of a function for slices that cover ``range(count)``, in order.

    Args:
        function: called with each slice.
        count: number of rows.
        elements: number of elements in all rows; the count if not given.
    """
    alone = cores() == 1 or (elements or count) < MIN_PARALLEL_ELEMENTS
    number = 1 if alone else max(1, min(4 * cores(), count))  # several a core: not all take as long
    slices = []
    for i in range(number):
        slices.append(slice(count * i // number, count * (i + 1) // number))
    return side_by_side(function, slices)


def row_blocks(function: Callable[[slice], R], height: int, width: int, pixels: int = 1 << 14) -> list[R]:
    """Return the results of a function for blocks of an image's rows, in order.

    Args:
        function: called with each slice of rows.
        height: of the image, px.
        width: of the image, px.
        pixels: of a block, so that it stays in the processor's cache.
    """
    step = max(1, pixels // width)
    return side_by_side(function, [slice(row, row + step) for row in range(0, height, step)])


def side_by_side(function: Callable[[T], R], items: Sequence[T]) -> list[R]:
    """Return the results of a function for every one of ``items``, computed on all cores, in order.

    After an error no further item is started; the error of the first item that failed is raised.
    """
    helpers = min(cores(), len(items)) - 1
    if helpers < 1:
        return [function(item) for item in items]
    results: dict[int, R] = {}
    errors: dict[int, BaseException] = {}
    remaining = iter(range(len(items)))  # next() of it is atomic

    def work() -> None:
        for index in remaining:
            if errors:
                return
            try:
                results[index] = function(items[index])
            except BaseException as error:  # raised below, in the calling thread
                errors[index] = error

    futures = [_pool().submit(work) for _ in range(helpers)]
    work()
    wait([future for future in futures if not future.cancel()])
    if errors:
        raise errors[min(errors)]
    return [results[index] for index in range(len(items))]


def ahead(function: Callable[[T], R], items: Iterable[T], threads: int) -> Iterator[R]:
    """Yield the results of a function in order, while threads work on the next items.

    What was begun is finished, even if a later item cannot be had: images before a failure are saved.

    Args:
        function: called with each item.
        items: taken as they are needed.
        threads: how many; 0: each result is computed when it is taken.
    """
    if not threads:
        yield from map(function, items)
        return
    with ThreadPoolExecutor(threads, thread_name_prefix="ahead") as pool:
        pending: deque[Future[R]] = deque()
        for item in items:
            pending.append(pool.submit(function, item))
            if len(pending) > threads:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()


@cache
def _pool() -> ThreadPoolExecutor:
    """Return the pool of threads of this process."""
    return ThreadPoolExecutor(cores(), thread_name_prefix="omniscv")


def _renew_locks() -> None:
    """Replace the locks of cached properties in a forked child: before Python 3.12 each has one, which a
    thread of the parent may hold."""
    classes: set[type] = set()
    for name, module in list(sys.modules.items()):
        if name.partition(".")[0] in _PACKAGES:
            classes.update(value for value in vars(module).values() if isinstance(value, type))
    for cls in classes:
        for attribute in vars(cls).values():
            if isinstance(attribute, cached_property) and hasattr(attribute, "lock"):
                attribute.lock = threading.RLock()


_PACKAGES = ("omniscv", "mock_server")

if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)  # threads do not survive a fork
    os.register_at_fork(after_in_child=_renew_locks)


# The parameters of glibc's mallopt(3).
_TRIM_THRESHOLD = -1
_TOP_PAD = -2
_MMAP_THRESHOLD = -3
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
