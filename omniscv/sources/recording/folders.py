"""Recordings as folders of images and JSON, and back. The layout is in docs/capture-folders.md."""

import json
import os
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import Any

from omniscv import modalities, storage
from omniscv.arguments import number, numbers, shown, whole_number, within
from omniscv.errors import (
    ArgumentError,
    BadReplyError,
    DamagedRecordingError,
    RecordingError,
    RecordingNotWritableError,
)
from omniscv.geometry import Pose
from omniscv.geometry.scene_geometry import SceneGeometry
from omniscv.sources.base import Capture, ObjectTable, Request, SceneIdentity, View
from omniscv.sources.codecs import decode
from omniscv.sources.recording.adding import opened_whole
from omniscv.sources.recording.object_tables import labelled_modes
from omniscv.sources.recording.rows import (
    DEFAULT_TOLERANCE,
    Row,
    object_from_json,
    scene_from_json,
    scene_in,
    the_scene,
)
from omniscv.sources.recording.schema import MOST_OBJECTS
from omniscv.sources.recording.state_table import HeldState, from_dict, to_dict
from omniscv.sources.recording.store import Store
from omniscv.storage.bounded import read_bytes
from omniscv.storage.local import folder_beside, refusal

INDEX, OBJECTS, MASKS, SCENE = "captures.json", "objects.json", "masks.json", "scene.json"
GEOMETRY, STATES = "geometry.json", "states.json"

_MOST_BYTES = 1 << 30  # of a file in a folder

_ENTRY = {"file", "mode", "view", "asked", "encoding", "provenance", "state"}
_ANGLES = {"yaw_deg", "pitch_deg", "roll_deg"}
_VIEW_NEEDS = {"position", "fov_deg", "width", "height"}


def export(path: Path | str, folder: Path | str) -> int:
    """Write a recording as a folder, the payloads byte for byte; return the number of captures.

    Args:
        path: path or URL of the recording.
        folder: created if there is none; must be empty.

    Raises:
        ArgumentError: the folder is not empty.
        DamagedRecordingError: a capture is not as it was recorded.
        RecordingError: the recording cannot be read, or the folder cannot be written.
    """
    folder = Path(folder)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ArgumentError(f"{folder}: expected an empty or new folder, but it holds something")
    with closing(Store(storage.fetch_file(path))) as store:
        store.listing()  # checks that none is lost
        try:
            with folder_beside(Path(os.path.abspath(folder))) as part:
                count = _export(store, part)
                folder.mkdir(exist_ok=True)
                for each in sorted(part.iterdir(), key=lambda file: file.name == INDEX):
                    each.replace(folder / each.name)  # the index last: a folder with one is complete
        except OSError as cause:
            raise RecordingNotWritableError(refusal(cause, folder)) from cause
    return count


def _export(store: Store, folder: Path) -> int:
    """Write all of a recording into a folder, and return the number of captures."""
    entries: list[dict[str, Any]] = []
    for row in store.rows():
        row.capture()  # checks it
        name = f"{len(entries):06d}-{row.mode_name}.{row.encoding.partition(' ')[0]}"
        (folder / name).write_bytes(row.payload)
        entry: dict[str, Any] = {"file": name, "mode": row.mode_name, "encoding": row.encoding}
        entry["view"] = object_from_json(row.captured)
        entry["provenance"] = object_from_json(row.provenance)
        if row.asked != row.captured:
            entry["asked"] = object_from_json(row.asked)
        if row.state:
            entry["state"] = row.state
        entries.append(entry)
    objects = store.objects()
    _write_json(folder / OBJECTS, {name: list(rgb) for name, rgb in objects.colors.items()})
    if objects.ids or objects.tolerance != DEFAULT_TOLERANCE:
        _write_json(folder / MASKS, {"tolerance": objects.tolerance, "ids": objects.ids})
    _write_json(folder / SCENE, asdict(store.scene_identity))
    if geometry := store.geometry():
        _write_json(folder / GEOMETRY, geometry.to_dict())
    if states := store.states():
        _write_json(folder / STATES, {name: to_dict(state) for name, state in states.items()})
    _write_json(folder / INDEX, entries)
    return len(entries)


