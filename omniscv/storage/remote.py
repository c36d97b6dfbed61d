"""Object stores: folders by URL, through fsspec, and URLs that are safe to print."""

import hashlib
import os
import random
import re
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeGuard, TypeVar

from omniscv.errors import (
    ArgumentError,
    DamagedFileError,
    MissingFileError,
    OmniscvError,
    StorageError,
    StoreRefusedError,
)
from omniscv.storage import cache
from omniscv.storage.base import MOST_BYTES, Folder, checked_name, is_name
from omniscv.storage.local import NO_SPACE

T = TypeVar("T")

SCHEMES = ("file", "s3", "gs", "memory")
"""Tested stores; fsspec opens others too."""

_URL = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+)://")
_USER = re.compile(r"(?<=://)[^/@\s'\"]*@")
_QUERY = re.compile(r"(?<=\S)\?[^\s'\"]*(?==)[^\s'\"]*|#[^\s'\"]*=[^\s'\"]*")
_ATTEMPTS = 7  # of a request
_FIRST_WAIT_S = 0.05  # doubled before each further attempt
_PATIENCE_S = 20.0  # after which no attempt starts
_ANSWER_S = 8.0  # for an attempt of a request; the packages of some stores retry within it
_LISTING_S = 60.0  # for an attempt of a listing, which is many requests
_SLOWEST = 1e5  # bytes a second, for which an attempt gets more time
_SMALL = 1 << 20  # bytes of a file that is read in one request
_S3_CLIENT = {
    "connect_timeout": _ANSWER_S,
    "read_timeout": _ANSWER_S,
    "retries": {"max_attempts": 0},
    "max_pool_connections": 32,
}
"""Silence ends an attempt of S3's client; it does not try again on its own."""
_FINAL = (
    FileExistsError, FileNotFoundError, PermissionError, IsADirectoryError, NotADirectoryError, TypeError,
    ValueError, NotImplementedError, ImportError,
)  # fmt: skip
_REFUSED = "; check the store's credentials: they may be wrong, or have expired"
_FINAL_NAMES = ("NoCredentialsError", "ParamValidationError", "PartialCredentialsError", "ProfileNotFound")
"""Errors that no retry mends; those of optional packages by name."""


