"""Proof that a world stood still while captures were made that belong together.

All belong together that one image shows, or the images of one moment. Where the world may move
(:attr:`omniscv.sources.Capabilities.moves`), the first view at every optical centre is captured again, in
depth and mask, behind the others there, and all views at the first centre are, there and at the end: so
nothing moved that these see. If one of them differs, the world moved meanwhile: everything is captured anew,
and given up after some tries. A source that is still pays nothing.
"""

from __future__ import annotations

import hashlib
import logging
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import groupby
from typing import Any, TypeVar

from omniscv.errors import TornSetError
from omniscv.sources.base import Capture, Request, Source, SourceWrapper, View

T = TypeVar("T")

TRIES = 3
"""How often a set is captured before it is given up."""
_PROOFS = ("depth", "object_mask")
"""Modes that show where things are, and nothing that changes in a world that stands still."""
_log = logging.getLogger("omniscv")


def proven(source: Source, modes: Sequence[str], make: Callable[[Source], T]) -> T:
    """Return what is made of captures that belong together, and that show one instant.

    Args:
        source: where captures come from.
        modes: in which they are made.
        make: called with a source to capture from, again for every try.

    Raises:
        TornSetError: the world moved, every time.
    """
    if not source.capabilities.moves:
        return make(source)
    tries = 1
    while True:
        try:
            with source.one_instant():
                watched = StillSet(source, modes)
                made = make(watched)
                watched.prove()
                return made
        except TornSetError as torn:
            if tries == TRIES:
                raise
            _log.warning("%s; captured anew", torn)
            tries += 1


class StillSet(SourceWrapper):
    """A source for captures that belong together; :meth:`prove` ends them. The source is not closed with it.

    It belongs to one thread.

    Args:
        source: where captures come from.
        modes: in which most are made: where depth or masks are not among them, they are captured too, before
            the view's others.
    """

    def __init__(self, source: Source, modes: Sequence[str]) -> None:
        super().__init__(source)
        able = source.capabilities.modes
        self._proofs = tuple(mode for mode in _PROOFS if mode in able) or tuple(modes)
        self._lacking = tuple(mode for mode in self._proofs if mode not in modes)
        self._first: dict[Any, Any] = {}  # by centre, what the first view there shows
        self._shown: dict[Request, bytes] = {}
        self._delivered = self._visits = 0

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        """As :meth:`Source.capture`; TornSetError if what is captured again differs.

        Each capture comes one late, so that the last one comes when all that was captured is compared.
        """
        wanted: deque[bool] = deque()
        late: Capture | None = None
        for capture in self._source.capture(self._with_proofs(requests, wanted)):
            if capture.request.again:
                self._compare(capture)
            elif self._is_witness(capture.request.view) and capture.mode in self._proofs:
                self._shown.setdefault(capture.request, _digest(capture))
            self._delivered += 1
            if wanted.popleft():
                if late is not None:
                    yield late
                late = capture
        if late is not None:
            yield late

    def prove(self) -> None:
        """Raise TornSetError unless all that the first centre shows is as it was.

        What was captured in one visit there was compared at its end.
        """
        if self._visits < 2:
            return
        first = next(iter(self._first))
        shown = self._again(each for each in self._shown if _center(each.view) == first)
        for capture in self._source.capture(replace(each, again=True) for each in shown):
            self._compare(capture)

    def close(self) -> None:
        pass

    def _with_proofs(self, requests: Iterable[Request], wanted: deque[bool]) -> Iterator[Request]:
        """The requests, what is lacking before each, and what is captured again behind those of a centre.

        Which of them are wanted goes to ``wanted``.
        """
        for center, here in groupby(requests, lambda request: _center(request.view)):
            self._visits += 1
            witnesses: dict[Request, None] = {}
            for request in here:
                self._first.setdefault(center, _sight(request.view))
                extra: list[Request] = []
                if self._is_witness(request.view):
                    extra = [replace(request, mode=mode) for mode in self._lacking]
                    extra = [each for each in extra if each not in witnesses]
                    mine = [request] if request.mode in self._proofs else []
                    witnesses.update(dict.fromkeys([*extra, *mine]))
                wanted.extend([False] * len(extra) + [True])
                yield from extra
                yield request
            wanted.extend([False] * len(witnesses))
            yield from (replace(each, again=True) for each in self._again(witnesses))

    def _again(self, witnesses: Iterable[Request]) -> list[Request]:
        """The order in which views are captured again: forwards in one mode, backwards in the other.

        What swings and is back after some time in one of them is elsewhere in the other.
        """
        some: list[Request] = []
        others: list[Request] = []
        for each in witnesses:
            (some if each.mode == self._proofs[0] else others).append(each)
        return some + others[::-1]

    def _is_witness(self, view: View) -> bool:
        """Whether a view is captured again: all at the first centre are, and the first one elsewhere."""
        center = _center(view)
        return bool(center == next(iter(self._first)) or self._first[center] == _sight(view))

    def _compare(self, again: Capture) -> None:
        if _digest(again) != self._shown[replace(again.request, again=False)]:
            x, y, z = again.view.pose.position
            wanted = f"expected a world that stands still while {self._delivered} captures are made"
            got = f"another {again.mode} from ({x:.4g}, {y:.4g}, {z:.4g}) m when it was captured again"
            raise TornSetError(f"{wanted}, got {got}; freeze it (--freeze, or source.at(...))")


def _center(view: View) -> Any:
    return view.key().position


def _sight(view: View) -> Any:
    """Where a view looks from and to, whatever its size: ground truth may be finer."""
    return view.key()._replace(width=0, height=0)


def _digest(capture: Capture) -> bytes:
    pixels = capture.pixels
    kind = repr((capture.view.key(), pixels.shape, pixels.dtype.str)).encode()
    return hashlib.blake2b(kind + pixels.tobytes(), digest_size=16).digest()
