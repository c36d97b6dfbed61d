"""The file of a recording: it appears, or is replaced, as a whole."""

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from omniscv import storage
from omniscv.arguments import shown
from omniscv.errors import ArgumentError, RecordingNotWritableError
from omniscv.sources.recording.schema import errors_of
from omniscv.storage.local import move_new, remove_scratch, scratch_folder


def target_of(path: Path | str) -> Path:
    """Return where a recording is, or will be written: links are followed.

    Raises:
        RecordingNotWritableError: something that is no regular file is there.
        ArgumentError: it is no path.
    """
    target = followed(path)
    kind = kind_of(target)
    if kind not in ("", "a file"):
        raise RecordingNotWritableError(f"expected a file or a free name, got {kind}; name another", path)
    return target


def followed(path: Path | str) -> Path:
    """Return a path with links followed; ArgumentError for a text that is no path on this machine."""
    if storage.is_url(path) or storage.was_url(path):
        expected = "expected a path on this machine"
        advice = "record there, and put it into the store by 'omniscv recording merge'"
        raise ArgumentError(f"recording: {expected}, got {storage.without_secrets(path)}; {advice}")
    try:
        return Path(os.path.realpath(path))
    except ValueError as cause:  # it has a NUL
        raise ArgumentError(f"recording: expected a path, got {shown(str(path))}: {cause}") from cause


def kind_of(path: Path) -> str:
    """Return what is at a path, in words; empty if nothing is."""
    if os.path.isfile(path):
        return "a file"
    if os.path.isdir(path):
        return "a folder"
    if os.path.exists(path):
        return "a device, a FIFO or a socket"
    return "a link without an end" if os.path.islink(path) else ""


@contextlib.contextmanager
def written_for(target: Path) -> Iterator[Path]:
    """Yield where to write the file that will be moved to a path, in a scratch folder beside it.

    Raises:
        RecordingNotWritableError: the folder of the path cannot be created or written.
    """
    with contextlib.ExitStack() as stack:
        with errors_of(target, write=True):
            target.parent.mkdir(parents=True, exist_ok=True)
            remove_leftovers(target)
            folder = stack.enter_context(scratch_folder(target.parent, f".{target.name}-"))
        yield folder / target.name


def remove_leftovers(target: Path) -> None:
    """Remove the scratch folders that killed processes left of a file that was to be moved to a path."""
    remove_scratch(target.parent, f".{target.name}-")


def publish(file: Path, target: Path) -> None:
    """Move a complete file to its path in one step, and remove the logs of the file that was there."""
    with errors_of(target, write=True):
        if target.exists():
            shutil.copymode(target, file)
        file.replace(target)
        for suffix in ("-journal", "-wal", "-shm"):
            Path(f"{target}{suffix}").unlink(missing_ok=True)
        _sync_folder(target.parent)


def publish_new(file: Path, target: Path) -> bool:
    """Move a complete file to its path; return False if another process has just created a file there."""
    with errors_of(target, write=True):
        if kind_of(target) and not target.stat().st_size:
            file.replace(target)
        elif not move_new(file, target):
            return False
        _sync_folder(target.parent)
        return True


def _sync_folder(path: Path) -> None:
    """Flush a folder, where that is possible, so that a renamed file outlives a power cut."""
    with contextlib.suppress(OSError):
        folder = os.open(path, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
