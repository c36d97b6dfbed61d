"""Exposures of one view, and the light that they are merged to."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import numbers, one_of, shown
from omniscv.errors import ArgumentError, BadReplyError
from omniscv.modalities import TRANSFERS
from omniscv.sources.base import Capture, Request

Response = str | NDArray[np.float64]
"""What codes mean: a transfer, or the light (256,) of each code."""


def exposures_of(request: Request, stops: Iterable[float]) -> list[Request]:
    """Return one request of each exposure for a request of colours; any other request is returned alone."""
    if request.mode != "lit" or request.stops is not None:
        return [request]
    return [replace(request, stops=stop) for stop in stops]


def merge(request: Request, captures: Sequence[Capture]) -> Capture:
    """Return light, float32, of one view's captures at several exposures.

    Raises:
        ArgumentError: captures without their transfer or response.
        BadReplyError: captures of several sizes, or in floats.
    """
    from omniscv import light  # compiled; sources are imported without numba

    first = captures[0]
    shapes = {(capture.pixels.shape, capture.pixels.dtype.name) for capture in captures}
    if len(shapes) > 1 or first.pixels.dtype != np.uint8:
        raise BadReplyError(f"expected exposures of one size in 8 bits, got {sorted(shapes)}")
    stops = [capture.request.stops or 0.0 for capture in captures]
    pixels = light.merge([capture.pixels for capture in captures], stops, response_of(first.provenance))
    pixels.flags.writeable = False
    origin = {key: value for key, value in first.provenance.items() if key not in ("transfer", "response")}
    return Capture(request, first.view, pixels, {**origin, "stops": stops})


def response_of(provenance: Any) -> Response:
    """Return the response in a capture's provenance; ArgumentError if there is none."""
    light = provenance.get("response")
    if light is None:
        known = [name for name in TRANSFERS if name != "unknown"]
        return str(one_of("transfer", provenance.get("transfer"), known))
    response = numbers("response", light, (256,))
    if response[0] < 0 or (np.diff(response) < 0).any():
        raise ArgumentError(f"response: expected light that increases with its code, got {shown(light)}")
    return response
