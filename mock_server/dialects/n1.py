"""Dialect N1: plugin 1.0.1 of branch 4.27-stable."""

from __future__ import annotations

import re

from mock_server.dialects.modern import Modern


class N1(Modern):
    """Plugin 1.0.1 before its refactoring."""

    version = "1.0.1"
    request = re.compile(rb"(\d+):(.*)")
    has_unix = True

    def client_state(self) -> str:
        """The plugin asks the TCP listener only."""
        return "No Client Connected" if self.on_unix else super().client_state()
