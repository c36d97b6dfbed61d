"""Which files of a folder are of an image that was saved there: the only ones that are replaced.

``STEM.json`` lists the files of its image. While they are written, a hidden file says so: whatever kills the
process, the next one knows them.
"""

import os
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from omniscv import modalities
from omniscv.arguments import texts
from omniscv.errors import ArgumentError
from omniscv.pictures.forms import ARRAY, FORMS
from omniscv.storage import folder, in_the_way
from omniscv.storage.bounded import MOST_JSON_BYTES, parse_json, read_bytes
from omniscv.storage.local import remove_parts

OBJECTS = "objects.json"
"""The file of the objects of all images in a folder."""

_DESCRIBED = {"blank", "versions"}
"""Keys of the ``STEM.json`` of every image; that of a dataset's frame has neither."""


def check_free(out: Path, stem: str) -> None:
    """Raise ArgumentError if files of others have names of files of an image."""
    names = {f"{stem}.json", *_layer_names(stem)}
    if strange := sorted(name for name in names - _own(out, stem) if (out / name).exists()):
        raise in_the_way(folder(out), strange, f"the image {stem!r}")


def is_image(path: Path) -> bool:
    """Return whether a file is the ``STEM.json`` of an image."""
    return _description(path) is not None


@contextmanager
def replacing(out: Path, stem: str, names: Iterable[str]) -> Iterator[None]:
    """Replace the files of an image by those that the context writes.

    What the earlier image had, and the new one has not, is removed when the context ends without an error.

    Args:
        out: the folder, which exists.
        stem: start of the files' names.
        names: of the files that are written.

    Raises:
        ArgumentError: files of others have names of files of the image.
    """
    check_free(out, stem)
    new = set(names)
    own = {name for name in _own(out, stem) if (out / name).exists()}
    journal = _journal(out, stem)
    if _is_abandoned(journal):
        for name in (OBJECTS, f"{stem}.json", *_layer_names(stem)):
            remove_parts(out / name)
    journal.touch()
    with suppress(OSError):  # of a full disk, which the first layer names
        journal.write_text(str(os.getpid()), encoding="utf-8")
    try:
        yield
    except BaseException:
        if not any((out / name).exists() for name in new - own):
            journal.unlink()
        raise
    for name in own - new:
        (out / name).unlink(missing_ok=True)
    journal.unlink(missing_ok=True)


def _is_abandoned(journal: Path) -> bool:
    """Return whether a process that wrote an image has been killed."""
    if sys.platform == "win32" or not journal.exists():  # there, signal 0 would end a process
        return False
    try:
        os.kill(int(journal.read_text(encoding="utf-8")), 0)
    except (ProcessLookupError, ValueError):
        return True
    except OSError:
        return False
    return False


def _own(out: Path, stem: str) -> set[str]:
    """Return the names of the files of an image, and of one that a killed process has written in part."""
    own: set[str] = set()
    description = _description(out / f"{stem}.json")
    if description is not None:
        own |= {f"{stem}.json", *_listed(description, stem)}
    if _journal(out, stem).exists():  # no file of others had such a name when it was made
        own |= _layer_names(stem)
    return own


def _listed(description: Mapping[str, Any], stem: str) -> Collection[str]:
    """Return the files that a description lists; version 0.2 listed none: all that layers may have."""
    return texts("files", description["files"]) if "files" in description else _layer_names(stem)


def _description(path: Path) -> Mapping[str, Any] | None:
    """Return the content of the ``STEM.json`` of an image; None for another file."""
    try:
        content = parse_json(read_bytes(path, MOST_JSON_BYTES))
    except (OSError, ArgumentError):
        return None
    is_described = isinstance(content, Mapping) and content.keys() >= _DESCRIBED and "frame" not in content
    return content if is_described else None


def _layer_names(stem: str) -> set[str]:
    """Return every name that a layer of an image may have."""
    names = set()
    for row in modalities.layers():
        for suffix in (*FORMS, ARRAY):
            names.add(f"{stem}.{row.name}.{suffix}")
    return names


def _journal(out: Path, stem: str) -> Path:
    return out / f".{stem}.written"
