"""Files that commands ask for, kept inside one folder."""

from __future__ import annotations

import contextlib
import tempfile
from pathlib import Path


class OutputFolder:
    """Where a server's file commands write: never outside, whatever the name says.

    Args:
        folder: the folder; None makes a temporary one when the first file is written, removed at ``close``.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder
        self._temporary: tempfile.TemporaryDirectory[str] | None = None
        self._count = 0

    @property
    def path(self) -> Path:
        """The folder; made on first use."""
        if self._folder is None:
            self._temporary = tempfile.TemporaryDirectory(prefix="mock-unrealcv-")
            self._folder = Path(self._temporary.name)
        return self._folder

    def next_name(self) -> str:
        """A name for an image that was given none."""
        self._count += 1
        return f"{self._count:08d}.png"

    def write(self, name: str, data: bytes) -> bool:
        """Writes a file, and tells whether it could: a name that leads out of the folder cannot."""
        folder = self.path.resolve()
        with contextlib.suppress(OSError, ValueError):  # ValueError: a name with a null byte
            target = (folder / name).resolve()
            if target.is_relative_to(folder):
                target.write_bytes(data)
                return True
        return False

    def close(self) -> None:
        """Removes the temporary folder, if there is one."""
        if self._temporary is not None:
            self._temporary.cleanup()
