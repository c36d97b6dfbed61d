"""Blender with a scene open: a process that is started when first needed, and again after a fault.

It speaks as ``inside.py`` describes, over its standard input and output.
"""

import contextlib
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, TypeVar

from omniscv.arguments import shown
from omniscv.errors import (
    ArgumentError,
    BadReplyError,
    DeadlineError,
    ServerConnectionError,
    ServerRefusedError,
    SourceError,
)
from omniscv.modalities import Transfer
from omniscv.records import mapping
from omniscv.sources.blender import Settings
from omniscv.storage.bounded import last_line, parse_json

T = TypeVar("T")

TIMEOUT_S = 600.0
RETRIES = 3
OLDEST = (5, 0)
"""Passes of EXR files and the settings of pictures have other names before Blender 5.0."""
MARK = b"\n--omniscv-blender-1--\n"
"""Comes before the first reply; as in ``inside.py``, which cannot import this."""
_MOST_NOISE = 1 << 20  # bytes before the mark
_MOST_REPLY = 1 << 27  # bytes: the boxes of as many objects as there can be take a tenth
_LONGEST = 1000  # characters of an error of Blender
_RETRIED = (ServerConnectionError, DeadlineError, BadReplyError)


@dataclass(frozen=True)
class Opened:
    """The reply to ``open``: what is known of the scene, named ``scene``, before anything is rendered."""

    scene: str
    frame: int  # of its animation
    objects: Mapping[str, int]  # by name, the id that pictures show
    world: bool  # whether there is one: among `lights`
    lights: Mapping[str, Mapping[str, int]]  # by name, the settings to vary, how many numbers each has
    materials: Mapping[str, Mapping[str, int]]  # the same
    metres: float  # of a unit of the scene
    transfer: Transfer  # what 8-bit colours say of light, by the scene's view transform
    camera: Sequence[float] | None  # where the scene's own camera is, metres
    libraries: Sequence[str]  # the files that it links
    missing: Sequence[str]  # those of them and of its textures that are not there


class Process:
    """A running Blender, without a scene at first, and a ``folder`` for the files of its pictures."""

    def __init__(self, command: Sequence[str], name: str, timeout_s: float) -> None:
        self._name = name
        self._timeout_s = timeout_s
        self._output: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - closed by stop
        self.folder = Path(tempfile.mkdtemp(prefix="omniscv-blender-"))
        pipe = subprocess.PIPE
        try:
            # In a session of its own, Ctrl-C does not reach it: captures that are under way are finished.
            self._process = subprocess.Popen(
                command, stdin=pipe, stdout=pipe, stderr=self._output, start_new_session=True
            )
        except OSError as cause:
            shutil.rmtree(self.folder, ignore_errors=True)
            self._output.close()
            expected = f"{name}: expected Blender to run"
            raise ServerConnectionError(f"{expected}, got: {cause.strerror}: {shown(command[0])}") from cause
        with self._exchange("start"), self.understood("start"):
            self._skip_noise()
            self.version = tuple(map(int, self._reply()["version"]))

    def ask(self, what: str, message: Mapping[str, Any]) -> dict[str, Any]:
        """Send a ``message`` that requests ``what``, and return the reply.

        Raises:
            ServerRefusedError: an error of Blender.
        """
        data = json.dumps(message).encode()
        with self._exchange(what):
            assert self._process.stdin is not None
            with contextlib.suppress(BrokenPipeError):  # the end of its replies says so too
                self._process.stdin.write(len(data).to_bytes(4, "big") + data)
                self._process.stdin.flush()
            values = self._reply()
        if isinstance(error := values.get("error"), str):
            raise ServerRefusedError(f"{self._name}: expected Blender to {what}, got: {error[:_LONGEST]}")
        return values

    def stop(self) -> None:
        """End the process, even while it renders, and remove its folder."""
        self._kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout, self._output):
            assert stream is not None
            with contextlib.suppress(OSError):  # of a request that was not sent
                stream.close()
        shutil.rmtree(self.folder, ignore_errors=True)

    @contextlib.contextmanager
    def _exchange(self, what: str) -> Iterator[None]:
        """Bound an exchange in time; after any interruption the process is stopped, for it is out of step."""
        late = threading.Event()

        def give_up() -> None:
            late.set()
            self._kill()

        timer = threading.Timer(self._timeout_s, give_up)
        timer.daemon = True
        timer.start()
        try:
            yield
        except EOFError as end:
            expected = f"{self._name}: expected Blender to {what}"
            if late.is_set():
                advice = f"within {self._timeout_s:g} s, got nothing; raise timeout_s if that takes so long"
                fault: Exception = DeadlineError(f"{expected} {advice}")
            else:
                why = f"{self._why_it_ended()}. Its last output: {last_line(self._output)}"
                fault = ServerConnectionError(f"{expected}, but {why}")
            self.stop()
            raise fault from end
        except BaseException:
            self.stop()
            raise
        finally:
            timer.cancel()

    def _kill(self) -> None:
        if self._process.returncode is not None:
            return  # its id may be another's by now
        with contextlib.suppress(OSError):  # of a process that has ended
            if sys.platform != "win32":
                os.killpg(self._process.pid, signal.SIGKILL)
            else:
                self._process.kill()

    def _skip_noise(self) -> None:
        noise = bytearray()
        while not noise.endswith(MARK):
            noise += self._read(1)
            if len(noise) > _MOST_NOISE:
                start = shown(bytes(noise[:80]))
                raise BadReplyError(f"{self._name}: expected Blender to start, got {start}")

    def _reply(self) -> dict[str, Any]:
        length = int.from_bytes(self._read(4), "big")
        data = self._read(length) if length <= _MOST_REPLY else b""
        try:
            return mapping("", parse_json(data, _MOST_REPLY))
        except ArgumentError as cause:
            expected = f"{self._name}: expected a reply in JSON"
            raise BadReplyError(f"{expected}, got {shown(data[:80])} of {length} bytes") from cause

    @contextlib.contextmanager
    def understood(self, what: str) -> Iterator[None]:
        """Raise BadReplyError for a reply of another form."""
        try:
            yield
        except (LookupError, TypeError, ValueError, AttributeError) as cause:
            expected = f"{self._name}: expected Blender to {what}"
            raise BadReplyError(f"{expected}, got another reply: {shown(str(cause))}") from cause

    def _read(self, count: int) -> bytes:
        assert self._process.stdout is not None
        data = self._process.stdout.read(count)
        if len(data) < count:
            raise EOFError
        return data

    def _why_it_ended(self) -> str:
        code = self._process.wait()
        if sys.platform != "win32" and code == -signal.SIGKILL:
            return "it was killed, as when memory runs out"
        return f"it ended by signal {-code}" if code < 0 else f"it ended with code {code}"


