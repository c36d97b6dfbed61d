"""Dialect M: the branches 4.22, 4.25 and 4.27. It calls itself 0.3.10, but has the 1.x commands."""

from __future__ import annotations

from mock_server.dialects.common import Row
from mock_server.dialects.modern import BAD_ARGUMENT, Modern
from mock_server.world import Camera


class M(Modern):
    """The 1.x command set before 1.0."""

    def rows(self) -> list[Row]:
        return [row for row in super().rows() if row[0] != "vget /level/name"]

    def size(self, camera: Camera) -> str:
        """The plugin bound the getter to the setter, which misses its arguments."""
        return BAD_ARGUMENT
