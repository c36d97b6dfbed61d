"""A report on a server for people who cannot reach it, without paths and names of the host and the user."""

import getpass
import json
import platform
import re
import socket
import time
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Unpack

import omniscv
from omniscv.diagnostics import Finding
from omniscv.diagnostics.server import FACES, RawCamera
from omniscv.errors import SourceError
from omniscv.geometry import Array
from omniscv.sources.registry import Deadlines
from omniscv.sources.unreal import open_connection, protocol
from omniscv.sources.unreal.client import Connection, address_of
from omniscv.storage.local import whole_file

_ALWAYS = (protocol.VERSION, protocol.SCENE, "vget /unrealcv/status", "vget /unrealcv/help", "vget /objects")
_MODES = ("lit", "depth", "object_mask", "normals")
_FACES = ("front", "left")
_SUFFIXES = ("png", "npy", "bmp")
_MOST_TEXT = 20_000  # characters of a reply
_LEAST_NAME = 3  # characters of a name that is left out: shorter ones are part of too many words
_PATHS = re.compile(
    r"(?:\b[A-Za-z]:[\\/]|\\\\|~/|/(?:home|Users|root|mnt|media|opt|var|tmp|usr|srv|data|Volumes|private)/)"
    r"[^\n\"']*"
)


def write_report(
    address: str,
    findings: Sequence[Finding],
    path: Path,
    position: Array | None = None,
    **deadlines: Unpack[Deadlines],
) -> Path:
    """Write a ZIP of what a server is: ``report.json`` and ``captures/FACE.MODE.png`` or ``.npy``.

    Args:
        address: of the server, as for :func:`omniscv.diagnostics.doctor.examine_address`.
        findings: of the same.
        path: of the ZIP.
        position: (3,) where to capture, world frame, metres; None: the player's position.
        deadlines: ``timeout_s`` and ``patience_s``, as for :func:`omniscv.open_source`.

    Raises:
        SourceError: no server reachable there, or one that makes no pictures.
        StorageError: the disk is full.
    """
    with open_connection(address, **deadlines) as connection:
        report = {
            "omniscv": omniscv.__version__,
            "python": platform.python_version(),
            "system": f"{platform.system()} {platform.machine()}",
            "dialect": connection.plugin.dialect,
            "templates": sorted(connection.plugin.templates),
            "findings": [asdict(finding) for finding in findings],
            "replies": [_asked(connection, command) for command in _commands(connection)],
        }
        with RawCamera(connection, position) as camera:
            captures = dict(_captures(connection, camera))
        names = _private_names(connection)
    with whole_file(path) as part, zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("report.json", json.dumps(_without(report, names), indent=1))
        for name, payload in captures.items():
            file.writestr(f"captures/{name}", payload)
    return path


def _private_names(connection: Connection) -> list[str]:
    """Return the names of this machine and its user, and the parts of the server's address."""
    address = re.split(r"[:/]+", address_of(connection.endpoint))[1:]
    names = []
    for name in (socket.gethostname(), getpass.getuser(), *address):
        if len(name) >= _LEAST_NAME and not name.isdigit():
            names.append(name)
    return names


def _commands(connection: Connection) -> Iterator[str]:
    """Yield the commands that only read, of camera 0 and the first object, each once."""
    objects = protocol.names(connection.texts(["vget /objects"])[0])
    yield from _ALWAYS
    for template in sorted(connection.plugin.templates - {*_ALWAYS}):
        form = "npy" if "depth" in template else "png"
        command = re.sub(r" \[str\]$", f" {form}", template.replace("[uint]", "0"))
        if objects:
            command = command.replace("/object/[str]", f"/object/{objects[0]}")
        if command.startswith("vget ") and "[" not in command and "_shared" not in command:
            yield command


def _asked(connection: Connection, command: str) -> dict[str, Any]:
    """Return a command's reply, or why there is none, and the milliseconds that it took."""
    started = time.monotonic()
    try:
        (reply,) = connection.read([command], lambda _, reply: protocol.described(reply)[:_MOST_TEXT])
    except SourceError as fault:
        reply = f"no reply: {fault}"
    return {"command": command, "ms": round(1e3 * (time.monotonic() - started), 1), "reply": reply}


def _captures(connection: Connection, camera: RawCamera) -> Iterator[tuple[str, bytes]]:
    """Yield names and pictures as received; of a mode that is refused the text of the refusal."""
    for face in _FACES:
        camera.go(*FACES[face])
        for mode in _MODES:
            command = camera.driver.table.image(camera.driver.camera, mode)
            (reply,) = connection.read([command], lambda _, reply: reply)
            if isinstance(reply, str):
                yield f"{face}.{mode}.txt", reply.encode()
                continue
            form = protocol.described(reply).split(",")[0].lower()
            suffix = form if form in _SUFFIXES else "bin"
            yield f"{face}.{mode}.{suffix}", reply


def _without(value: Any, names: Iterable[str]) -> Any:
    """Return values for JSON whose texts have no paths and none of the names."""
    if isinstance(value, dict):
        return {key: _without(item, names) for key, item in value.items()}
    if isinstance(value, list):
        return [_without(item, names) for item in value]
    if isinstance(value, str):
        value = _PATHS.sub("(path)", value)
        for name in names:
            value = re.sub(rf"\b{re.escape(name)}\b", "(name)", value, flags=re.IGNORECASE)
    return value
