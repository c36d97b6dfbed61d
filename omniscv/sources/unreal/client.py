"""Connections to a server: the official client under deadlines, and a new connection after every fault.

The official client can block forever, and reads frames of any size (protocol reference, sections 6.2 and
6.3): :class:`Client` replaces how it connects, sends and receives. Framing, ids and text stay the official
client's.
"""

import contextlib
import inspect
import logging
import math
import os
import secrets
import socket
import stat
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType
from typing import Any, TypeVar

from omniscv import arguments
from omniscv.arguments import shown
from omniscv.errors import (
    BadReplyError,
    DeadlineError,
    SceneChangedError,
    ServerConnectionError,
    ServerRefusedError,
    SourceError,
)
from omniscv.sources.unreal.protocol import VERSION, Plugin, Reply, identify, is_repeatable, read_frame

T = TypeVar("T")
Endpoint = tuple[str, int] | str  # (host, port), or the path of a Unix socket

TIMEOUT_S = 15.0
PATIENCE_S = 10.0
RETRIES = 5
"""Defaults of :class:`Connection`. A silent server is given up after at most the sum of both times, 25 s."""
RETRIED = (ServerConnectionError, DeadlineError, BadReplyError)
"""Faults after which a request is sent again over a new connection."""
_NO_TOKEN = "error Authentication required"
_NEEDS_TOKEN = "expected a server without authentication; empty AuthToken in unrealcv.ini"
_UNREACHABLE = (ConnectionRefusedError, FileNotFoundError, socket.gaierror)

_FIRST_IDS = 90_000_000  # ids have up to 8 digits, so a connection has at least ten million of them
_CLICK = b"clicked"  # sent by plugin 0.3.10 at a mouse click in the game's window; belongs to no request


_UNUSED = ("unrealcv.launcher", "unrealcv.api", "unrealcv.plus_api", "unrealcv.automation")
"""Modules that the package imports at its top, beside the client: they bring docker, requests and Pillow."""


def _client() -> Any:
    """Return the module unrealcv without its :data:`_UNUSED` modules, which take 0.15 s to import.

    Their names are imported when they are asked for.
    """
    if "unrealcv" in sys.modules:
        return import_module("unrealcv")
    for name in _UNUSED:
        sys.modules[name] = ModuleType(name)
    try:
        module = import_module("unrealcv")
    finally:
        for name in _UNUSED:
            del sys.modules[name]

    def of_unused(attribute: str) -> Any:
        if attribute.startswith("__"):
            raise AttributeError(attribute)
        for name in _UNUSED:
            if find_spec(name) is None:  # another version of the package
                continue
            found = import_module(name)
            if hasattr(found, attribute):
                return getattr(found, attribute)
        raise AttributeError(f"module 'unrealcv' has no attribute {attribute!r}")

    vars(module)["__getattr__"] = of_unused
    return module


def _check_client(module: Any) -> None:
    """Raise SourceError for a client that is older than the one that is needed, as old scripts install it."""
    if "type" in inspect.signature(module.Client.__init__).parameters:
        return
    wanted = f"unrealcv: expected client 1.3.2 or later, got an older one in {module.__file__}"
    advice = "give old scripts an environment of their own, beside 'omniscv serve' in this one"
    raise SourceError(f"{wanted}; {advice}")


unrealcv = _client()
_check_client(unrealcv)
logging.getLogger("unrealcv").setLevel(logging.CRITICAL)  # its faults are raised as errors of omniscv
unrealcv.print = lambda *_: None  # the module's own name, not the builtin


def address_of(endpoint: Endpoint) -> str:
    """Return an endpoint as users write it."""
    return endpoint if isinstance(endpoint, str) else "{}:{}".format(*endpoint)


