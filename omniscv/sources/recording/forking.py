"""Locks that no thread holds while another one forks: they would stay taken in the child."""

import os
import threading
from typing import Protocol
from weakref import WeakSet

_LONGEST_WAIT_S = 30.0


class Locked(Protocol):
    """What is used by one thread at a time."""

    @property
    def lock(self) -> threading.RLock:
        """The lock that its users hold."""


_open: WeakSet[Locked] = WeakSet()
_held: list[threading.RLock] = []


def hold_at_forks(owner: Locked) -> None:
    """Hold an object's lock at every fork, as long as the object lives."""
    _open.add(owner)


def _hold() -> None:
    locks = [owner.lock for owner in list(_open)]
    _held.extend(lock for lock in locks if lock.acquire(timeout=_LONGEST_WAIT_S))


def _let_go() -> None:
    while _held:
        _held.pop().release()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_hold, after_in_parent=_let_go, after_in_child=_let_go)
