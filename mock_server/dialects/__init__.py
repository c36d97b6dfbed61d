"""The dialects by name."""

from mock_server.dialects.common import Dialect
from mock_server.dialects.l import L
from mock_server.dialects.m import M
from mock_server.dialects.n1 import N1
from mock_server.dialects.n2 import N2

BY_NAME: dict[str, type[Dialect]] = {"1.x": N1, "0.3.10": L, "L": L, "M": M, "N1": N1, "N2": N2}
"""``1.x`` is for those who do not care which. The letters are those of the protocol reference."""