class Blender:
    """One process at a time, in which one scene is open; not to be used by two threads at once.

    Args:
        command, settings: of Blender, and what to open.
        timeout_s: how long starting and loading, and each picture, may take.
        retries: how often in a row to start Blender again, and send the request again.

    Attributes:
        name: of the scene's file, for messages.
        version: of Blender, such as ``5.0.1``.
        scene: what is known of it.
        digest: of the scene's file, of the files that it links, and of the version.

    Raises SourceError if Blender does not start, is too old, or does not open the scene.
    """

    def __init__(
        self, command: Sequence[str], settings: Settings, timeout_s: float = TIMEOUT_S, retries: int = RETRIES
    ) -> None:
        self._command = list(command)
        self._settings = settings
        self._timeout_s = timeout_s
        self._retries = retries
        self.name = Path(settings.path).name
        self._process: Process | None = None
        self.version = ""
        self._start()
        try:
            self.digest = self._digest()
        except BaseException:
            self.close()
            raise

    def ask(self, what: str, message: Mapping[str, Any], reader: Callable[[dict[str, Any], Path], T]) -> T:
        """Send a request, and return what is read of the reply; after a fault, start Blender and send again.

        Args:
            what: Blender is to do, for messages.
            message: the request.
            reader: a function of the reply, and of the folder with the files of its pictures.

        Raises:
            SourceError: an error of Blender, or too many faults in a row.
        """
        for _ in range(self._retries + 1):
            try:
                process = self._process or self._start_again()
                message = {**message, "folder": str(process.folder)}
                with process.understood(what):
                    return reader(process.ask(what, message), process.folder)
            except _RETRIED as cause:
                fault = cause
                self.close()
        raise type(fault)(f"{fault}; gave up after {self._retries + 1} attempts") from fault

    def close(self) -> None:
        if self._process is not None:
            self._process.stop()
            self._process = None

    def _start(self) -> Process:
        with contextlib.ExitStack() as resources:
            process = Process(self._command, self.name, self._timeout_s)
            resources.callback(process.stop)
            self.version = ".".join(map(str, process.version))
            if process.version < OLDEST:
                expected = f"{self.name}: expected Blender {'.'.join(map(str, OLDEST))} or later"
                raise SourceError(f"{expected}, got {self.version} of {self._command[0]}")
            request = {**self._settings.message(), "folder": str(process.folder)}
            with process.understood("open the scene"):
                self.scene = Opened(**process.ask("open the scene", request))
            resources.pop_all()
        self._process = process
        return process

    def _start_again(self) -> Process:
        """Start Blender after a fault; its scene must be what it was."""
        before = self.scene, self.digest
        process = self._start()
        if (self.scene, self._digest()) != before:
            self.close()
            expected = f"{self.name}: expected the scene that was opened first"
            raise SourceError(f"{expected}, got one that was changed since; open it again")
        return process

    def _digest(self) -> str:
        """Return a digest of the scene's file, of the files that it links, and of Blender's version."""
        digest = hashlib.sha256(self.version.encode())
        for path in (self._settings.path, *self.scene.libraries):
            if not os.path.isfile(path):  # a FIFO or a device may have no end
                raise ArgumentError(f"{path}: expected a readable file, got none, or no regular file")
            try:
                with open(path, "rb") as file:
                    digest.update(hashlib.file_digest(file, "sha256").digest())
            except OSError as cause:
                raise ArgumentError(f"{path}: expected a readable file, got {cause.strerror}") from cause
        return digest.hexdigest()[:32]