class Client(unrealcv.Client):  # type: ignore[name-defined, misc]
    """One connection to a server.

    After a fault, replies may belong to other requests, so the first fault breaks the client for good. Ids
    start at random, because servers may send replies for an earlier client to the next one. ``timeout_s`` is
    for connecting with the greeting, for sending a request, and for each reply; ``until`` returns the latest
    deadline, by the monotonic clock.

    Raises ServerConnectionError if no server is reachable; from ConnectionRefusedError if none listens.
    """

    def __init__(
        self, endpoint: Endpoint, timeout_s: float, until: Callable[[], float] = lambda: math.inf
    ) -> None:
        super().__init__(endpoint, "unix" if isinstance(endpoint, str) else "inet")
        self._timeout_s = timeout_s
        self._until = until
        self.broken = False
        self._allowed_s = timeout_s  # of the wait under way: the timeout, or what is left until the deadline
        self.send_message_id = self.recv_message_id = secrets.randbelow(_FIRST_IDS)
        try:
            self._greet()
        except (OSError, BadReplyError) as cause:
            self.close()
            why = f"{cause}; is the game running?"
            if isinstance(cause, TimeoutError):
                why = f"no greeting within {self._allowed_s:.3g} s; is another client connected?"
            address = address_of(endpoint)
            raise ServerConnectionError(f"No UnrealCV server reachable at {address}: {why}") from cause

    def stream(self, commands: Sequence[str]) -> Iterator[Reply]:
        """Send commands together, and yield their replies as they arrive.

        Closing the iterator early breaks the client, as does every error: replies would be those of later
        requests.
        """
        if self.broken:
            broken = "expected a working connection, but an earlier fault broke it"
            raise ServerConnectionError(f"{address_of(self.endpoint)}: {broken}")
        received = 0
        try:
            for command in commands:
                self.sock.settimeout(self._deadline() - time.monotonic())
                if not self.send(b"%d:%b" % (self.send_message_id, command.encode())):
                    raise ConnectionError("a request could not be sent")
                self.send_message_id += 1
            if commands:
                self.recv_num_q.put(-len(commands))
            for _ in commands:
                reply = self.recv_data_q.get()  # returns, because every receive() has a deadline
                if isinstance(reply, Exception):
                    raise reply
                if reply is None:
                    raise BadReplyError("a message without an id")
                received += 1
                yield reply
        except (OSError, AssertionError, ValueError, SourceError) as cause:
            raise self._fault(commands[received], cause) from cause
        finally:
            if received < len(commands):
                self.close()

    def close(self) -> None:
        self.broken = True
        if self.sock is not None:
            with contextlib.suppress(OSError):  # the server may have disconnected first
                self.sock.shutdown(socket.SHUT_RDWR)  # wakes the receiving thread
        self.disconnect()

    def receive(self) -> bytes:
        """Return the payload of the next reply; called by the receiving thread."""
        deadline = self._deadline()
        payload = self._frame(deadline)
        while payload == _CLICK:
            payload = self._frame(deadline)
        return payload

    def _greet(self) -> None:
        deadline = self._deadline()
        if isinstance(self.endpoint, str):
            self.sock = socket.socket(socket.AF_UNIX)  # type: ignore[attr-defined,unused-ignore]
            self.sock.settimeout(self._allowed_s)
            self.sock.connect(self.endpoint)
        else:
            self.sock = socket.create_connection(self.endpoint, timeout=self._allowed_s)
            self.sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if not (greeting := self._frame(deadline)).startswith(b"connected"):
            raise BadReplyError(f"expected 'connected to ...', got {shown(greeting[:80])}")
        self.t = threading.Thread(target=self._receive_until_broken, name="unrealcv", daemon=True)
        self.t.start()

    def _receive_until_broken(self) -> None:
        try:
            self.receive_loop_queue()
        except (OSError, BadReplyError, AssertionError, ValueError) as fault:
            self.recv_data_q.put(fault)

    def _frame(self, deadline: float) -> bytes:
        connection = self.sock
        if connection is None:
            raise ConnectionError("the connection is closed")

        def receive(most: int) -> bytes:
            if (remaining := deadline - time.monotonic()) <= 0:
                raise TimeoutError("timed out")
            connection.settimeout(remaining)
            return bytes(connection.recv(most))

        return read_frame(receive)

    def _deadline(self) -> float:
        now = time.monotonic()
        self._allowed_s = max(1e-3, min(self._timeout_s, self._until() - now))
        return now + self._allowed_s

    def _fault(self, command: str, cause: Exception) -> SourceError:
        expected = f"{address_of(self.endpoint)}: expected an answer to {shown(command)}"
        if isinstance(cause, TimeoutError):
            return DeadlineError(f"{expected} within {self._allowed_s:.3g} s, got none, or not all of it")
        if isinstance(cause, OSError):
            return ServerConnectionError(f"{expected}, but the connection broke: {cause}")
        return BadReplyError(f"{expected}, got a reply that does not belong to it: {str(cause)[:100]}")


