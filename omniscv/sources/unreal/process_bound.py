"""Live sources belong to the process that opened them: a connection cannot be shared by two."""

import os
from collections.abc import Iterable, Iterator
from typing import NoReturn

from omniscv.errors import SourceError
from omniscv.geometry.instant import Instant
from omniscv.geometry.scene_geometry import SceneGeometry
from omniscv.sources.base import Capture, ObjectTable, Request, Source, SourceWrapper, not_picklable
from omniscv.sources.world import World


class ProcessBound(SourceWrapper):
    """A live source that refuses to work in a forked child, and leaves its server alone when closed there."""

    def __init__(self, source: Source, address: str) -> None:
        super().__init__(source)
        self._address, self._process = address, os.getpid()

    def capture(self, requests: Iterable[Request]) -> Iterator[Capture]:
        self._check_process()
        return super().capture(requests)

    def objects(self) -> ObjectTable:
        self._check_process()
        return super().objects()

    def geometry(self) -> SceneGeometry:
        self._check_process()
        return super().geometry()

    def without(self, objects: Iterable[str]) -> Source:
        self._check_process()
        return ProcessBound(super().without(objects), self._address)

    def at(self, instant: Instant) -> Source:
        self._check_process()
        return ProcessBound(super().at(instant), self._address)

    def command(self, text: str) -> str:
        self._check_process()
        return super().command(text)

    @property
    def world(self) -> World:
        self._check_process()
        return super().world

    def close(self) -> None:
        if self._process == os.getpid():
            super().close()

    def __reduce__(self) -> NoReturn:
        raise not_picklable(self._address)

    def _check_process(self) -> None:
        if self._process != os.getpid():
            wanted = "expected to be used by the process that opened it, got a fork of that process"
            raise SourceError(f"{self._address}: {wanted}; open it again there")
