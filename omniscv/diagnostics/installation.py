"""Checks of this installation: packages, system libraries, writable folders, ports, disk space.

Packages are imported only when they are checked, so that this runs where they are missing.
"""

import importlib
import platform
import shutil
import socket
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

from omniscv.diagnostics import Finding
from omniscv.errors import OmniscvError

LIBRARIES = ("cv2", "OpenImageIO", "scipy.spatial", "PIL.Image", "unrealcv")
"""Modules with compiled parts, or with system libraries behind them."""

LEAST_BYTES = 100 << 20
ENOUGH_BYTES = 2 << 30
"""Free space of a disk: below the first nothing useful can be captured, below the second little."""

_EXTRAS = (
    "compile",
    "charts",
    "evaluate",
    "video",
    "fast",
    "torch",
    "mujoco",
    "ros",
    "rerun",
    "cloud",
    "cluster",
)
_SLIM = "slim images lack it: apt-get install libgl1 libglib2.0-0, or pip install opencv-python-headless"
_OF_SYSTEM = ("libGL", "libgthread", "libglib")
_AGAIN = "pip install --upgrade omniscv, in an environment of its own"


def examine_installation(folder: Path | None = None, port: int = 9000) -> list[Finding]:
    """Return findings, the most important first.

    Args:
        folder: where files are to be written; the working folder if not given.
        port: that the mock server listens on if no other is given.
    """
    folder = Path.cwd() if folder is None else folder
    temporary = Path(tempfile.gettempdir())
    return [
        Finding("Python", f"{platform.python_version()}, {platform.machine()}, {sys.prefix}"),
        *_packages(),
        *map(_library, LIBRARIES),
        _writable("working folder", folder),
        _writable("temporary folder", temporary),
        _attempt("kernels", _kernels, "pip install 'omniscv[compile]'"),
        *_ports(port),
        *map(_space, dict.fromkeys((folder, temporary))),
    ]


def _packages() -> Iterator[Finding]:
    """Compare the packages that omniscv needs with those that are installed."""
    from packaging.requirements import Requirement

    try:
        requirements = [Requirement(text) for text in metadata.requires("omniscv") or ()]
        yield Finding("omniscv", metadata.version("omniscv"))
    except metadata.PackageNotFoundError:
        yield Finding("omniscv", "not installed", "bad", "pip install . in its folder, or ./scripts/demo")
        return
    lacking: dict[str, list[str]] = {extra: [] for extra in _EXTRAS}
    for needed in requirements:
        extra = _extra_of(needed)
        try:
            version = metadata.version(needed.name)
            sound = needed.specifier.contains(version, prereleases=True)
        except metadata.PackageNotFoundError:
            version = "missing"
            sound = False
        if extra is None:
            value = version if sound else f"{version}, needs {needed.specifier}"
            yield Finding.unless(sound, needed.name, value, "bad", _AGAIN)
        elif extra in lacking and not sound:
            lacking[extra].append(needed.name)
    for extra, names in lacking.items():
        lacks = f"optional, lacks {', '.join(names)}: pip install 'omniscv[{extra}]'"
        yield Finding(f"extra {extra}", lacks if names else "installed")


def _extra_of(needed: Any) -> str | None:
    """Return the extra that a requirement is of; None for one that all installations have."""
    if needed.marker is None:
        return None
    if needed.marker.evaluate({"extra": ""}):
        return None
    for extra in metadata.metadata("omniscv").get_all("Provides-Extra", []):
        if needed.marker.evaluate({"extra": extra}):
            return str(extra)
    return "elsewhere"


def _library(module: str) -> Finding:
    """Return whether a module can be imported; missing system libraries show only then."""

    def load() -> str:
        importlib.import_module(module)
        return "loads"

    return _attempt(f"import {module}", load, _AGAIN)


def _attempt(name: str, check: Callable[[], str], remedy: str) -> Finding:
    """Return the result of a check as a finding, which is bad if the check raises."""
    try:
        return Finding(name, check())
    except (ImportError, OSError, RuntimeError, OmniscvError) as cause:
        lacks = any(library in str(cause) for library in _OF_SYSTEM)
        return Finding(name, f"fails: {cause}", "bad", _SLIM if lacks else remedy)


def _writable(name: str, folder: Path) -> Finding:
    def check() -> str:
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(b"omniscv")
        return f"{folder} can be written to"

    return _attempt(name, check, "choose another folder, or give yourself the right to write there")


def _kernels() -> str:
    """Return which libraries have the kernels, after a first image has run with them."""
    from omniscv import cameras, open_source, render
    from omniscv.compiled import load_library
    from omniscv.geometry import Pose

    started = time.monotonic()
    pose = Pose.from_angles((0, 0, 1.5))
    modes = ("lit", "object_mask", "depth", "normals")
    with open_source("mock://four-wall") as source:
        for name in ("fisheye-equidistant", "noncentral-panorama"):
            render(cameras.model(name).example(32), pose, source, modes, face_size=16)
    seconds = time.monotonic() - started
    paths = []
    for package in ("omniscv", "mock_server"):
        library = load_library(package)
        if library is not None:
            paths.append(str(library.path))
    return f"{' and '.join(paths) or 'compiled by numba'}; two images in {seconds:.1f} s"


def _ports(port: int) -> Iterator[Finding]:
    """Report whether any port can be listened on, and whether the default port of the mock server is free."""

    def listen(number: int, result: str) -> str:
        """Return ``result`` if the port ``number`` can be listened on; OSError if not."""
        with socket.socket() as listener:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind(("127.0.0.1", number))
            return result

    remedy = "allow this process to listen on the loopback interface"
    yield _attempt("ports of 127.0.0.1", lambda: listen(0, "can be listened on"), remedy)
    try:
        yield Finding(f"port {port}", listen(port, "free"))
    except OSError:  # any other port serves as well
        value = "in use: by an UnrealCV server, or by another program"
        remedy = "omniscv serve --port 0"
        yield Finding(f"port {port}", value, "warning", f"to serve there, end it, or {remedy}")


def _space(folder: Path) -> Finding:
    free = shutil.disk_usage(folder).free
    value = f"{free / 1e9:.3g} GB free at {folder}"
    remedy = "free some space: a recording of one viewpoint takes 10 to 100 MB, a dataset gigabytes"
    verdict: Literal["warning", "bad"] = "bad" if free < LEAST_BYTES else "warning"
    return Finding.unless(free >= ENOUGH_BYTES, "disk", value, verdict, remedy)
