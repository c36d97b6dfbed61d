"""The dialects by name."""

from mock_server.dialects.common import Dialect
from mock_server.dialects.v0_3_10 import Plugin0310
from mock_server.dialects.v1 import Branch52, Branch422, Plugin1, Plugin11
from mock_server.settings import DialectName

BY_NAME: dict[DialectName, type[Dialect]] = {
    "1.x": Plugin11, "0.3.10": Plugin0310,
    "L": Plugin0310, "M": Branch422, "N1": Plugin1, "N2": Branch52, "N3": Plugin11,
}  # fmt: skip
"""``1.x`` is the newest of them. The letters are those of the protocol reference."""
