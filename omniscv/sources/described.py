"""What a source's address and options say of the pictures that it gives, without where it is."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import PurePath
from typing import Any
from urllib.parse import parse_qsl

from omniscv import storage
from omniscv.sources.base import Capture, Request, Source, SourceWrapper
from omniscv.sources.registry import Deadlines, scheme_of

DELIVERY = frozenset({*Deadlines.__annotations__, "retries"})
"""Options of sources by which no picture changes."""

_LIVE = ("unreal", "unreal+unix", "launch")
"""Schemes of a running engine."""

_NAMED = ("mock", "scene", "blender", "mujoco")
"""Schemes whose addresses name a scene; others, as of an engine, name a machine."""

_DELIVERY_IN_ADDRESSES = frozenset({"latency_ms", "port", "seed", "shared_memory", "startup_timeout_s"})
_TRANSPORT_FAULTS = frozenset(
    (
        "authentication", "bad-magic", "clicked", "cut", "delay", "drip", "huge", "missing", "no-greeting",
        "no-id", "refuse-mask", "reset", "second-client", "wrong-id", "zero-size",
    )
)  # fmt: skip
"""Faults of the mock server that spoil replies, never pictures."""


ORIGIN = "origin"
"""Key of the provenance of recorded captures: what they are of."""


class WithOrigin(SourceWrapper):
    """A source whose captures say what they are of.

    Args:
        source: of the captures.
        origin: plain values: its ``source`` and ``source_options``, and the ``world``'s digest.
    """

    def __init__(self, source: Source, origin: Mapping[str, Any]) -> None:
        super().__init__(source)
        self._origin = dict(origin)

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        for capture in self._source.capture(requests):
            yield replace(capture, provenance={**capture.provenance, ORIGIN: self._origin})

    def around(self, source: Source) -> Source:
        return WithOrigin(source, self._origin)


def described(addresses: Sequence[str]) -> dict[str, Any]:
    """Return the address of a source, or of replicas, as plain values that are the same on every machine.

    Hosts, ports and folders are left out, and options by which no picture changes. A recording has no name:
    it may be moved.
    """
    replicas = [_described(address) for address in addresses]
    if replicas == [replicas[0]] * len(replicas):
        return replicas[0]
    return {"replicas": replicas}


def _described(address: str) -> dict[str, Any]:
    scheme = scheme_of(address)
    if scheme is None or scheme in storage.SCHEMES:
        return {"scheme": "recording"}
    path, _, query = address.removeprefix(f"{scheme}:").partition("?")
    options: dict[str, Any] = {}
    for key, text in parse_qsl(query, keep_blank_values=True):
        is_fault = key == "fault" and text.partition("@")[0].partition("=")[0] in _TRANSPORT_FAULTS
        if key not in _DELIVERY_IN_ADDRESSES and not is_fault:
            options.setdefault(key, []).append(text)
    described: dict[str, Any] = {"scheme": "unreal" if scheme in _LIVE else scheme}
    if scheme in _NAMED:
        described["name"] = PurePath(path.removeprefix("//")).name
    if options:
        described["options"] = {key: options[key] for key in sorted(options)}
    return described


def without_delivery(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of a source by which pictures change."""
    return {key: options[key] for key in sorted(options) if key not in DELIVERY}
