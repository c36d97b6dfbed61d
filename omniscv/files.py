"""Files that others wrote, read within a bound."""

from pathlib import Path

from omniscv.errors import ArgumentError


def read_bytes(path: Path, most: int) -> bytes:
    """Return the bytes of a file, ``most`` at most.

    Raises:
        ArgumentError: it cannot be read, or is larger; a device is never read to its end.
    """
    try:
        with path.open("rb") as file:
            data = file.read(most + 1)
    except (OSError, ValueError) as cause:  # ValueError: a NUL in the name
        wrong = getattr(cause, "strerror", None) or str(cause)
        raise ArgumentError(f"expected a readable file, got {wrong}") from cause
    if len(data) > most:
        raise ArgumentError(f"expected a file of at most {most} bytes, got a larger one")
    return data
