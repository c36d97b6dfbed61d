"""Files that commands write, kept inside one folder."""

import contextlib
import functools
import itertools
import tempfile
from pathlib import Path


class OutputFolder:
    """The folder that file commands write to: never outside, whatever the name is.

    None is a temporary one, removed by ``close``.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._folder, self._numbers = folder, itertools.count(1)
        self._opened = contextlib.ExitStack()
        self.close = self._opened.close

    @functools.cached_property
    def path(self) -> Path:
        """The folder; made on first use."""
        if self._folder is not None:
            return self._folder
        return Path(self._opened.enter_context(tempfile.TemporaryDirectory(prefix="mock-unrealcv-")))

    def next_name(self) -> str:
        """Return a new name, for an image without one."""
        return f"{next(self._numbers):08d}.png"

    def write(self, name: str, data: bytes) -> None:
        """Write a file. What cannot be written is left out, as are names that lead out of the folder."""
        folder = self.path.resolve()
        with contextlib.suppress(OSError, ValueError):  # ValueError: a name with a null byte
            target = (folder / name).resolve()
            if target.is_relative_to(folder):
                target.write_bytes(data)
