"""Recorded files as folders of images and JSON, and back. The layout is in docs/capture-folders.md."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from omniscv.captures.decode import decode
from omniscv.captures.source import ObjectTable
from omniscv.captures.store import Store, checksum_of, object_from_json, view_from_json
from omniscv.captures.view import MODES, Capture, Request, View
from omniscv.errors import ArgumentError, BadReply, DamagedRecord, RecordNotWritable
from omniscv.geometry import Pose

INDEX = "captures.json"
OBJECTS = "objects.json"
_ANGLES = ("yaw_deg", "pitch_deg", "roll_deg")


def export(path: Path | str, folder: Path | str) -> int:
    """Writes a recorded file as a folder; the payloads go byte for byte.

    Args:
        path: the recorded file.
        folder: made if it is not there; must be empty.

    Returns:
        The number of captures.

    Raises:
        ArgumentError: the folder holds something.
        DamagedRecord: a capture does not match its checksum.
        RecordError: as :class:`omniscv.captures.store.Store`.
    """
    folder = Path(folder)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ArgumentError(f"{folder}: expected an empty or new folder, but it holds something")
    store = Store(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        entries = []
        for number, row in enumerate(store.rows()):
            if checksum_of(row.payload) != row.checksum:
                raise DamagedRecord(
                    f"{path}: expected checksum {row.checksum:08x} for capture {row.key}; it is damaged"
                )
            name = f"{number:06d}-{row.mode}.{row.encoding.partition(' ')[0]}"
            (folder / name).write_bytes(row.payload)
            entry = {
                "file": name,
                "mode": row.mode,
                "encoding": row.encoding,
                "view": object_from_json(row.captured),
                "provenance": object_from_json(row.provenance),
            }
            if row.asked != row.captured:
                entry["asked"] = object_from_json(row.asked)
            entries.append(entry)
        _write_json(folder / OBJECTS, {name: list(rgb) for name, rgb in store.objects().colors.items()})
        _write_json(folder / INDEX, entries)  # last: a folder with an index is whole
        return len(entries)
    except OSError as cause:
        raise RecordNotWritable(f"{folder}: expected to write the captures there, got: {cause}") from cause
    finally:
        store.close()


def import_folder(folder: Path | str, path: Path | str) -> int:
    """Writes a folder's captures into a recorded file: exported ones, or faces rendered by other tools.

    Every capture is decoded before any is kept, so that a wrong folder leaves no file behind.

    Returns:
        The number of captures.

    Raises:
        ArgumentError: the folder's index is missing or wrong; the message names the entry.
        BadReply: an image is not what its entry says.
        RecordError: as :class:`omniscv.captures.store.Store`.
    """
    folder = Path(folder)
    entries = _read_json(folder / INDEX, list)
    captures = [_Entry(folder, number, entry) for number, entry in enumerate(entries)]
    objects_file = folder / OBJECTS
    objects = _objects(objects_file) if objects_file.exists() else ObjectTable({})
    for capture in captures:
        capture.read()  # all are right before the first is kept
    store = Store(path, write=True)
    try:
        for capture in captures:
            store.add(capture.read())
        store.set_objects(objects)
    finally:
        store.close()
    return len(captures)


class _Entry:
    """One capture of an index, checked; its image is read later."""

    def __init__(self, folder: Path, number: int, entry: Any) -> None:
        where = f"{folder / INDEX}: entry {number}"
        if not isinstance(entry, dict) or not {"file", "mode", "view"} <= set(entry):
            raise ArgumentError(f"{where}: expected 'file', 'mode' and 'view', got {entry!r}")
        name = entry["file"]
        if not isinstance(name, str) or name != Path(name).name:
            raise ArgumentError(f"{where}: expected the name of a file in the folder, got {name!r}")
        if entry["mode"] not in MODES:
            raise ArgumentError(f"{where}: expected a mode of {', '.join(MODES)}; got {entry['mode']!r}")
        self._file = folder / name
        self._encoding = entry.get("encoding") or _default_encoding(name, entry["mode"], where)
        self._view = _view(entry["view"], where)
        self._request = Request(_view(entry.get("asked", entry["view"]), where), entry["mode"])
        self._provenance = entry.get("provenance", {"server": "imported"})

    def read(self) -> Capture:
        """The capture, decoded."""
        try:
            payload = self._file.read_bytes()
        except OSError as cause:
            raise ArgumentError(f"{self._file}: expected an image that can be read, got: {cause}") from cause
        try:
            pixels = decode(payload, self._encoding, self._request.mode, self._view)
        except BadReply as cause:
            raise BadReply(f"{self._file}: {cause}") from cause
        return Capture(self._request, self._view, pixels, payload, self._encoding, self._provenance)


def _default_encoding(name: str, mode: str, where: str) -> str:
    kind = Path(name).suffix.lower().removeprefix(".")
    encodings = {"png": "png normal" if mode == "normal" else "png", "npy": "npy"}
    if kind not in encodings:
        raise ArgumentError(f"{where}: expected a .png or .npy file, got {name!r}")
    return encodings[kind]


def _view(data: Any, where: str) -> View:
    """A view with a rotation matrix, or with yaw, pitch and roll."""
    try:
        if "rotation" in data:
            return view_from_json(json.dumps(data))
        pose = Pose.from_angles(data["position"], **{key: data[key] for key in _ANGLES if key in data})
        return View(pose, data["fov_deg"], data["width"], data["height"])
    except (KeyError, TypeError, ValueError, DamagedRecord) as cause:
        raise ArgumentError(
            f"{where}: expected a view with position, rotation (or yaw_deg, pitch_deg, roll_deg), fov_deg, "
            f"width and height; got {data!r}: {cause}"
        ) from cause


def _objects(path: Path) -> ObjectTable:
    colors = {}
    for name, rgb in _read_json(path, dict).items():
        if not (
            isinstance(rgb, list) and len(rgb) == 3 and all(type(v) is int and 0 <= v <= 255 for v in rgb)
        ):
            raise ArgumentError(f"{path}: expected three numbers 0..255 for {name!r}, got {rgb!r}")
        colors[name] = (rgb[0], rgb[1], rgb[2])
    return ObjectTable(colors)


def _read_json(path: Path, kind: type) -> Any:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as cause:
        raise ArgumentError(f"{path}: expected a JSON file of captures, got: {cause}") from cause
    if not isinstance(data, kind):
        raise ArgumentError(f"{path}: expected a JSON {kind.__name__}, got {type(data).__name__}")
    return data


def _write_json(path: Path, data: Any) -> None:
    path.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
