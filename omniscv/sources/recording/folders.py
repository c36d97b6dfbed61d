"""Recordings as folders of images and JSON, and back. The layout is in docs/capture-folders.md."""

import json
from contextlib import closing
from pathlib import Path
from typing import Any

from omniscv import modalities
from omniscv.errors import ArgumentError, BadReplyError, DamagedRecordingError, RecordingNotWritableError
from omniscv.geometry import Pose
from omniscv.sources.base import Capture, ObjectTable, Request, View
from omniscv.sources.codecs import decode
from omniscv.sources.recording.store import DEFAULT_TOLERANCE, Store, object_from_json, view_from_json

INDEX, OBJECTS, MASKS = "captures.json", "objects.json", "masks.json"


def export(path: Path | str, folder: Path | str) -> int:
    """Write a recording as a folder, the payloads byte for byte; return the number of captures.

    Args:
        path: the recording.
        folder: created if there is none; must be empty.

    Raises:
        ArgumentError: the folder is not empty.
        DamagedRecordingError: a capture is not as it was recorded.
        RecordingError: the recording cannot be read, or the folder cannot be written.
    """
    folder = Path(folder)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ArgumentError(f"{folder}: expected an empty or new folder, but it holds something")
    with closing(Store(path)) as store:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            entries = []
            for number, row in enumerate(store.rows()):
                row.capture()  # checks it
                name = f"{number:06d}-{row.mode_name}.{row.encoding.partition(' ')[0]}"
                (folder / name).write_bytes(row.payload)
                entry: dict[str, Any] = {"file": name, "mode": row.mode_name, "encoding": row.encoding}
                entry["view"] = object_from_json(row.captured)
                entry["provenance"] = object_from_json(row.provenance)
                if row.asked != row.captured:
                    entry["asked"] = object_from_json(row.asked)
                entries.append(entry)
            objects = store.objects()
            _write_json(folder / OBJECTS, {name: list(rgb) for name, rgb in objects.colors.items()})
            if objects.ids or objects.tolerance != DEFAULT_TOLERANCE:
                _write_json(folder / MASKS, {"tolerance": objects.tolerance, "ids": objects.ids})
            _write_json(folder / INDEX, entries)  # last: a folder with an index is complete
            return len(entries)
        except OSError as cause:
            raise RecordingNotWritableError(f"{folder}: expected to write there, got: {cause}") from cause


def import_folder(folder: Path | str, path: Path | str) -> int:
    """Write a folder's captures, exported or rendered by other tools, into a recording; return how many.

    Every capture is decoded before the first is written, so that a wrong folder leaves no file behind.

    Raises:
        ArgumentError: the folder's index is missing or wrong; the message names the entry.
        BadReplyError: an image is not what its entry says.
        RecordingError: the file is no recording, cannot be written, or has other mask colours.
    """
    folder = Path(folder)
    entries = list(enumerate(_read_json(folder / INDEX, list)))
    objects = _objects(folder)
    for entry in entries:
        _read_entry(folder, *entry)  # all are right before the first is written
    with closing(Store(path, write=True)) as store:
        store.set_objects(objects)
        for entry in entries:
            store.add(_read_entry(folder, *entry))
    return len(entries)


def _read_entry(folder: Path, number: int, entry: Any) -> Capture:
    where = f"{folder / INDEX}: entry {number}"
    if not isinstance(entry, dict) or not {"file", "mode", "view"} <= set(entry):
        raise ArgumentError(f"{where}: expected 'file', 'mode' and 'view', got {entry!r}")
    name, view = entry["file"], _view(entry["view"], where)
    if not isinstance(name, str) or name != Path(name).name:
        raise ArgumentError(f"{where}: expected the name of a file in the folder, got {name!r}")
    try:
        request = Request(_view(entry.get("asked", entry["view"]), where), entry["mode"])
    except ArgumentError as unknown:
        raise ArgumentError(f"{where}: {unknown}") from unknown
    encoding = entry.get("encoding") or _default_encoding(name, request.mode, where)
    try:
        payload = (folder / name).read_bytes()
        pixels = decode(payload, encoding, request.mode, view)
    except OSError as cause:
        raise ArgumentError(f"{folder / name}: expected an image that can be read, got: {cause}") from cause
    except BadReplyError as cause:
        raise BadReplyError(f"{folder / name}: {cause}") from cause
    return Capture(request, view, pixels, entry.get("provenance", {"server": "imported"}), payload, encoding)


def _default_encoding(name: str, mode: str, where: str) -> str:
    kind = Path(name).suffix.lower().removeprefix(".")
    if kind not in ("png", "npy"):
        raise ArgumentError(f"{where}: expected a .png or .npy file, got {name!r}")
    return "png normal" if kind == "png" and modalities.get(mode).interpolation == "direction" else kind


def _view(data: Any, where: str) -> View:
    """A view with a rotation matrix, or with yaw, pitch and roll."""
    try:
        if "rotation" not in data:
            angles = {key: data[key] for key in ("yaw_deg", "pitch_deg", "roll_deg") if key in data}
            data = {**data, **Pose.from_angles(data["position"], **angles).to_dict()}
        return view_from_json(json.dumps(data))
    except (KeyError, TypeError, ValueError, DamagedRecordingError) as cause:
        raise ArgumentError(
            f"{where}: expected a view with position, rotation (or yaw_deg, pitch_deg, roll_deg), fov_deg, "
            f"width and height; got {data!r}: {cause}"
        ) from cause


def _objects(folder: Path) -> ObjectTable:
    """The object table of a folder, empty where it has none."""
    files = folder / OBJECTS, folder / MASKS
    colors, masks = (_read_json(file, dict) if file.exists() else {} for file in files)
    ids, tolerance = masks.get("ids", {}), masks.get("tolerance", DEFAULT_TOLERANCE)
    for name, rgb in colors.items():
        if not (
            isinstance(rgb, list) and len(rgb) == 3 and _whole(*rgb) and 0 <= min(rgb) <= max(rgb) <= 255
        ):
            wanted = f"expected three numbers 0..255 for {name!r}"
            raise ArgumentError(f"{folder / OBJECTS}: {wanted}, got {rgb!r}")
    if not (isinstance(ids, dict) and _whole(tolerance, *ids.values())):
        expected = "expected 'tolerance' and 'ids', name to number"
        raise ArgumentError(f"{folder / MASKS}: {expected}; got {masks!r}")
    return ObjectTable({name: (r, g, b) for name, (r, g, b) in colors.items()}, tolerance, ids)


def _whole(*numbers: Any) -> bool:
    return all(type(number) is int for number in numbers)


def _read_json(path: Path, kind: type) -> Any:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as cause:
        raise ArgumentError(f"{path}: expected a JSON file of captures, got: {cause}") from cause
    if not isinstance(data, kind):
        raise ArgumentError(f"{path}: expected a JSON {kind.__name__}, got {type(data).__name__}")
    return data


def _write_json(path: Path, data: Any) -> None:
    path.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
