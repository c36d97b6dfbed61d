"""Read untrusted files within bounds: bytes, texts, JSON and YAML as plain values.

The YAML reader is that of the mock server, which imports nothing of this package.
"""

import json
import os
import stat
import sys
import unicodedata
from io import BufferedReader
from pathlib import Path
from typing import IO, Any, NoReturn

from mock_server import yaml_text
from omniscv.arguments import shown
from omniscv.errors import ArgumentError

MOST_YAML_BYTES = yaml_text.MOST_BYTES
MOST_JSON_BYTES = 1 << 26
"""Of records of one frame; a list of many frames may have more."""
MOST_PICTURE_BYTES = 1 << 30
_TAIL_BYTES = 10_000  # in which the last line of a program's output is sought

encoding_of = yaml_text.encoding_of


def open_regular(path: Path, links: bool = True, most: int = sys.maxsize) -> BufferedReader:
    """Open a regular file to read: no folder, device or pipe, which may have no end.

    Args:
        path: the file.
        links: whether it may be a symbolic link, which may lead anywhere.
        most: bytes that it may have.

    Raises:
        FileNotFoundError: nothing has that name.
        ArgumentError: it cannot be read, is no regular file, or has more bytes.
    """
    if not links and path.is_symlink():
        raise ArgumentError("expected a regular file, got a link")
    try:
        opened = os.open(path, os.O_RDONLY | _NO_WAIT)
    except FileNotFoundError:
        raise
    except (OSError, ValueError) as cause:  # ValueError: a NUL in the name
        reason = getattr(cause, "strerror", None) or str(cause)
        raise ArgumentError(f"expected a readable file, got {reason}") from cause
    status = os.fstat(opened)
    if stat.S_ISREG(status.st_mode) and status.st_size <= most:
        return os.fdopen(opened, "rb")
    os.close(opened)
    if stat.S_ISREG(status.st_mode):
        raise ArgumentError(f"expected a file of at most {most} bytes, got a larger one")
    raise ArgumentError("expected a regular file, got a folder, a device or a pipe")


_NO_WAIT = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
"""Opening a pipe does not wait for its other end."""


def named_file(folder: Path, name: str) -> Path:
    """Return the path of a file in a folder; letters on disk may be composed otherwise, as macOS writes them.

    Args:
        folder: where it is.
        name: as another file or a user has it.
    """
    path = folder / name
    if name.isascii() or path.exists():
        return path
    for form in ("NFC", "NFD"):
        other = folder / unicodedata.normalize(form, name)
        if other.exists():
            return other
    return path


def read_bytes(path: Path, most: int) -> bytes:
    """Return the bytes of a regular file at ``path``; ArgumentError if it cannot be read, or has more than
    ``most`` bytes."""
    try:
        with open_regular(path, most=most) as file:
            return file.read()
    except OSError as cause:
        raise ArgumentError(f"expected a readable file, got {cause.strerror}") from cause


def last_line(output: IO[bytes]) -> str:
    """Return the beginning of a program's last line of output that is not blank, for an error message.

    Args:
        output: the file of the output, open to read; only its last ``_TAIL_BYTES`` are read.

    Returns:
        The line as :func:`shown` cuts and escapes it, without quotation marks; ``nothing`` without a line.
    """
    size = output.seek(0, os.SEEK_END)
    output.seek(max(0, size - _TAIL_BYTES))
    tail = output.read().decode(errors="replace")
    for line in reversed(tail.split("\n")):
        if line.strip():
            return shown(line.strip())[1:-1]
    return "nothing"


def parse_json(data: bytes, most: int = MOST_JSON_BYTES) -> Any:
    """Return the value of a JSON document.

    Args:
        data: its bytes, in the encodings of :func:`decode_text`.
        most: bytes that it may have.

    Raises:
        ArgumentError: more bytes, no JSON (NaN and infinity are none), one nested too deeply, a number of too
            many digits, or a text that is no Unicode.
    """
    if len(data) > most:
        raise ArgumentError(f"expected JSON of at most {most} bytes, got {len(data)}")
    try:
        document = yaml_text.decoded(data)
        value = json.loads(document, parse_constant=_no_number)
        if "\\u" in document:  # which can write half of a surrogate pair
            json.dumps(value, ensure_ascii=False).encode()
    except UnicodeEncodeError as cause:
        raise ArgumentError(f"expected texts of Unicode, got {cause.object[cause.start]!a}") from cause
    except (ValueError, RecursionError) as cause:
        raise ArgumentError(f"expected JSON, got: {shown(str(cause))}") from cause
    return value


def _no_number(word: str) -> NoReturn:
    """Refuse NaN and infinity, which Python's reader takes."""
    raise ValueError(f"{word}, which JSON does not have")


def decode_text(data: bytes, errors: str = "strict") -> str:
    """Return the text of bytes.

    Args:
        data: UTF-8, with a byte-order mark or without, or UTF-16 with one.
        errors: ``strict``: ArgumentError for other bytes; ``replace``, where only comments can have others.
    """
    try:
        return yaml_text.decoded(data, errors)
    except ValueError as cause:
        raise ArgumentError(str(cause)) from cause


def read_text(path: Path) -> str:
    """Return the text of a file of YAML, JSON or XML, of at most ``MOST_YAML_BYTES``; see
    :func:`decode_text`."""
    try:
        return yaml_text.read_text(path)
    except ValueError as cause:
        raise ArgumentError(str(cause)) from cause


def parse_yaml(text: str) -> Any:
    """Return the value of a YAML (or JSON) document: texts, numbers, truth values, None, lists, mappings."""
    try:
        return yaml_text.parse(text)
    except ValueError as cause:
        raise ArgumentError(str(cause)) from cause


def library_error(reader: Any) -> str:
    """Return the error of OpenImageIO, its reader or its writer; names in files may not be UTF-8."""
    try:
        return str(reader.geterror())
    except UnicodeDecodeError:
        return "names that are no UTF-8"
