"""Blender with a scene: started when first needed, and again when it has ended."""

import contextlib
import hashlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from omniscv.errors import ArgumentError, BadReplyError, DeadlineError, ServerConnectionError, SourceError
from omniscv.sources.blender.process import Process
from omniscv.sources.blender.settings import Settings

T = TypeVar("T")

TIMEOUT_S, RETRIES = 600.0, 3
OLDEST = (5, 0)
"""Passes of EXR files and the settings of pictures have other names before Blender 5.0."""

_RETRIED = (ServerConnectionError, DeadlineError, BadReplyError)


class Blender:
    """One process at a time, in which one scene is open; not to be used by two threads at once.

    Args:
        command: of Blender, as :func:`omniscv.sources.blender.finding.blender_command` returns it.
        settings: what to open.
        timeout_s: how long starting and loading, and each picture, may take.
        retries: how often in a row to start Blender again, and send the request again.

    Attributes:
        name: of the scene's file, for messages.
        version: of Blender, such as ``5.0.1``.
        scene: what ``inside/main.py`` describes.
        digest: of the scene's file and of the files that it links.

    Raises:
        SourceError: Blender does not start, is too old, or does not open the scene.
    """

    def __init__(
        self, command: Sequence[str], settings: Settings, timeout_s: float = TIMEOUT_S, retries: int = RETRIES
    ) -> None:
        self._command, self._settings = list(command), settings
        self._timeout_s, self._retries = timeout_s, retries
        self.name = Path(settings.path).name
        self._process: Process | None = None
        self.version = ""
        self.scene: dict[str, Any] = {}
        self._start()
        self.digest = self._digest()

    def ask(self, what: str, message: Mapping[str, Any], reader: Callable[[dict[str, Any], Path], T]) -> T:
        """Send a request, and return what ``reader(reply, folder)`` makes of the reply.

        After a fault Blender is started again, and the request sent again.

        Args:
            what: Blender is to do, for messages.
            message: plain JSON values; ``file`` is relative to the folder.
            reader: of the reply, and of the files in the folder of pictures.

        Raises:
            SourceError: Blender reports an error, or too many faults came in a row.
        """
        for _ in range(self._retries + 1):
            try:
                process = self._process or self._start_again()
                reply = process.ask(what, {**message, "folder": str(process.folder)})
                return reader(reply, process.folder)
            except _RETRIED as cause:
                fault = cause
                self.close()
        raise type(fault)(f"{fault}; gave up after {self._retries + 1} attempts") from fault

    def close(self) -> None:
        if self._process is not None:
            self._process.stop()
            self._process = None

    def _start(self) -> Process:
        with contextlib.ExitStack() as held:
            process = Process(self._command, self.name, self._timeout_s)
            held.callback(process.stop)
            version = tuple(process.hello["version"])
            self.version = ".".join(map(str, version))
            if version < OLDEST:
                wanted = f"{self.name}: expected Blender {'.'.join(map(str, OLDEST))} or later"
                raise SourceError(f"{wanted}, got {self.version} of {self._command[0]}")
            opened = {**self._settings.message(), "folder": str(process.folder)}
            self.scene = process.ask("open the scene", opened)
            held.pop_all()
        self._process = process
        return process

    def _start_again(self) -> Process:
        """Start Blender after a fault; its scene must be what it was."""
        before = self.scene, self.digest
        process = self._start()
        if (self.scene, self._digest()) != before:
            self.close()
            wanted = f"{self.name}: expected the scene that was opened first"
            raise SourceError(f"{wanted}, got one that was changed since; open it again")
        return process

    def _digest(self) -> str:
        """Return a digest of the scene's file, of the files that it links, and of Blender's version."""
        found = hashlib.sha256(self.version.encode())
        for path in (self._settings.path, *self.scene["libraries"]):
            try:
                with open(path, "rb") as file:
                    found.update(hashlib.file_digest(file, "sha256").digest())
            except OSError as cause:
                raise ArgumentError(f"{path}: expected a readable file, got {cause.strerror}") from cause
        return found.hexdigest()[:32]
