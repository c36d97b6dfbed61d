"""Light of scenes that are brighter and darker than 8 bits hold: colours at several exposures, merged.

A recording holds the exposures as captures of their own, with what their codes say of light: the name of a
transfer, or the response that was solved. They are merged whenever they are replayed.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain, islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import numbers, one_of, shown
from omniscv.errors import ArgumentError, BadReplyError, SourceError
from omniscv.geometry import Pose, cube_rotations
from omniscv.modalities import TRANSFERS
from omniscv.sources.base import Capabilities, Capture, Request, Source, SourceWrapper, View

Response = str | NDArray[np.float64]
"""What codes say of light: a transfer, or the light (256,) of each code."""

_PROBED_PX = 128
_PROBED = {True: (0.0, 1.0), False: (-2.0, -1.0, 0.0, 1.0, 2.0)}
"""Stops at which the exposure is tried, where the transfer is known, and where it must be solved."""
_CODES = 30, 200  # by which light is compared
_FEWEST = 100  # of them
_OFF = 0.02  # share by which twice the light may be off


def bracketed(source: Source, stops: Sequence[float], path: Path | str | None = None) -> Source:
    """Return a source whose colours are light, float32, merged from several exposures.

    The source's exposure is tried before the first of them. Its transfer is the one that it declares
    (``open_source(..., transfer="srgb")``); an unknown one is solved, once for a recording.

    Args:
        source: that can set exposure, or a recording of the exposures; closed with this one.
        stops: of the exposures; light is that at 0, whether it is among them or not.
        path: the recording that exposures are added to and taken from; none if not given.

    Raises:
        ArgumentError: a source whose exposure cannot be set, or a recording of other stops.
        RecordingError: as :func:`omniscv.record`.
    """
    from omniscv.sources.recording import record  # which replays by this module

    if not source.capabilities.can_set_exposure:
        wanted = "expected a source whose exposure can be set: UnrealCV N2 or later"
        raise ArgumentError(f"brackets: {wanted}; got {source!r}")
    if source.recorded_views() is None:
        source = _Proven(source, _held(path, stops))
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
                yield from exposed(request, self._stops)

        captures = self._source.capture(exposures())
        for capture in captures:
            request = waiting.popleft()
            if capture.request == request:
                yield capture
            else:
                yield merged(request, [capture, *islice(captures, len(self._stops) - 1)])

    def around(self, source: Source) -> Source:
        return Bracketed(source, self._stops)


def exposed(request: Request, stops: Iterable[float]) -> list[Request]:
    """Return the requests that a request of colours is merged from; of other modalities, and of one exposure,
    itself."""
    if request.mode != "lit" or request.stops is not None:
        return [request]
    return [replace(request, stops=each) for each in stops]


def merged(request: Request, captures: Sequence[Capture]) -> Capture:
    """Return light, float32, of one view's captures at several exposures.

    Raises:
        ArgumentError: captures that do not say what their codes are.
        BadReplyError: captures of several sizes, or in floats.
    """
    from omniscv import light  # compiled; sources are imported without numba

    first = captures[0]
    found = {(each.pixels.shape, each.pixels.dtype.name) for each in captures}
    if len(found) > 1 or first.pixels.dtype != np.uint8:
        raise BadReplyError(f"expected exposures of one size in 8 bits, got {sorted(found)}")
    stops = [capture.request.stops or 0.0 for capture in captures]
    pixels = light.merge([capture.pixels for capture in captures], stops, response_of(first.provenance))
    pixels.flags.writeable = False
    said = {key: value for key, value in first.provenance.items() if key not in ("transfer", "response")}
    return Capture(request, first.view, pixels, {**said, "stops": stops})


def response_of(provenance: Any) -> Response:
    """Return what a capture's provenance says of its codes; ArgumentError if it does not say it."""
    said = provenance.get("response")
    if said is None:
        known = [name for name in TRANSFERS if name != "unknown"]
        return str(one_of("transfer", provenance.get("transfer"), known))
    response = numbers("response", said, (256,))
    if response[0] < 0 or (np.diff(response) < 0).any():
        raise ArgumentError(f"response: expected light that increases with its code, got {shown(said)}")
    return response


class _Proven(SourceWrapper):
    """A source whose exposure is tried before its first capture; captures at other stops say their response.

    Args:
        source: closed with this.
        found: the response, as the sources at all instants share it; empty before it is known.
    """

    def __init__(self, source: Source, found: list[Response]) -> None:
        super().__init__(source)
        self._found = found

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        remaining = iter(requests)
        first = next(remaining, None)
        if first is None:
            return
        if not self._found:
            self._found.append(_prove(self._source, first))
        response = self._found[0]
        said: dict[str, Any] = {"transfer": response}
        if not isinstance(response, str):
            said = {"response": np.round(response, 6).tolist()}
        for capture in self._source.capture(chain([first], remaining)):
            exposes = capture.request.stops is not None
            yield replace(capture, provenance={**capture.provenance, **said}) if exposes else capture

    def around(self, source: Source) -> Source:
        return _Proven(source, self._found)


def _prove(source: Source, first: Request) -> Response:
    """Return the response of a source's colours, which say that exposure does what it should.

    Raises:
        SourceError: it does not; light must double from one stop to the next.
    """
    from omniscv import light

    known = source.capabilities.transfer
    stops = _PROBED[known != "unknown"]
    position = first.view.pose.position
    views = [View(Pose(position, R_w_c), 90.0, _PROBED_PX, _PROBED_PX) for _, R_w_c in cube_rotations()]
    requests = [Request(view, "lit", first.state, again=True, stops=at) for view in views for at in stops]
    pixels = [capture.pixels.ravel() for capture in source.capture(requests)]
    codes = [np.concatenate(pixels[k :: len(stops)]) for k in range(len(stops))]
    response = light.solve(codes, stops) if known == "unknown" else known
    seen = [(np.minimum(*pair) >= _CODES[0]) & (np.maximum(*pair) <= _CODES[1]) for pair in pairwise(codes)]
    wanted = "brackets: expected light to double from one stop to the next"
    if max(map(np.count_nonzero, seen)) < _FEWEST:
        got = f"too few samples of codes {_CODES[0]} to {_CODES[1]} from {position.tolist()} m"
        raise SourceError(f"{wanted}, got {got}; start where the scene is neither dark nor white")
    for (low, high), both in zip(pairwise(codes), seen, strict=True):
        if np.count_nonzero(both) < _FEWEST:
            continue
        dark, bright = (light.light_of_codes(each[both], response) for each in (low, high))
        if abs((factor := float(np.median(bright / dark))) - 2) > 2 * _OFF:
            advice = "the server does not expose as it is set, or its transfer is another one"
            got = f"{factor:.3g} times as much: {advice}"
            raise SourceError(f"{wanted}, got {got}; leave brackets out, or set source_options.transfer")
    return response


def _held(path: Path | str | None, stops: Sequence[float]) -> list[Response]:
    """Return the response of the exposures that a recording holds, if it does.

    Raises:
        ArgumentError: it holds other exposures.
    """
    from omniscv.sources.recording import RecordedSource

    if path is None or not Path(path).exists() or Path(path).stat().st_size == 0:
        return []
    with RecordedSource(path) as held:
        if held.stops and held.stops != tuple(stops):
            known, got = (", ".join(f"{each:g}" for each in some) for some in (held.stops, stops))
            raise ArgumentError(f"brackets: expected {known}, the stops of {path}; got {got}")
        return [held.response()] if held.stops else []
