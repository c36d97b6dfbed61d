"""Time: whole nanoseconds in memory and in files, seconds for people."""

from decimal import Decimal
from fractions import Fraction

NS = 10**9
"""Nanoseconds of a second."""

SINCE_1970_NS = 10**8 * NS
"""Times beyond are those since 1970: sources have clocks that start with them."""


def nanoseconds(seconds: float) -> int:
    """Return the nearest whole nanoseconds."""
    return round(Fraction(seconds) * NS)


def parsed(text: str, per_s: int = 1) -> int:
    """Return the nearest whole nanoseconds of a decimal number, of which ``per_s`` are a second."""
    return int((Decimal(text) * NS / per_s).to_integral_value())


def decimal(time_ns: int) -> str:
    """Return seconds with all their digits: ``1403715274.302142976``, ``0.5``, ``3``."""
    whole, part = divmod(abs(time_ns), NS)
    return "-" * (time_ns < 0) + f"{whole}.{part:09d}".rstrip("0").removesuffix(".")
