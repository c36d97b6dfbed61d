"""Object stores on loopback and in memory, and ones that fail."""

import errno
import hashlib
import os
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, ClassVar

import fsspec
import pytest
from fsspec.implementations.memory import MemoryFileSystem

BUCKET = "rooms"


Fault = Callable[[int], str]
"""Returns the fault of a request by its number: a method of :class:`Failing`, or an empty text for none."""


class Failing:
    """A web application, some requests of which fail.

    Attributes:
        fault: of each request; may be replaced.
        latency_s: of each answer.
        most_waiting: requests that waited for one at a time.
        ended: set when requests need no longer wait.
    """

    def __init__(self, served: Any, fault: Fault, latency_s: float = 0.0) -> None:
        self.served = served
        self.fault = fault
        self.latency_s = latency_s
        self.requests = 0
        self.counting = threading.Lock()
        self.ended = threading.Event()
        self.waiting = self.most_waiting = 0

    def __call__(self, environ: Any, start_response: Any) -> Any:
        with self.counting:
            self.requests = self.requests + 1
            self.waiting = self.waiting + 1
            number = self.requests
            self.most_waiting = max(self.waiting, self.most_waiting)
        self.ended.wait(self.latency_s)
        with self.counting:
            self.waiting -= 1
        fault = self.fault(number)
        return (getattr(self, fault) if fault else self.served)(environ, start_response)

    def refused(self, environ: Any, start_response: Any, status: str = "503 Service Unavailable") -> Any:
        """Refuse it, unread."""
        environ["wsgi.input"].read(int(environ.get("CONTENT_LENGTH") or 0))
        start_response(status, [("Content-Length", "0")])
        return []

    def broken(self, environ: Any, start_response: Any) -> Any:
        """Answer with an internal error."""
        return self.refused(environ, start_response, "500 Internal Server Error")

    def done(self, environ: Any, start_response: Any) -> Any:
        """Do it, and say that it failed."""
        b"".join(self.served(environ, lambda *_: None))
        start_response("503 Service Unavailable", [("Content-Length", "0")])
        return []

    def late(self, environ: Any, start_response: Any) -> Any:
        """Answer after 2 s."""
        self.ended.wait(2.0)
        return self.served(environ, start_response)

    def silent(self, environ: Any, start_response: Any) -> Any:
        """Never answer."""
        self.ended.wait()
        return self.refused(environ, start_response)

    def cut(self, environ: Any, start_response: Any) -> Any:
        """Break off in the middle of the body."""
        body, status, headers = self._answer(environ)
        start_response(status, headers)
        return [body[: len(body) // 2]]

    def short(self, environ: Any, start_response: Any) -> Any:
        """Send half of an object as if it were all."""
        body, status, headers = self._answer(environ)
        if environ["REQUEST_METHOD"] == "GET" and not environ.get("QUERY_STRING"):
            body = body[: len(body) // 2]
            kept = [row for row in headers if not re.match("content-length|x-amz-checksum", row[0], re.I)]
            headers = [*kept, ("Content-Length", str(len(body)))]
        start_response(status, headers)
        return [body]

    def endless(self, environ: Any, start_response: Any) -> Any:
        """Send an object without an end."""
        if environ["REQUEST_METHOD"] != "GET" or environ.get("QUERY_STRING"):
            return self.served(environ, start_response)
        start_response("200 OK", [])
        return iter(lambda: bytes(1 << 16), None)

    def expired(self, environ: Any, start_response: Any) -> Any:
        """Answer as Amazon does to a token of yesterday."""
        body = b"" if environ["REQUEST_METHOD"] == "HEAD" else b"<Error><Code>ExpiredToken</Code></Error>"
        start_response("400 Bad Request", [("Content-Length", str(len(body)))])
        return [body]

    def read_only(self, environ: Any, start_response: Any) -> Any:
        """Answer as Amazon does to a key that may read and list, but not write."""
        if environ["REQUEST_METHOD"] not in ("PUT", "POST"):
            return self.served(environ, start_response)
        environ["wsgi.input"].read(int(environ.get("CONTENT_LENGTH") or 0))
        body = b"<Error><Code>AccessDenied</Code><Message>Access Denied</Message></Error>"
        start_response("403 Forbidden", [("Content-Length", str(len(body)))])
        return [body]

    def _answer(self, environ: Any) -> tuple[bytes, str, list[tuple[str, str]]]:
        answer: list[Any] = []
        body = b"".join(self.served(environ, lambda status, headers, *_: answer.extend((status, headers))))
        return body, answer[0], list(answer[1])


def every_nth(every: int) -> Fault:
    """One request in ``every`` fails before it is served, or after it, in turn; none if it is 0."""
    return lambda number: "" if not every or number % every else ("refused", "done")[number // every % 2]


def twelve_percent(number: int) -> str:
    """A fault of 12 requests in 100, the same ones each time: 5 errors, 3 after the work, 2 stalls, 2 cut."""
    return {7: "broken", 23: "broken", 41: "broken", 62: "broken", 88: "broken", 15: "done", 50: "done",
            77: "done", 33: "late", 96: "late", 28: "cut", 70: "cut"}.get(number % 100, "")  # fmt: skip


@contextmanager
def s3_server(every: int = 0) -> Iterator[Any]:
    """Serve an empty bucket on loopback; yield a boto3 client. Child processes find it too.

    One request in ``every`` fails.
    """
    with s3_application(every_nth(every)) as (_, client):
        yield client


@contextmanager
def s3_application(fault: Fault, latency_s: float = 0.0) -> Iterator[tuple[Failing, Any]]:
    """As :func:`s3_server`, with any faults; yield the application, too."""
    import boto3  # here: each worker of pytest imports all test files
    from moto.server import DomainDispatcherApplication, MotoRequestHandler, create_backend_app
    from werkzeug.serving import make_server

    application = Failing(DomainDispatcherApplication(create_backend_app), lambda number: "")
    server = make_server("127.0.0.1", 0, application, threaded=True, request_handler=MotoRequestHandler)
    serving = threading.Thread(target=server.serve_forever, daemon=True)
    serving.start()
    with pytest.MonkeyPatch.context() as patch:
        for key, value in {
            "AWS_ENDPOINT_URL": f"http://127.0.0.1:{server.server_port}",
            "AWS_ACCESS_KEY_ID": "testing",
            "AWS_SECRET_ACCESS_KEY": "testing",
            "AWS_DEFAULT_REGION": "us-east-1",
            "AWS_EC2_METADATA_DISABLED": "true",
        }.items():
            patch.setenv(key, value)
        client = boto3.client("s3")
        client.create_bucket(Bucket=BUCKET)
        fsspec.get_filesystem_class("s3").clear_instance_cache()
        application.fault = fault
        application.latency_s = latency_s
        yield application, client
        application.ended.set()
        client.close()
        fsspec.get_filesystem_class("s3").clear_instance_cache()
    server.shutdown()
    serving.join()
    server.server_close()


def names_at(where: str) -> list[str]:
    """The names of all files below a path or URL, hidden ones too."""
    fs, root = fsspec.core.url_to_fs(where)
    fs.invalidate_cache()
    return [path.removeprefix(root).lstrip("/") for path in fs.find(root)]


def tree_at(where: str) -> dict[str, str]:
    """:func:`support.datasets.tree` of a path or URL, by another reader."""
    fs, root = fsspec.core.url_to_fs(where)
    contents = fs.cat([f"{root}/{name}" for name in sorted(names_at(where))]).items()
    return {path.removeprefix(root).lstrip("/"): hashlib.md5(data).hexdigest() for path, data in contents}


def _at_times(name: str) -> Any:
    """Return a method of :class:`FailingStore` that does what the store in memory does, or fails."""
    operation = getattr(MemoryFileSystem, name)
    return lambda self, *values, **options: self._served(operation, self, *values, **options)


class FailingStore(MemoryFileSystem):
    """A store in memory of its own, each ``every``-th request of which fails before or after it is served."""

    protocol = "failing"
    store: ClassVar[dict[str, Any]] = {}
    pseudo_dirs: ClassVar[list[str]] = [""]
    every: ClassVar[int] = 0
    requests: ClassVar[int] = 0
    capacity: ClassVar[int | None] = None
    counting: ClassVar[threading.Lock] = threading.Lock()
    info, find, cat_file, get_file = map(_at_times, ("info", "find", "cat_file", "get_file"))

    def _served(self, operation: Any, *values: Any, **options: Any) -> Any:
        with self.counting:
            type(self).requests += 1
            number = self.requests
        fails = self.every and number % self.every == 0
        if fails and number // self.every % 2:
            raise ConnectionResetError(errno.ECONNRESET, "reset before it was served")
        result = operation(*values, **options)
        if fails:
            raise ConnectionResetError(errno.ECONNRESET, "reset after it was served")
        return result

    def pipe_file(self, path: str, value: bytes, *values: Any, **options: Any) -> Any:
        self._check_space(len(value))
        return self._served(super().pipe_file, path, value, *values, **options)

    def put_file(self, lpath: str, rpath: str, *values: Any, **options: Any) -> Any:
        self._check_space(os.path.getsize(lpath))
        return self._served(super().put_file, lpath, rpath, *values, **options)

    def _check_space(self, size: int) -> None:
        held = sum(each.size for each in self.store.values())
        if self.capacity is not None and held + size > self.capacity:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@contextmanager
def failing_store(every: int = 0, capacity: int | None = None) -> Iterator[type[FailingStore]]:
    """An empty store ``failing://`` that fails one request in ``every``, or holds ``capacity`` bytes."""
    fsspec.register_implementation("failing", FailingStore, clobber=True)
    FailingStore.store.clear()
    FailingStore.every = every
    FailingStore.capacity = capacity
    FailingStore.requests = 0
    yield FailingStore
    FailingStore.store.clear()
