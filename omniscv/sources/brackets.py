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

from omniscv.errors import ArgumentError, SourceError
from omniscv.geometry import Pose, cube_rotations
from omniscv.sources.base import Capabilities, Capture, Request, Source, SourceWrapper, View
from omniscv.sources.requests import Response, exposures_of, merge_exposures

_PROBED_PX = 128
_PROBED = {True: (0.0, 1.0), False: (-2.0, -1.0, 0.0, 1.0, 2.0)}
"""Stops at which the exposure is tried, where the transfer is known, and where it must be solved."""
_CODES = 30, 200  # darkest and brightest code that are compared
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
        return replace(self._source.capabilities, transfer="linear")

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

    known = source.capabilities.transfer
    stops = _PROBED[known != "unknown"]
    position = first.view.pose.position
    views = [View(Pose(position, R_w_c), 90.0, _PROBED_PX, _PROBED_PX) for _, R_w_c in cube_rotations()]
    requests = [Request(view, "lit", first.state, again=True, stops=stop) for view in views for stop in stops]
    pixels = [capture.pixels.ravel() for capture in source.capture(requests)]
    codes = [np.concatenate(pixels[k :: len(stops)]) for k in range(len(stops))]
    response = light.solve(codes, stops) if known == "unknown" else known
    pairs = []
    for low, high in pairwise(codes):
        in_range = (np.minimum(low, high) >= _CODES[0]) & (np.maximum(low, high) <= _CODES[1])
        pairs.append((low[in_range], high[in_range]))
    expected = "brackets: expected light to double from one stop to the next"
    if max(low.size for low, _ in pairs) < _FEWEST:
        got = f"too few samples of codes {_CODES[0]} to {_CODES[1]} from {position.tolist()} m"
        raise SourceError(f"{expected}, got {got}; start where the scene is neither dark nor white")
    for low, high in pairs:
        if low.size < _FEWEST:
            continue
        ratio = light.light_of_codes(high, response) / light.light_of_codes(low, response)
        if abs((factor := float(np.median(ratio))) - 2) > 2 * _OFF:
            advice = "the server does not expose as it is set, or its transfer is another one"
            got = f"{factor:.3g} times as much: {advice}"
            raise SourceError(f"{expected}, got {got}; leave brackets out, or set source_options.transfer")
    return response


def _recorded_response(path: Path | str | None, stops: Sequence[float]) -> list[Response]:
    """Return the response of a recording's exposures, none if it has none; ArgumentError for other stops."""
    from omniscv.sources.recording import RecordedSource

    if path is None or not Path(path).exists() or Path(path).stat().st_size == 0:
        return []
    with RecordedSource(path) as held:
        if held.stops and held.stops != tuple(stops):
            known, got = (", ".join(f"{stop:g}" for stop in some) for some in (held.stops, stops))
            raise ArgumentError(f"brackets: expected {known}, the stops of {path}; got {got}")
        return [held.response()] if held.stops else []
