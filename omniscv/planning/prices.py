"""What captures cost a source: a time for every request, and one for every megapixel."""

from __future__ import annotations

from typing import Any, NamedTuple


class Price(NamedTuple):
    """What a source takes, ms.

    Attributes:
        request: of every request.
        megapixel: of every megapixel.
    """

    request: float = 5.0
    megapixel: float = 25.0

    def of(self, requests: Any, pixels: Any) -> Any:
        """Return the ms of requests and of all their pixels."""
        return self.request * requests + self.megapixel * 1e-6 * pixels
