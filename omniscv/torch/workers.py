"""Epochs that are shared with the workers of a ``DataLoader``, and the threads of a worker."""

from __future__ import annotations

import os
from functools import lru_cache

import cv2
import torch
import torch.multiprocessing  # shared tensors can be pickled for workers
from torch.utils.data import get_worker_info

from omniscv import parallel
from omniscv.arguments import whole_number


class Epochs:
    """A base of datasets that differ from epoch to epoch.

    The epoch lies in shared memory, so that workers that persist see it too.
    """

    def __init__(self) -> None:
        self._epoch = torch.zeros((), dtype=torch.int64).share_memory_()

    @property
    def epoch(self) -> int:
        """The epoch, 0 at first."""
        return int(self._epoch)

    def set_epoch(self, epoch: int) -> None:
        """Set the epoch; call it before the loader is iterated.

        Raises:
            ArgumentError: an epoch below 0.
        """
        self._epoch.fill_(whole_number("epoch", epoch, least=0))


def bound_threads() -> None:
    """Use one thread in a worker, as PyTorch does; outside workers do nothing."""
    if get_worker_info() is not None:
        _bound_threads(os.getpid())


@lru_cache(maxsize=1)
def _bound_threads(process: int) -> None:
    """Cached by process, because a forked worker must set what its parent has set."""
    parallel.limit(1)
    cv2.setNumThreads(0)  # 1 would wait for threads that did not survive the fork