def import_folder(folder: Path | str, path: Path | str) -> int:
    """Write a folder's captures, exported or rendered by other tools, into a recording; return how many.

    All or nothing: every capture is checked as a recording's own before the first is written, and all are
    written as one change.

    Raises:
        ArgumentError: the folder's index is missing or wrong; the message names the entry.
        BadReplyError: an image is not what its entry says.
        RecordingError: the file is no recording, cannot be written, has other mask colours, or is of another
            scene.
    """
    folder = Path(folder)
    entries = list(enumerate(_read_json(folder / INDEX, list)))
    objects, masks, scenes = _objects(folder), False, set()
    for entry in entries:
        capture = _read_entry(folder, *entry)
        masks = masks or capture.mode in labelled_modes()
        scenes.add(scene_in(capture.provenance))
    scene, geometry, states = _scene(folder) or the_scene(scenes), _geometry(folder), _states(folder)
    with opened_whole(path) as store:
        store.set_scene(scene)
        given, known = bool(objects.colors), bool(store.objects().colors)
        if (masks and known and not given) or (store.has_masks() and given and not known):
            wanted = f"expected object masks with an object table both in {folder} and in it"
            raise RecordingNotWritableError(f"{path}: {wanted}, got one without; import into another file")
        if given:
            store.set_objects(objects)
        if geometry:
            store.set_geometry(geometry)
        for name, state in states.items():
            store.set_state(name, state)
        for entry in entries:
            store.add(_read_entry(folder, *entry))
    return len(entries)


def _read_entry(folder: Path, number: int, entry: Any) -> Capture:
    """The capture of an entry, checked."""
    where = f"{folder / INDEX}: entry {number}"
    if not isinstance(entry, dict) or not {"file", "mode", "view"} <= set(entry):
        raise ArgumentError(f"{where}: expected 'file', 'mode' and 'view', got {shown(entry)}")
    if strange := set(entry) - _ENTRY:
        known = ", ".join(sorted(_ENTRY))
        raise ArgumentError(f"{where}: expected some of {known}; got {shown(min(strange))}")
    name, view = entry["file"], _view(entry["view"], where)
    if not isinstance(name, str) or name != Path(name).name:
        raise ArgumentError(f"{where}: file: expected the name of a file in the folder, got {shown(name)}")
    provenance = entry.get("provenance", {"server": "imported"})
    if not isinstance(provenance, dict):
        raise ArgumentError(f"{where}: provenance: expected a JSON object, got {shown(provenance)}")
    try:
        state = _word(entry, "state") if "state" in entry else ""
        request = Request(_view(entry.get("asked", entry["view"]), where), _word(entry, "mode"), state)
        encoding = _word(entry, "encoding") if entry.get("encoding") else _default_encoding(name, request)
    except ArgumentError as unknown:
        raise ArgumentError(f"{where}: {unknown}") from unknown
    try:
        payload = _read_regular(folder / name)
    except ArgumentError as cause:
        wanted = "expected an image that can be read"
        raise ArgumentError(f"{where}: {wanted}, got {shown(name)}: {cause}") from cause
    try:
        pixels = decode(payload, encoding, request.mode, view)
        capture = Capture(request, view, pixels, provenance, payload, encoding)
        row = Row.of(capture, 1, "")
        row.check("")
        row.description()  # it can be read again
    except (BadReplyError, RecordingError, ArgumentError) as cause:
        kind = BadReplyError if isinstance(cause, BadReplyError) else ArgumentError
        raise kind(f"{where}: {shown(name)}: {cause}") from cause
    return capture


def _word(entry: dict[str, Any], key: str) -> str:
    """A short text of an entry."""
    value = entry[key]
    if not isinstance(value, str) or len(value) > 100:
        raise ArgumentError(f"{key}: expected a word, got {shown(value)}")
    return value


def _default_encoding(name: str, request: Request) -> str:
    kind = Path(name).suffix.lower().removeprefix(".")
    if kind not in ("png", "npy"):
        raise ArgumentError(f"file: expected a .png or .npy file, got {shown(name)}")
    return (
        "png normal" if kind == "png" and modalities.get(request.mode).interpolation == "direction" else kind
    )


