"""High dynamic range: captures at several exposures, merged to light.

A recording holds the exposures as captures of their own, and is merged again as it is replayed.
"""

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain, islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.errors import ArgumentError, SourceError
from omniscv.geometry import Pose, cube_rotations
from omniscv.sources.base import Capabilities, Capture, Request, Source, SourceWrapper, View
from omniscv.sources.requests import Response, exposures_of, merge_exposures

_PROBED_PX = 128
_PROBED = {True: (0.0, 1.0), False: (-2.0, -1.0, 0.0, 1.0, 2.0)}
"""Stops at which the exposure is tried, where the transfer is known, and where it must be solved."""
_CODES = (30, 200)  # darkest and brightest code that are compared
_FEWEST = 100  # samples below which two exposures are not compared
_OFF = 0.02  # largest relative error of the factor 2 between two stops


def bracketed(source: Source, stops: Sequence[float], path: Path | str | None = None) -> Source:
    """Return a source whose colours are light, float32, merged from several exposures; light is that at 0
    stops.

    The source's exposure is tried first. Its transfer is the one that it declares (``open_source(...,
    transfer="srgb")``); an unknown one is solved, once for a recording.

    Args:
        source: that can set exposure, or a recording of the exposures; closed with this one.
        stops: of the exposures.
        path: the recording that exposures are added to and taken from; none if not given.

    Raises:
        ArgumentError: a source whose exposure cannot be set, or a recording of other stops.
        RecordingError: as :func:`omniscv.record`.
    """
    from omniscv.sources.recording import record  # imports numba

    if not source.capabilities.can_set_exposure:
        wanted = "expected a source whose exposure can be set: UnrealCV N2 or later"
        raise ArgumentError(f"brackets: {wanted}; got {source!r}")
    if source.recorded_views() is None:
        source = _WithResponse(source, _recorded_response(path, stops))
    return Bracketed(source if path is None else record(source, path), stops)


class Bracketed(SourceWrapper):
    """A source of colours merged from those of another one at several exposures."""

    def __init__(self, source: Source, stops: Sequence[float]) -> None:
        super().__init__(source)
        self._stops = tuple(stops)

    @property
    def capabilities(self) -> Capabilities:
        return replace(self._source.capabilities, transfer="linear", shades=False)

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        waiting: deque[Request] = deque()

        def exposures() -> Iterator[Request]:
            for request in requests:
                waiting.append(request)
                yield from exposures_of(request, self._stops)

        captures = self._source.capture(exposures())
        for capture in captures:
            request = waiting.popleft()
            if capture.request == request:
                yield capture
            else:
                yield merge_exposures(request, [capture, *islice(captures, len(self._stops) - 1)])

    def around(self, source: Source) -> Source:
        return Bracketed(source, self._stops)


class _WithResponse(SourceWrapper):
    """A source whose exposure is tried before its first capture; its response is ``known`` then."""

    def __init__(self, source: Source, known: list[Response]) -> None:
        super().__init__(source)
        self._known = known

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        remaining = iter(requests)
        first = next(remaining, None)
        if first is None:
            return
        if not self._known:
            self._known.append(_measured_response(self._source, first))
        response = self._known[0]
        added: dict[str, Any] = {"transfer": response}
        if not isinstance(response, str):
            added = {"response": np.round(response, 6).tolist()}
        for capture in self._source.capture(chain([first], remaining)):
            if capture.request.stops is not None:
                capture = replace(capture, provenance={**capture.provenance, **added})
            yield capture

    def around(self, source: Source) -> Source:
        return _WithResponse(source, self._known)


def _measured_response(source: Source, first: Request) -> Response:
    """Return the response of a source's colours; SourceError if light does not double in each stop."""
    from omniscv import light

    transfer = source.capabilities.transfer
    stops = _PROBED[transfer != "unknown"]
    codes = _probed_codes(source, first, stops)
    response = light.solve(codes, stops) if transfer == "unknown" else transfer
    factors = []
    for low, high in pairwise(codes):
        in_range = (np.minimum(low, high) >= _CODES[0]) & (np.maximum(low, high) <= _CODES[1])
        if np.count_nonzero(in_range) >= _FEWEST:
            low_light = light.light_of_codes(low[in_range], response)
            ratio = light.light_of_codes(high[in_range], response) / low_light
            factors.append(float(np.median(ratio)))
    expected = "brackets: expected light to double from one stop to the next"
    if not factors:
        position = first.view.pose.position.tolist()
        actual = f"too few samples of codes {_CODES[0]} to {_CODES[1]} from {position} m"
        raise SourceError(f"{expected}, got {actual}; start where the scene is neither dark nor white")
    for factor in factors:
        if abs(factor - 2) > 2 * _OFF:
            advice = "the server does not expose as it is set, or its transfer is another one"
            actual = f"{factor:.3g} times as much: {advice}"
            raise SourceError(f"{expected}, got {actual}; leave brackets out, or set source_options.transfer")
    return response


def _probed_codes(source: Source, first: Request, stops: Sequence[float]) -> list[NDArray[np.uint8]]:
    """Return, for each of some stops, the codes of six views around the centre of a request, in one order."""
    requests = []
    for _, R_w_c in cube_rotations():
        view = View(Pose(first.view.pose.position, R_w_c), 90.0, _PROBED_PX, _PROBED_PX)
        for stop in stops:
            requests.append(Request(view, "lit", first.state, again=True, stops=stop))
    pixels = [capture.pixels.ravel() for capture in source.capture(requests)]
    codes = []
    for first_picture in range(len(stops)):
        codes.append(np.concatenate(pixels[first_picture :: len(stops)]))
    return codes


def _recorded_response(path: Path | str | None, stops: Sequence[float]) -> list[Response]:
    """Return the response of a recording's exposures, none if it has none; ArgumentError for other stops."""
    from omniscv.sources.recording import RecordedSource

    if path is None or not Path(path).exists() or Path(path).stat().st_size == 0:
        return []
    with RecordedSource(path) as recording:
        if not recording.stops:
            return []
        if recording.stops != tuple(stops):
            expected = f"expected {_listed(recording.stops)}, the stops of {path}"
            raise ArgumentError(f"brackets: {expected}; got {_listed(stops)}")
        return [recording.response()]


def _listed(stops: Sequence[float]) -> str:
    return ", ".join(f"{stop:g}" for stop in stops)
