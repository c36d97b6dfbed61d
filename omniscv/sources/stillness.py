"""Detect motion during a set of captures by repeating some of them.

Where the world may move (:attr:`omniscv.sources.Capabilities.moves`), depth and mask of the first view at
every optical centre are captured again after the others there, and all views at the first centre there and at
the end. If one of them differs, the set is captured again, at most ``TRIES`` times.
"""

import hashlib
import logging
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import groupby
from typing import Any, TypeVar

from omniscv.errors import OtherMomentError, TornSetError
from omniscv.sources.base import Capture, Request, Source, SourceWrapper, View

T = TypeVar("T")

TRIES = 3
"""How often a set is captured at most."""
_PROOFS = ("depth", "object_mask")
"""Modes that show where things are, and are the same every time while nothing moves."""
_log = logging.getLogger("omniscv")


def verify_still(source: Source, modes: Sequence[str], make: Callable[[Source], T]) -> T:
    """Return the result of a function whose captures, in some modes, show one instant.

    ``make`` is called with a source to capture from, again for every try. Raises TornSetError if the world
    moved, every time.
    """
    if not source.capabilities.moves:
        return make(source)
    tries = 1
    while True:
        try:
            with source.one_instant():
                watched = StillSet(source, modes)
                result = make(watched)
                watched.verify()
                return result
        except TornSetError as torn:
            if tries == TRIES or isinstance(torn, OtherMomentError):
                raise
            _log.warning("%s; captured anew", torn)
            tries += 1


class StillSet(SourceWrapper):
    """A source for captures of one instant; :meth:`verify` ends them. For one thread; it does not close the
    source.

    Depth and masks that are not among ``modes`` are captured too, before the view's others.
    """

    def __init__(self, source: Source, modes: Sequence[str]) -> None:
        super().__init__(source)
        offered = source.capabilities.modes
        self._proofs = tuple(mode for mode in _PROOFS if mode in offered) or tuple(modes)
        self._lacking = tuple(mode for mode in self._proofs if mode not in modes)
        self._first: dict[Any, Any] = {}  # by centre, the first view there
        self._shown: dict[Request, bytes] = {}
        self._delivered = 0
        self._visits = 0

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        """As :meth:`Source.capture`, one late, so that all repeated captures are compared; TornSetError if
        one differs.
        """
        requested: deque[bool] = deque()
        late: Capture | None = None
        for capture in self._source.capture(self._with_proofs(requests, requested)):
            if capture.request.again:
                self._compare(capture)
            elif self._is_witness(capture.request.view) and capture.mode in self._proofs:
                self._shown.setdefault(capture.request, _digest(capture))
            self._delivered += 1
            if requested.popleft():
                if late is not None:
                    yield late
                late = capture
        if late is not None:
            yield late

    def verify(self) -> None:
        """Capture the first centre's views again, if others were visited; TornSetError if one differs."""
        if self._visits < 2:
            return
        first = next(iter(self._first))
        shown = [request for request in self._shown if _center(request.view) == first]
        for capture in self._source.capture(self._repetitions(shown)):
            self._compare(capture)

    def close(self) -> None:
        pass

    def _with_proofs(self, requests: Iterable[Request], requested: deque[bool]) -> Iterator[Request]:
        """Yield the requests, missing proofs before each, and repeated ones after those of a centre."""
        for center, here in groupby(requests, lambda request: _center(request.view)):
            self._visits += 1
            witnesses: dict[Request, None] = {}
            for request in here:
                self._first.setdefault(center, _sight(request.view))
                proofs: list[Request] = []
                if self._is_witness(request.view):
                    for mode in self._lacking:
                        proof = replace(request, mode=mode)
                        if proof not in witnesses:
                            proofs.append(proof)
                    witnesses.update(dict.fromkeys(proofs))
                    if request.mode in self._proofs:
                        witnesses[request] = None
                requested.extend([False] * len(proofs) + [True])
                yield from proofs
                yield request
            requested.extend([False] * len(witnesses))
            yield from self._repetitions(witnesses)

    def _repetitions(self, witnesses: Iterable[Request]) -> list[Request]:
        """Return requests that capture ``witnesses`` again: one mode in order, then the other in reverse.

        So the two modes of a view are repeated after different times, and a swinging object that is back at
        its place for one is elsewhere for the other.
        """
        forwards: list[Request] = []
        backwards: list[Request] = []
        for request in witnesses:
            repetition = replace(request, again=True)
            if request.mode == self._proofs[0]:
                forwards.append(repetition)
            else:
                backwards.append(repetition)
        return forwards + backwards[::-1]

    def _is_witness(self, view: View) -> bool:
        """Return whether a view is repeated: all at the first centre are, and the first one elsewhere."""
        center = _center(view)
        return bool(center == next(iter(self._first)) or self._first[center] == _sight(view))

    def _compare(self, again: Capture) -> None:
        if _digest(again) != self._shown[replace(again.request, again=False)]:
            x, y, z = again.view.pose.position
            expected = f"expected a world that stands still while {self._delivered} captures are made"
            actual = f"another {again.mode} from ({x:.4g}, {y:.4g}, {z:.4g}) m when it was captured again"
            raise TornSetError(f"{expected}, got {actual}; freeze it (--set freeze=pause, or source.at(...))")


def _center(view: View) -> Any:
    return view.key().position


def _sight(view: View) -> Any:
    """Return a view's pose and field of view, whatever its size: ground truth may be finer."""
    return view.key()._replace(width=0, height=0)


def _digest(capture: Capture) -> bytes:
    pixels = capture.pixels
    kind = repr((capture.view.key(), pixels.shape, pixels.dtype.str)).encode()
    return hashlib.blake2b(kind + pixels.tobytes(), digest_size=16).digest()