@dataclass(frozen=True)
class RemoteFolder(Folder):
    """A folder by its URL. S3, Google's store and ``memory://`` write files atomically."""

    url: str

    def __post_init__(self) -> None:
        stripped = self.url.rstrip("/")
        if "://" in stripped:
            object.__setattr__(self, "url", stripped)
        if without_secrets(self.url) != self.url or "?" in self.url or "#" in self.url:
            shown = re.split("[?#]", without_secrets(self.url))[0]
            advice = "set credentials and options in the store's settings"
            raise ArgumentError(f"{shown}: expected a URL without user and query; {advice}")

    def __str__(self) -> str:
        return self.url

    def __getstate__(self) -> dict[str, Any]:
        return {"url": self.url}

    @property
    def local(self) -> None:
        return

    def exists(self, name: str) -> bool:
        return self._info(name) is not None

    def names(self, prefix: str = "") -> list[str]:
        """As :meth:`Folder.names`; names that lead out of the folder are left out."""
        inner = prefix.rpartition("/")[0]

        def find(fs: Any, start: str, **limits: float) -> list[str]:
            """Return the paths below ``start`` in the file system ``fs``."""
            fs.invalidate_cache()
            return [str(path) for path in fs.find(start, **limits)]

        try:
            paths = self._retry(inner, find, _LISTING_S)
        except MissingFileError:  # some stores have folders
            return []
        root = self._opened("")[1].rstrip("/")
        names = []
        for path in paths:
            name = path[len(root) :].lstrip("/")
            is_hidden = "/." in f"/{name}"
            if is_name(name) and not is_hidden and name.startswith(prefix):
                names.append(name)
        return sorted(names)

    def read(self, name: str, most: int = MOST_BYTES) -> bytes:
        """As :meth:`Folder.read`: the file ``name``, of at most ``most`` bytes; a small one in one
        request."""
        with TemporaryDirectory(prefix="omniscv-") as folder:
            path = Path(folder) / "file"
            try:
                self._download(name, path, min(most, _SMALL))  # mostly enough: one request
            except DamagedFileError:
                size = _size_in(self._info(name) or {})
                if size is None or size > most:
                    expected = f"expected at most {most} bytes, got {size}"
                    raise DamagedFileError(f"{self}/{name}: {expected}") from None
                self._copy(name, path, size)
            return path.read_bytes()

    def put(self, name: str, content: bytes | Path, first: bool = False) -> bool:
        """As :meth:`Folder.put`: ``content`` goes to ``name`` in one request, or in parts that the store
        joins at the end; with ``first`` an existing file stays."""
        if first and self.exists(name):
            return False
        options = {"mode": "create"} if first and self._writes_once() else {}
        size = len(content) if isinstance(content, bytes) else content.stat().st_size
        attempts = 0

        def write(fs: Any, path: str, **limits: float) -> None:
            """Write the content to ``path`` in the file system ``fs``."""
            nonlocal attempts
            attempts += 1
            if isinstance(content, bytes):
                fs.pipe_file(path, content, **options, **limits)
            else:
                fs.put_file(str(content), path, **options, **limits)

        try:
            self._retry(checked_name(name), write, _ANSWER_S + size / _SLOWEST)
        except MissingFileError as cause:
            wanted = "expected a bucket or folder to write to, it is missing"
            raise StoreRefusedError(f"{self}: {wanted}") from cause
        except FileExistsError:
            # The reply to an attempt that succeeded may have been lost: then the bytes are equal.
            return attempts > 1 and self._holds(name, content)
        return not first or bool(options) or self._holds(name, content)

    def remove(self, name: str) -> None:
        if self.exists(name):
            with suppress(MissingFileError):
                self._retry(name, lambda fs, path, **limits: fs.rm_file(path, **limits))

    def fetch(self, name: str, checksum: str = "", size: int = sys.maxsize) -> Path:
        """Return a copy of ``name`` in the local cache, compared at every call with ``checksum``, of at most
        ``size`` bytes; see :meth:`Folder.fetch`."""
        where = f"{self}/{checked_name(name)}"
        if checksum:
            download = partial(self._download, name, most=size)
            return cache.copy_of(checksum, name, download, checksum=checksum, shown=where)
        info = self._info(name)
        if info is None:
            raise MissingFileError(f"{where}: expected a file, it is missing")
        version = repr(sorted((str(key), str(value)) for key, value in info.items()))
        key = hashlib.sha256(f"{where}\n{version}".encode()).hexdigest()
        nbytes = _size_in(info)
        return cache.copy_of(key, name, lambda path: self._copy(name, path, nbytes), size=nbytes)

    def copy(self, name: str, path: Path, most: int | None = None) -> None:
        """As :meth:`Folder.copy`: from ``name`` to ``path``, at most ``most`` bytes."""
        if most is None:
            self._copy(name, path, _size_in(self._info(name) or {}))
        else:
            self._download(name, path, most)

    def _copy(self, name: str, path: Path, size: int | None) -> None:
        """Write the bytes of a file to a local path; DamagedFileError if they are not as many as ``size``."""
        self._download(name, path, sys.maxsize if size is None else size)
        nbytes = path.stat().st_size
        if size is not None and nbytes != size:
            raise DamagedFileError(f"{self}/{name}: expected {size} bytes, got {nbytes}")

    def _download(self, name: str, path: Path, most: int) -> None:
        """Write the bytes of a file, ``most`` at most, to a local path."""
        seconds = _ANSWER_S + min(most, MOST_BYTES) / _SLOWEST

        def download(fs: Any, stored: str, **limits: float) -> None:
            """Write ``stored`` of the file system ``fs`` to the path."""
            fs.get_file(stored, str(path), callback=_bound(f"{self}/{name}", most), **limits)

        self._retry(checked_name(name), download, seconds)

    def below(self, name: str) -> "RemoteFolder":
        return RemoteFolder(f"{self.url.rstrip('/')}/{checked_name(name)}")

    def _opened(self, name: str) -> tuple[Any, str]:
        """Return the file system, and the path of a name in it."""
        fs, root, process = self.__dict__.get("_held", (None, "", 0))
        if process != os.getpid():  # a file system does not survive a fork
            fs, root = self._file_system()
            self.__dict__["_held"] = fs, root, os.getpid()
        return fs, f"{root.rstrip('/')}/{checked_name(name)}" if name else root

    def _file_system(self) -> tuple[Any, str]:
        """Return the file system of the URL, and its path there; ArgumentError without its packages."""
        try:
            from fsspec.config import conf
            from fsspec.core import url_to_fs

            if scheme_of(self.url) == "s3":
                configured = conf.get("s3", {}).get("config_kwargs", {})
                fs, root = url_to_fs(self.url, config_kwargs=_S3_CLIENT | configured)
                fs.retries = 1
            else:
                fs, root = url_to_fs(self.url)
        except ImportError as cause:
            wanted = f"expected the packages of this store ({without_secrets(cause)})"
            raise ArgumentError(f"{self}: {wanted}; install omniscv[cloud], and gcsfs for gs://") from cause
        except ValueError as cause:
            reason = without_secrets(cause)
            raise ArgumentError(f"{self}: expected the URL of a store, got: {reason}") from cause
        return fs, str(root)

    def _info(self, name: str) -> dict[str, Any] | None:
        """Return what the store says about a file, None if it does not exist.

        The ``exists`` of fsspec returns False for any error.
        """

        def read(fs: Any, path: str, **limits: float) -> dict[str, Any]:
            """Return what the file system ``fs`` says about ``path``."""
            fs.invalidate_cache()
            return dict(fs.info(path, **limits))

        try:
            info = self._retry(checked_name(name), read)
        except MissingFileError:
            return None
        return info if info.get("type") == "file" else None

    def _holds(self, name: str, content: bytes | Path) -> bool:
        """Return whether a file has these bytes."""
        wanted = content if isinstance(content, bytes) else content.read_bytes()
        try:
            return self.read(name, len(wanted)) == wanted
        except DamagedFileError:
            return False

    def _writes_once(self) -> bool:
        """Return whether the store can refuse to replace a file, as S3 does by ``If-None-Match``."""
        protocol = self._opened("")[0].protocol
        names = (protocol,) if isinstance(protocol, str) else protocol
        return any(name in ("s3", "gs", "memory") for name in names)

    def _retry(self, name: str, action: Callable[..., T], seconds: float = _ANSWER_S) -> T:
        """Return the result of an action on the file system, a path in it, and options that bound the time of
        a request; retry with exponential backoff where that may help. FileExistsError passes unchanged."""
        where = f"{self}/{name}" if name else str(self)
        fs, path = self._opened(name)
        limits = {"timeout": seconds} if getattr(fs, "async_impl", False) else {}
        patient_until = time.monotonic() + _PATIENCE_S
        for attempt in range(_ATTEMPTS):
            try:
                return action(fs, path, **limits)
            except (OmniscvError, FileExistsError):
                raise
            except FileNotFoundError as cause:
                raise MissingFileError(f"{where}: expected a file, it is missing") from cause
            except Exception as cause:  # each store's library has its own
                number = getattr(cause, "errno", None)
                final = isinstance(cause, _FINAL) or type(cause).__name__ in _FINAL_NAMES
                late = attempt == _ATTEMPTS - 1 or time.monotonic() + _ANSWER_S > patient_until
                if final or number in NO_SPACE or late:
                    raise _failure(where, cause, seconds, is_final=final) from cause
            time.sleep(_FIRST_WAIT_S * 2**attempt * random.uniform(0.5, 1.5))
        raise AssertionError("the last attempt returns or raises")


