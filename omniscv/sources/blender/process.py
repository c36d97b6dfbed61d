"""A process that speaks as ``inside/main.py`` does, over its standard input and output."""

import json
import os
import shutil
import signal
import subprocess
import tempfile
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

from omniscv.arguments import shown
from omniscv.errors import BadReplyError, DeadlineError, ServerConnectionError, ServerRefusedError

MARK = b"\n--omniscv-blender-1--\n"
"""What comes before the first reply; as in ``inside/main.py``, which cannot import this."""
_MOST_NOISE = 1 << 20  # bytes before the mark
_MOST_REPLY = 1 << 27  # bytes: boxes of as many objects as there can be take a tenth
_LAST_OUTPUT = 10_000  # bytes


class Process:
    """A running Blender; its pictures come in files of a folder of its own.

    Args:
        command: what to run.
        name: of the scene, for messages.
        timeout_s: how long starting, and each reply, may take.

    Attributes:
        folder: for pictures; removed with the process.
        hello: its first reply.

    Raises:
        ServerConnectionError: it cannot be run, or it ended.
        DeadlineError: it did not speak in time.
    """

    def __init__(self, command: Sequence[str], name: str, timeout_s: float) -> None:
        self._name, self._timeout_s = name, timeout_s
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
            wanted = f"{name}: expected Blender to run"
            raise ServerConnectionError(f"{wanted}, got: {cause.strerror}: {shown(command[0])}") from cause
        with self._exchange("start"):
            self._skip_noise()
            self.hello = self._reply()

    def ask(self, what: str, message: Mapping[str, Any]) -> dict[str, Any]:
        """Send a request, and return its reply. After any error but a refusal the process has ended.

        Args:
            what: the process is to do, for messages.
            message: plain JSON values.

        Raises:
            ServerRefusedError: Blender reports an error.
            ServerConnectionError: it ended.
            DeadlineError: no reply in time.
            BadReplyError: a reply of another form.
        """
        data = json.dumps(message).encode()
        with self._exchange(what):
            assert self._process.stdin is not None
            with suppress(BrokenPipeError):  # the end of its replies says so too
                self._process.stdin.write(len(data).to_bytes(4, "big") + data)
                self._process.stdin.flush()
            reply = self._reply()
        if "error" in reply:
            raise ServerRefusedError(f"{self._name}: expected Blender to {what}, got: {reply['error']}")
        return reply

    def stop(self) -> None:
        """End the process, in the middle of a picture too, and remove its folder."""
        self._kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout, self._output):
            assert stream is not None
            with suppress(OSError):  # of a request that was not sent
                stream.close()
        shutil.rmtree(self.folder, ignore_errors=True)

    @contextmanager
    def _exchange(self, what: str) -> Iterator[None]:
        """Bound an exchange in time; whatever interrupts it ends the process, which would be out of step."""
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
            wanted = f"{self._name}: expected Blender to {what}"
            if late.is_set():
                advice = f"within {self._timeout_s:g} s, got nothing; raise timeout_s if that takes so long"
                fault: Exception = DeadlineError(f"{wanted} {advice}")
            else:
                why = self._why_it_ended()
                fault = ServerConnectionError(f"{wanted}, but {why}. Its last output: {self._last_line()}")
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
        with suppress(OSError):  # of a process that has ended
            if os.name == "posix":
                os.killpg(self._process.pid, signal.SIGKILL)
            else:
                self._process.kill()

    def _skip_noise(self) -> None:
        noise = b""
        while not noise.endswith(MARK):
            noise += self._read(1)
            if len(noise) > _MOST_NOISE:
                raise BadReplyError(f"{self._name}: expected Blender to start, got {shown(noise[:80])}")

    def _reply(self) -> dict[str, Any]:
        length = int.from_bytes(self._read(4), "big")
        data = self._read(length) if length <= _MOST_REPLY else b""
        try:
            reply = json.loads(data)
        except ValueError:
            reply = None
        if not isinstance(reply, dict):
            wanted = f"{self._name}: expected a reply in JSON"
            raise BadReplyError(f"{wanted}, got {shown(data[:80])} of {length} bytes")
        return reply

    def _read(self, count: int) -> bytes:
        assert self._process.stdout is not None
        data = self._process.stdout.read(count)
        if len(data) < count:
            raise EOFError
        return data

    def _why_it_ended(self) -> str:
        code = self._process.wait()
        if code == -signal.SIGKILL:
            return "it was killed, as when memory runs out"
        return f"it ended by signal {-code}" if code < 0 else f"it ended with code {code}"

    def _last_line(self) -> str:
        self._output.seek(max(0, self._output.seek(0, os.SEEK_END) - _LAST_OUTPUT))
        lines = self._output.read().decode(errors="replace").split("\n")
        return next((shown(line.strip())[1:-1] for line in reversed(lines) if line.strip()), "nothing")
