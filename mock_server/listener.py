"""Where clients come in: TCP, and on Linux, once the first has left, a Unix socket instead."""

from __future__ import annotations

import contextlib
import socket
import threading
from pathlib import Path

_BACKLOG = 1
_POLL_S = 0.02


class Listener:
    """Accepts one client after another; others wait in the system's queue, without a greeting.

    Args:
        host, port: where TCP listens; port 0 takes any free one.
        unix: whether to leave TCP for good after the first client, as plugin 1.0 does on Linux: who
            connects by TCP then waits for ever.
    """

    def __init__(self, host: str, port: int, unix: bool) -> None:
        self._tcp = socket.create_server((host, port), backlog=_BACKLOG)
        self._tcp.settimeout(_POLL_S)
        self.host, self.port = self._tcp.getsockname()[:2]
        self._wants_unix = unix
        self._unix: socket.socket | None = None
        self._served = 0

    @property
    def unix_path(self) -> Path:
        """The Unix socket's place, fixed by the protocol (reference, section 1.2)."""
        return Path(f"/tmp/unrealcv_{self.port}.socket")

    @property
    def on_unix(self) -> bool:
        """Whether TCP has been left."""
        return self._unix is not None

    def accept(self, stopping: threading.Event) -> socket.socket | None:
        """The next client; None when it is time to stop."""
        if self._wants_unix and self._served and self._unix is None:
            self._unix = self._open_unix()
        listener = self._unix or self._tcp
        while not stopping.is_set():
            with contextlib.suppress(TimeoutError):
                connection, _ = listener.accept()
                if not self.on_unix:
                    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._served += 1
                return connection
        return None

    def close(self) -> None:
        """Stops listening, and removes the Unix socket."""
        self._tcp.close()
        if self._unix is not None:
            self._unix.close()
            self.unix_path.unlink(missing_ok=True)

    def _open_unix(self) -> socket.socket:
        self.unix_path.unlink(missing_ok=True)
        listener = socket.socket(socket.AF_UNIX)
        listener.bind(str(self.unix_path))
        listener.listen(_BACKLOG)
        listener.settimeout(_POLL_S)
        return listener
