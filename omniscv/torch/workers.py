"""What a dataset shares with the workers of a ``DataLoader``, and what a worker may take of the machine."""

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
        """The epoch that is drawn, 0 at first."""
        return int(self._epoch)

    def set_epoch(self, epoch: int) -> None:
        """Draw another epoch from now on; call it before the loader is iterated.

        Raises:
            ArgumentError: an epoch below 0.
        """
        self._epoch.fill_(whole_number("epoch", epoch, least=0))


def bound_threads() -> None:
    """Work in one thread in a worker, as PyTorch does there; outside workers, do nothing."""
    if get_worker_info() is not None:
        _bound_threads(os.getpid())


@lru_cache(maxsize=1)
def _bound_threads(process: int) -> None:
    """Once a process: what a parent has done, a forked worker still has to do."""
    parallel.limit(1)
    cv2.setNumThreads(0)  # 1 would stop its threads, and wait for those that did not survive a fork
