"""Files that others wrote, read within a bound: bytes, texts, and YAML as plain values.

The YAML reader is the mock server's, which imports nothing of this package: one reader serves both.
"""

from pathlib import Path
from typing import Any

from mock_server import yaml_text
from omniscv.errors import ArgumentError

MOST_YAML_BYTES = yaml_text.MOST_BYTES


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


def read_text(path: Path) -> str:
    """Return the text of a file of YAML, JSON or XML.

    Raises:
        ArgumentError: it cannot be read, is larger than ``MOST_YAML_BYTES``, or is not UTF-8.
    """
    try:
        return yaml_text.read_text(path)
    except ValueError as cause:
        raise ArgumentError(str(cause)) from cause


def parse_yaml(text: str) -> Any:
    """Return the value of a YAML (or JSON) document: texts, numbers, truth values, None, lists, mappings.

    Raises:
        ArgumentError: invalid YAML, or beyond the bounds of the mock server's reader; with the line.
    """
    try:
        return yaml_text.parse(text)
    except ValueError as cause:
        raise ArgumentError(str(cause)) from cause
