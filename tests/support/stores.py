"""Object stores on loopback and in memory, and ones that fail."""

import errno
import hashlib
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, ClassVar

import fsspec
import pytest
from fsspec.implementations.memory import MemoryFileSystem

BUCKET = "rooms"


class Failing:
    """A web application, each ``every``-th request of which fails before or after it is served."""

    def __init__(self, served: Any, every: int) -> None:
        self.served, self.every = served, every
        self.requests, self.counting = 0, threading.Lock()

    def __call__(self, environ: Any, start_response: Any) -> Any:
        with self.counting:
            self.requests += 1
            number = self.requests
        if not self.every or number % self.every:
            return self.served(environ, start_response)
        if number // self.every % 2:
            environ["wsgi.input"].read(int(environ.get("CONTENT_LENGTH") or 0))
        else:
            b"".join(self.served(environ, lambda *_: None))
        start_response("503 Service Unavailable", [("Content-Length", "0")])
        return []


@contextmanager
def s3_server(every: int = 0) -> Iterator[Any]:
    """Serve an empty bucket on loopback; yield a boto3 client. Child processes find it too.

    One request in ``every`` fails.
    """
    import boto3  # here: each worker of pytest imports all test files
    from moto.server import DomainDispatcherApplication, MotoRequestHandler, create_backend_app
    from werkzeug.serving import make_server

    application = Failing(DomainDispatcherApplication(create_backend_app), every)
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
        yield client
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
    contents = fs.cat([f"{root}/{name}" for name in sorted(names_at(where))])
    return {
        path.removeprefix(root).lstrip("/"): hashlib.md5(content).hexdigest()
        for path, content in contents.items()
    }


class FailingStore(MemoryFileSystem):
    """A store in memory of its own, each ``every``-th request of which fails before or after it is served."""

    protocol = "failing"
    store: ClassVar[dict[str, Any]] = {}
    pseudo_dirs: ClassVar[list[str]] = [""]
    every: ClassVar[int] = 0
    requests: ClassVar[int] = 0
    capacity: ClassVar[int | None] = None
    counting: ClassVar[threading.Lock] = threading.Lock()

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

    def info(self, path: str, **options: Any) -> Any:
        return self._served(super().info, path, **options)

    def find(self, path: str, *values: Any, **options: Any) -> Any:
        return self._served(super().find, path, *values, **options)

    def cat_file(self, path: str, *values: Any, **options: Any) -> Any:
        return self._served(super().cat_file, path, *values, **options)

    def get_file(self, path: str, *values: Any, **options: Any) -> Any:
        return self._served(super().get_file, path, *values, **options)

    def pipe_file(self, path: str, value: bytes, *values: Any, **options: Any) -> Any:
        self._check_space(len(value))
        return self._served(super().pipe_file, path, value, *values, **options)

    def put_file(self, lpath: str, rpath: str, *values: Any, **options: Any) -> Any:
        self._check_space(os.path.getsize(lpath))
        return self._served(super().put_file, lpath, rpath, *values, **options)

    def _check_space(self, size: int) -> None:
        if (
            self.capacity is not None
            and sum(each.size for each in self.store.values()) + size > self.capacity
        ):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@contextmanager
def failing_store(every: int = 0, capacity: int | None = None) -> Iterator[type[FailingStore]]:
    """An empty store ``failing://`` that fails one request in ``every``, or holds ``capacity`` bytes."""
    fsspec.register_implementation("failing", FailingStore, clobber=True)
    FailingStore.store.clear()
    FailingStore.every, FailingStore.capacity, FailingStore.requests = every, capacity, 0
    yield FailingStore
    FailingStore.store.clear()