def _view(data: Any, where: str) -> View:
    """A view with a rotation matrix, or with yaw, pitch and roll."""
    wanted = "position, rotation (or yaw_deg, pitch_deg, roll_deg), fov_deg, width and height"
    if not isinstance(data, dict) or not _VIEW_NEEDS <= set(data) <= _VIEW_NEEDS | _ANGLES | {"rotation"}:
        raise ArgumentError(f"{where}: expected a view with {wanted}; got {shown(data)}")
    try:
        position = numbers("position", data["position"], (3,))
        if "rotation" not in data:
            angles = {key: number(key, data[key]) for key in _ANGLES & set(data)}
            pose = Pose.from_angles(position, **angles)
        elif _ANGLES & set(data):
            raise ArgumentError("expected a rotation or angles, got both")
        else:
            pose = Pose(position, numbers("rotation", data["rotation"], (3, 3)))
        size = (whole_number(key, data[key], "px", most=1 << 16) for key in ("width", "height"))
        return View(pose, number("fov_deg", data["fov_deg"]), *size)
    except ArgumentError as cause:
        raise ArgumentError(f"{where}: view: {cause}") from cause


def _scene(folder: Path) -> SceneIdentity | None:
    """The scene that a folder names; None where it names none."""
    if not (folder / SCENE).exists():
        return None
    try:
        return scene_from_json(json.dumps(_read_json(folder / SCENE, dict)))
    except DamagedRecordingError as cause:
        wanted = "expected the texts 'name', 'level' and 'content'"
        raise ArgumentError(f"{folder / SCENE}: {wanted}, got: {cause}") from cause


def _geometry(folder: Path) -> SceneGeometry:
    """What a folder knows of shapes; empty where it has no file for them."""
    if not (folder / GEOMETRY).exists():
        return SceneGeometry()
    with within(folder / GEOMETRY):
        return SceneGeometry.from_dict(_read_json(folder / GEOMETRY, dict))


def _states(folder: Path) -> dict[str, HeldState]:
    """What a folder knows of states of the world; nothing where it has no file for them."""
    if not (folder / STATES).exists():
        return {}
    with within(folder / STATES):
        return {name: from_dict(name, each) for name, each in _read_json(folder / STATES, dict).items()}


def _objects(folder: Path) -> ObjectTable:
    """The object table of a folder, empty where it has none."""
    files = folder / OBJECTS, folder / MASKS
    colors, masks = (_read_json(file, dict) if file.exists() else {} for file in files)
    ids, tolerance = masks.get("ids", {}), masks.get("tolerance", DEFAULT_TOLERANCE)
    for name, rgb in colors.items():
        if not (
            isinstance(rgb, list) and len(rgb) == 3 and _whole(*rgb) and 0 <= min(rgb) <= max(rgb) <= 255
        ):
            wanted = f"expected three numbers 0..255 for {shown(name)}"
            raise ArgumentError(f"{folder / OBJECTS}: {wanted}, got {shown(rgb)}")
    if not (
        set(masks) <= {"ids", "tolerance"} and isinstance(ids, dict) and _whole(tolerance, *ids.values())
    ):
        expected = "expected 'tolerance' and 'ids', name to number"
        raise ArgumentError(f"{folder / MASKS}: {expected}; got {shown(masks)}")
    if not (0 <= tolerance <= 255 and all(0 <= each <= MOST_OBJECTS for each in ids.values())):
        expected = f"expected a tolerance of 0 to 255 and ids of 0 to {MOST_OBJECTS}"
        raise ArgumentError(f"{folder / MASKS}: {expected}, got {shown(masks)}")
    if strange := set(ids) - set(colors or ids):
        wanted = f"expected ids of objects in {OBJECTS}"
        raise ArgumentError(f"{folder / MASKS}: {wanted}, got {shown(min(strange))}")
    return ObjectTable({name: (r, g, b) for name, (r, g, b) in colors.items()}, tolerance, ids)


def _whole(*numbers: Any) -> bool:
    return all(type(number) is int for number in numbers)


def _read_regular(path: Path) -> bytes:
    """The bytes of a file; ArgumentError for a device or a pipe, which may have no end."""
    if os.path.lexists(path) and not os.path.isfile(path):
        raise ArgumentError("expected a file, got a folder, a device or a link that leads nowhere")
    return read_bytes(path, _MOST_BYTES)


def _read_json(path: Path, kind: type) -> Any:
    try:
        data = json.loads(_read_regular(path))
    except (ValueError, RecursionError) as cause:  # an ArgumentError is a ValueError
        raise ArgumentError(f"{path}: expected a JSON file of captures, got: {cause}") from cause
    if not isinstance(data, kind):
        raise ArgumentError(f"{path}: expected a JSON {kind.__name__}, got {type(data).__name__}")
    return data


def _write_json(path: Path, data: Any) -> None:
    path.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