def _size_in(info: Mapping[str, Any]) -> int | None:
    """Return the size that a store says, None if it says none."""
    size = info.get("size")
    return size if isinstance(size, int) and size >= 0 else None


def _bound(where: str, most: int) -> Any:
    """Return a callback of downloads that raises DamagedFileError when more than ``most`` bytes have come."""
    from fsspec.callbacks import Callback

    class Bound(Callback):  # type: ignore[misc] # fsspec is imported without its types
        def relative_update(self, inc: int = 1) -> None:
            super().relative_update(inc)
            if self.value > most:
                raise DamagedFileError(f"{where}: expected at most {most} bytes, got more")

    return Bound()


def _failure(where: str, cause: Exception, seconds: float, *, is_final: bool) -> StorageError:
    """Return the error of a request to ``where`` that failed, or was not answered within ``seconds``."""
    reason = f"{getattr(cause, 'strerror', None) or cause or type(cause).__name__}"
    number = getattr(cause, "errno", None)
    advice = ""
    if isinstance(cause, TimeoutError):
        reason = f"no answer in {seconds:.0f} s"
    if number in NO_SPACE:
        advice = "; free space there, and run again"
    # Amazon answers 400 to an expired token, without a reason where it sends no body.
    if isinstance(cause, PermissionError) or reason == "Bad Request" or "credentials" in reason.lower():
        advice = _REFUSED
    error = StoreRefusedError if is_final else StorageError
    return error(f"{where}: expected to read or write it, got: {without_secrets(reason)}{advice}")


def is_url(text: object) -> TypeGuard[str]:
    """Return whether a value is the text of a URL, ``scheme://...``; False for a Path."""
    return isinstance(text, str) and _URL.match(text) is not None


def was_url(path: object) -> bool:
    """Return whether a Path was made from a URL, which loses a slash: ``s3:/bucket/rooms``."""
    if not isinstance(path, Path) or not path.parts:
        return False
    scheme, colon, more = path.parts[0].partition(":")
    return scheme in SCHEMES and bool(colon) and not more


def scheme_of(url: str) -> str:
    """Return the scheme of a URL, an empty text for a path."""
    match = _URL.match(url)
    return match[1].lower() if match else ""


def without_secrets(text: object) -> str:
    """Return a text with user, password and query removed from its URLs: these may be credentials."""
    return _QUERY.sub("", _USER.sub("", str(text)))
