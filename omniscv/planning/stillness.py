"""Proof that a world stood still while captures were made that belong together.

All belong together that one image shows, or the images of one moment. Where the world may move
(:attr:`omniscv.sources.Capabilities.moves`), the first view at every optical centre is captured again last,
in depth and mask, and so are all views at the first centre: then nothing moved that these see. If one of them
differs, the world moved meanwhile: everything is captured anew, and given up after some tries. A source that
is still pays nothing.
"""

from __future__ import annotations

import hashlib
import logging
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypeVar

from omniscv.errors import TornSetError
from omniscv.sources.base import Capture, Request, Source, SourceWrapper, View

T = TypeVar("T")

TRIES = 3
"""How often a set is captured before it is given up."""
_PROOFS = ("depth", "object_mask")
"""Modes that show where things are, and nothing that changes in a world that stands still."""
_AT_ONCE = 64
"""Captures that are repeated together: a long set that is torn ends early."""
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
    for tries in range(1, TRIES + 1):
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
    raise AssertionError("unreachable: the last try returns or raises")


class StillSet(SourceWrapper):
    """A source for captures that belong together; :meth:`prove` ends them. Not closed with the source.

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
        self._seen: dict[Request, bytes] = {}
        self._due: list[Request] = []
        self._delivered = 0

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        wanted: deque[bool] = deque()
        for capture in self._source.capture(self._with_proofs(requests, wanted)):
            self._delivered += 1
            if self._proves(capture.request) and capture.request not in self._seen:
                self._seen[capture.request] = _digest(capture)
                self._due.append(capture.request)
            if wanted.popleft():
                yield capture
            if len(self._due) >= _AT_ONCE:
                self._repeat()

    def prove(self) -> None:
        """Raise TornSetError unless all that is captured again shows what it showed before."""
        first = next(iter(self._first), None)
        again = [request for request in self._seen if _center(request.view) == first]
        self._due = list(dict.fromkeys([*again, *self._due]))
        self._repeat()

    def close(self) -> None:
        pass

    def _with_proofs(self, requests: Iterable[Request], wanted: deque[bool]) -> Iterator[Request]:
        """The requests, and those that are lacking; which of both goes to ``wanted``."""
        asked: set[Any] = set()
        for request in requests:
            self._first.setdefault(_center(request.view), _sight(request.view))
            if self._lacking and self._witness(request.view) and _sight(request.view) not in asked:
                asked.add(_sight(request.view))
                for mode in self._lacking:
                    extra = Request(request.view, mode, request.state)
                    if extra not in self._seen:
                        wanted.append(False)
                        yield extra
            wanted.append(True)
            yield request

    def _witness(self, view: View) -> bool:
        """Whether a view is captured again at the end."""
        center = _center(view)
        return bool(center == next(iter(self._first)) or self._first[center] == _sight(view))

    def _proves(self, request: Request) -> bool:
        return request.mode in self._proofs and self._witness(request.view)

    def _repeat(self) -> None:
        due, self._due = self._due, []
        for again in self._source.recapture(due):
            if _digest(again) != self._seen[again.request]:
                x, y, z = again.view.pose.position
                wanted = f"expected a world that stands still while {self._delivered} captures are made"
                got = f"another {again.mode} from ({x:.4g}, {y:.4g}, {z:.4g}) m when it was captured again"
                raise TornSetError(f"{wanted}, got {got}; pause it, or set its moving objects (freeze)")


def _center(view: View) -> Any:
    return view.key()[2:5]


def _sight(view: View) -> Any:
    """Where a view looks from and to, whatever its size: ground truth may be finer."""
    return view.key()[2:]


def _digest(capture: Capture) -> bytes:
    pixels = capture.pixels
    said = repr((capture.view.key(), pixels.shape, pixels.dtype.str)).encode()
    return hashlib.blake2b(said + pixels.tobytes(), digest_size=16).digest()
