"""The dialects by name."""

from mock_server.dialects.common import Dialect
from mock_server.dialects.n1 import N1

BY_NAME: dict[str, type[Dialect]] = {"N1": N1, "1.x": N1}
"""``1.x`` is what a user means who does not care which."""