class Connection:
    """A connection that is opened at its first use, and opened anew after every fault.

    Args:
        timeout_s: how long connecting, and each reply, may take.
        patience_s: for how long after a fault to connect and send again, until there is a reply.
        retries: how often to try again, with pauses that grow from 0.1 s to 2 s.

    Attributes:
        endpoint, address: of the server; as users write it.
        scene: by command, the replies that name the project and the level, or all objects where no command
            names the level. Every new connection must give the same, or SceneChangedError is raised.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        timeout_s: float = TIMEOUT_S,
        patience_s: float = PATIENCE_S,
        retries: int = RETRIES,
    ) -> None:
        self.endpoint = endpoint
        self.address = address_of(endpoint)
        self._timeout_s = arguments.number("timeout_s", timeout_s, above=0)
        self._patience_s = arguments.number("patience_s", patience_s, above=0)
        self._retries = arguments.whole_number("retries", retries, least=0)
        self._until = math.inf  # when the patience ends, by the monotonic clock
        self.client: Client | None = None  # may be broken
        self.scene: dict[str, str] = {}

    def connected(self) -> Client:
        """Return the current client, or a new one after a fault; SceneChangedError for another scene."""
        if self.client is None or self.client.broken:
            self.client = self._unix_client() or self._connect(self.endpoint)
            if self.scene:
                self.compare_scene(self.client.stream(list(self.scene)))
        return self.client

    @cached_property
    def plugin(self) -> Plugin:
        """The server's plugin, asked for at the first use."""
        return identify(self)

    def supports(self, template: str) -> bool:
        """Return whether the server has a command, such as ``vget /level/name``."""
        return template in self.plugin.templates

    def check_scene(self) -> None:
        """Raise SceneChangedError if the server shows another scene than before."""
        self.compare_scene(self.texts(list(self.scene)))

    def compare_scene(self, replies: Iterable[Reply]) -> None:
        """Raise SceneChangedError if these replies name another scene than before."""
        known = list(self.scene.values())
        actual = list(replies)
        if actual != known:
            self.close()  # so that it is compared again before anything else is sent
            before = " with ".join(map(shown, known))
            now = " with ".join(map(shown, actual))
            expected = f"{self.address}: expected the scene {before}, got {now}"
            raise SceneChangedError(f"{expected}; open the source again")

    @contextlib.contextmanager
    def attempts(self) -> Iterator[Callable[[SourceError | None], None]]:
        """Yield a function to call after each attempt of an operation, with its fault or None for progress.

        After a fault of ``RETRIED`` it disconnects and pauses; after too many, or if no server has ever been
        reached, it raises the fault.
        """
        outer = self._until
        failures = 0

        def attempted(fault: SourceError | None) -> None:
            nonlocal failures
            if fault is None:
                self._until = outer
                failures = 0
                return
            if self.client is None and isinstance(fault.__cause__, _UNREACHABLE):
                raise fault
            self.close()
            now = time.monotonic()
            failures = failures + 1
            if failures == 1:
                self._until = min(outer, now + self._patience_s)
            pause = min(2.0, 0.1 * 2 ** (failures - 1))
            if failures > self._retries or now + pause >= self._until:
                raise type(fault)(f"{fault}; gave up after {failures} attempts") from fault
            time.sleep(pause)

        try:
            yield attempted
        finally:
            self._until = outer

    def read(self, commands: Sequence[str], reader: Callable[[str, Reply], T]) -> list[T]:
        """Send ``commands`` together, and return ``reader(command, reply)`` for each.

        After a fault, or if ``reader`` raises BadReplyError, the commands without a result are sent again.
        """
        results: list[T] = []
        with self.attempts() as attempted:
            while len(results) < len(commands):
                before = len(results)
                try:
                    for reply in self.connected().stream(commands[before:]):
                        if isinstance(reply, str) and reply.startswith(_NO_TOKEN):
                            raise ServerRefusedError(f"{self.address}: {_NEEDS_TOKEN}, got {shown(reply)}")
                        results.append(reader(commands[len(results)], reply))
                except RETRIED as fault:
                    if len(results) > before:
                        attempted(None)
                    attempted(fault)
        return results

    def texts(self, commands: Sequence[str]) -> list[str]:
        """Return the replies to repeatable commands, which must be text; errors of the server included."""

        def text(command: str, reply: Reply) -> str:
            """Return the ``reply`` to a ``command``; BadReplyError if it is no text."""
            if isinstance(reply, str):
                return reply
            expected = f"expected text from {shown(command)}"
            raise BadReplyError(f"{self.address}: {expected}, got {shown(reply[:80])}")

        return self.read(commands, text)

    def ask(self, commands: Sequence[str]) -> list[str]:
        """Return the replies to repeatable commands; ServerRefusedError if one is an error."""
        replies = self.texts(commands)
        for command, reply in zip(commands, replies, strict=True):
            self._check_accepted(command, reply)
        return replies

    def text(self, command: str) -> str:
        """Return the reply to a repeatable command; ServerRefusedError if it is an error."""
        return self.ask([command])[0]

    def set(self, commands: Sequence[str]) -> None:
        """Send commands that set absolute values; ServerRefusedError for a reply other than ok."""
        for command, reply in zip(commands, self.texts(commands), strict=True):
            if reply != "ok":
                expected = f"expected a server that answers {shown(command)} with ok"
                raise ServerRefusedError(f"{self.address}: {expected}, got {shown(reply)}")

    def reply(self, command: str) -> Reply:
        """Return the reply to any command; after a fault it is sent again only if it is repeatable."""
        if is_repeatable(command):
            (reply,) = self.read([command], lambda _, reply: reply)
        else:
            self.text(VERSION)  # if the connection has broken meanwhile, it is opened anew before the command
            try:
                (reply,) = self.connected().stream([command])
            except RETRIED as fault:
                message = f"{fault}; it may have been carried out, so it was not sent again"
                raise type(fault)(message) from fault
        self._check_accepted(command, reply)
        return reply

    def close(self) -> None:
        if self.client is not None:
            self.client.close()

    def _check_accepted(self, command: str, reply: Reply) -> None:
        if isinstance(reply, str) and reply.startswith("error"):
            raise ServerRefusedError(f"{self.address}: {shown(command)} was refused: {shown(reply)}")

    def _unix_client(self) -> Client | None:
        # Plugin 1.0 on Linux leaves TCP for its Unix socket when its first client disconnects. A TCP
        # connection then gets no greeting (protocol reference, section 1.2).
        if isinstance(self.endpoint, str) or self.endpoint[0] not in ("localhost", "127.0.0.1", "::1"):
            return None
        # The path is fixed by the plugin. Any user may create a socket there.
        path = f"/tmp/unrealcv_{self.endpoint[1]}.socket"
        if _is_own_socket(path):
            with contextlib.suppress(ServerConnectionError):  # a game that crashed leaves its socket behind
                return self._connect(path)
        return None

    def _connect(self, endpoint: Endpoint) -> Client:
        return Client(endpoint, self._timeout_s, lambda: self._until)


def _is_own_socket(path: str) -> bool:
    try:
        status = os.lstat(path)
    except OSError:
        return False
    return sys.platform != "win32" and stat.S_ISSOCK(status.st_mode) and status.st_uid == os.geteuid()
