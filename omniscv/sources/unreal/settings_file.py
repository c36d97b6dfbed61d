"""The plugin's ``unrealcv.ini``, borrowed while a game starts: the file that was there comes back.

The plugin reads it once, when it starts (protocol reference, section 1.5). The user's file is renamed, so
that it comes back as it was; where the process was killed before, the next launch puts it back. The folder is
locked: another launch of the package waits.
"""

import errno
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from omniscv.errors import DeadlineError, SourceError

NAME = "unrealcv.ini"
BACKUP = f"{NAME}.omniscv-backup"

_MARK = f"; written by omniscv for one launch; settings from before are in {BACKUP}\n"
_NO_LOCKS = (errno.EBADF, errno.ENOLCK, errno.ENOTSUP, errno.EINVAL)
"""Where folders of a network cannot be locked, two launches of one package must not start together."""


@contextmanager
def borrowed(folder: Path, text: str, timeout_s: float) -> Iterator[None]:
    """Write the settings of a folder; put back what was there at the end.

    Raises:
        DeadlineError: another launch has them for longer than so many seconds.
        SourceError: the folder cannot be written, or what a killed launch has left was changed since.
    """
    file, backup = folder / NAME, folder / BACKUP
    with _locked(folder, timeout_s):
        _put_back_after_a_kill(file, backup)
        try:
            if os.path.lexists(file):
                file.replace(backup)
            file.write_text(_MARK + text, encoding="ascii")
        except OSError as cause:
            raise SourceError(f"{file}: expected a file that can be written: {cause.strerror}") from cause
        try:
            yield
        finally:
            if os.path.lexists(backup):
                backup.replace(file)
            else:
                file.unlink(missing_ok=True)


def _put_back_after_a_kill(file: Path, backup: Path) -> None:
    there = file.read_text(encoding="ascii", errors="replace") if file.is_file() else ""
    ours = there.startswith(_MARK)
    if os.path.lexists(backup):
        if there and not ours:
            kept = f"{backup.name}, from a launch that was killed, or {file.name}, changed since"
            raise SourceError(f"{file.parent}: expected either {kept}; keep one of them as {file.name}")
        backup.replace(file)
    elif ours:
        file.unlink()


@contextmanager
def _locked(folder: Path, timeout_s: float) -> Iterator[None]:
    """Hold the lock of a folder, which ends with the process; Windows has none."""
    if os.name != "posix":
        yield
        return
    import fcntl

    deadline = time.monotonic() + timeout_s
    opened = os.open(folder, os.O_RDONLY)
    try:
        while True:
            try:
                fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError as cause:
                if time.monotonic() > deadline:
                    raise DeadlineError(f"{folder}: another launch has not started yet") from cause
                time.sleep(0.1)
            except OSError as cause:
                if cause.errno not in _NO_LOCKS:
                    raise
                break
        yield
    finally:
        with suppress(OSError):
            os.close(opened)
