"""A function that is compiled, to find out whether compiled code can be kept on disk."""

from numba import njit


@njit(cache=True)
def probe(value: float) -> float:
    """Return its argument."""
    return value
