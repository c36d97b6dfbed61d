"""Recordings as folders of images and JSON, and back. The layout is in docs/capture-folders.md."""

import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing
from dataclasses import asdict
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np

from omniscv import modalities, storage
from omniscv.arguments import label, optional_number, shown, text, whole_number, within
from omniscv.errors import ArgumentError, BadReplyError, RecordingError, RecordingNotWritableError
from omniscv.geometry.scene_geometry import SceneGeometry
from omniscv.geometry.trajectory_columns import Rows
from omniscv.pictures import color_tags, png
from omniscv.records import checked, listed, mapping, named, optional, read, record
from omniscv.sources.base import Capture, ObjectTable, Request, SceneIdentity, View
from omniscv.sources.codecs import decode, without_zeros
from omniscv.sources.recording.operations import add_objects, opened_whole
from omniscv.sources.recording.replay import in_words
from omniscv.sources.recording.rows import Row, labelled_modes, view_from_dict
from omniscv.sources.recording.store import Store
from omniscv.sources.recording.world_rows import (
    DEFAULT_TOLERANCE,
    MOST_OBJECTS,
    WorldState,
    listed_scenes,
    object_from_json,
    scene_of,
)
from omniscv.storage.bounded import MOST_PICTURE_BYTES, named_file, parse_json, read_bytes
from omniscv.storage.local import folder_beside, refusal

T = TypeVar("T")
J = TypeVar("J", dict[str, Any], list[Any])

INDEX = "captures.json"
OBJECTS = "objects.json"
MASKS = "masks.json"
SCENE = "scene.json"
GEOMETRY = "geometry.json"
STATES = "states.json"


def export(path: Path | str, folder: Path | str) -> int:
    """Write a recording as a folder, the payloads byte for byte; return the number of captures.

    Args:
        path: of the recording, or its URL.
        folder: new or empty.

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
            with folder_beside(Path(os.path.abspath(folder))) as scratch:
                count = _write_folder(store, scratch)
                folder.mkdir(exist_ok=True)
                for file in sorted(scratch.iterdir(), key=lambda file: file.name == INDEX):
                    file.replace(folder / file.name)  # the index last: a folder with an index is complete
        except OSError as cause:
            raise RecordingNotWritableError(refusal(cause, folder)) from cause
    return count


def import_folder(folder: Path | str, path: Path | str) -> int:
    """Write a folder's captures, exported or rendered by other tools, into a recording; return how many.

    All or nothing: every capture is checked before the first is written, and all are one change.

    Args:
        folder: of captures, with an index.
        path: of the recording; new, or one to add to.

    Raises:
        ArgumentError: the folder's index is missing or wrong; the message names the entry.
        BadReplyError: an image is not what its entry says.
        RecordingError: the file is no recording, cannot be written, has other mask colours, other captures
            of the same requests, or another scene.
    """
    folder = Path(folder)
    with within(folder / INDEX):
        index = _read_json(folder / INDEX, list)
    entries: dict[str, _Entry] = {}
    for i, entry in enumerate(index):
        where = f"{folder / INDEX}[{i}]"
        entries[where] = read(_Entry, entry, where)
    with within(folder):
        objects = _objects(folder)

        def captures() -> Iterator[Capture]:
            for where, entry in entries.items():
                capture = _capture(folder, where, entry)
                if entry.provenance is None:
                    with within(where):
                        _check_mask(capture, objects, (folder / OBJECTS).exists())
                yield capture

        return add_captures(
            path,
            captures,
            objects,
            _read_optional(folder / GEOMETRY, SceneGeometry.from_dict),
            _read_optional(folder / STATES, _states) or {},
            _read_optional(folder / SCENE, partial(read, SceneIdentity)),
        )


def add_captures(
    path: Path | str,
    captures: Callable[[], Iterable[Capture]],
    objects: ObjectTable | Callable[[ObjectTable], ObjectTable] | None = None,
    geometry: SceneGeometry | None = None,
    states: Mapping[str, WorldState] = MappingProxyType({}),
    scene: SceneIdentity | None = None,
) -> int:
    """Add captures of one scene to a recording, new or not, all or none; return how many.

    Args:
        path: of the recording.
        captures: called twice, to check all and to write all: they may not fit in memory together.
        objects, geometry, states: of the scene, as far as they are known; objects may be a function of those
            of the recording before, which is called when all captures have been checked.
        scene: None: as the captures say; ArgumentError for several.
    """
    modes: set[str] = set()
    scenes: set[str] = set()
    for capture in captures():
        Row.of(capture)
        modes.add(capture.mode)
        scenes |= scene_of(capture)
    if len(scenes) > 1:
        raise ArgumentError(f"expected captures of one scene, got some of {listed_scenes(scenes)}")
    requests: set[Request] = set()
    with opened_whole(path) as store:
        store.set_scene(scene or SceneIdentity(*scenes))
        has_masks = not modes.isdisjoint(labelled_modes())
        table = objects(store.objects()) if callable(objects) else objects
        add_objects(store, table if table and has_masks else ObjectTable({}, DEFAULT_TOLERANCE), has_masks)
        if geometry:
            store.set_geometry(geometry)
        for name, state in states.items():
            store.set_state(name, state)
        for capture in captures():
            if capture.request in requests or not _is_there(store, capture):
                store.add(capture)
            requests.add(capture.request)
    return len(requests)


def _is_there(store: Store, capture: Capture) -> bool:
    """Return whether a recording has a capture already; RecordingError if it has another one."""
    known = store.get_row(capture.request)
    if known is None:
        return False
    row = Row.of(capture)
    if (known.payload, known.encoding, known.captured) != (row.payload, row.encoding, row.captured):
        view = in_words(capture.request.view)
        expected = f"expected the {capture.mode} that was recorded before, {view}"
        raise RecordingError(f"{expected}; got another; import into another file", store.path)
    return True


def _write_folder(store: Store, folder: Path) -> int:
    """Write all of a recording into a folder, and return the number of captures."""
    entries: list[dict[str, Any]] = []
    for row in store.rows():
        row.capture()  # checks it
        name = f"{len(entries):06d}-{row.mode}.{row.encoding.partition(' ')[0]}"
        (folder / name).write_bytes(row.payload)
        entry: dict[str, Any] = {"file": name, "mode": row.mode, "encoding": row.encoding}
        entry["view"] = object_from_json(row.captured)
        entry["provenance"] = object_from_json(row.provenance)
        if row.asked != row.captured:
            entry["asked"] = object_from_json(row.asked)
        if row.state:
            entry["state"] = row.state
        if row.stops is not None:
            entry["stops"] = row.stops
        entries.append(entry)
    objects = store.objects()
    _write_json(folder / OBJECTS, {name: list(objects.colors[name]) for name in objects.colors})
    if objects.ids or objects.tolerance != DEFAULT_TOLERANCE:
        _write_json(folder / MASKS, {"tolerance": objects.tolerance, "ids": objects.ids})
    _write_json(folder / SCENE, asdict(store.scene_identity))
    if geometry := store.geometry():
        _write_json(folder / GEOMETRY, geometry.to_dict())
    if states := store.states():
        _write_json(folder / STATES, {name: states[name].to_dict() for name in states})
    _write_json(folder / INDEX, entries)
    return len(entries)


def _view(name: str, value: object) -> View:
    """Return a view, whose pose is a rotation matrix, a quaternion, or yaw, pitch and roll."""
    data = mapping(name, value)
    pose = {}
    for key in list(data):
        if key not in ("fov_deg", "width", "height", "lens"):
            pose[key] = data.pop(key)
    (position,), (rotation,) = Rows.of_entries([(name, pose)]).poses()
    with within(name):
        return view_from_dict({**data, "position": position, "rotation": rotation})


def _file_name(name: str, value: object) -> str:
    if not isinstance(value, str) or not value or value != Path(value).name:
        raise ArgumentError(f"{name}: expected the name of a file in the folder, got {shown(value)}")
    return value


def _color(name: str, value: object) -> tuple[int, ...]:
    color = listed(partial(whole_number, least=0, most=255))(name, value)
    if len(color) != 3:
        raise ArgumentError(f"{name}: expected three numbers 0..255, got {shown(value)}")
    return tuple(color)


@record(eq=False)
class _Entry:
    """An entry of the index: an image, and what it shows."""

    file: str = checked(_file_name)
    mode: str = checked(label)
    view: View = checked(_view)
    asked: View | None = checked(optional(_view), default=None)
    encoding: str = checked(text, default="")
    provenance: Mapping[str, Any] | None = checked(optional(mapping), default=None)
    state: str = checked(text, default="")
    stops: float | None = checked(optional_number, default=None)

    def request(self) -> Request:
        """Return what was requested; ArgumentError for a mode that is unknown."""
        return Request(self.asked or self.view, self.mode, self.state, stops=self.stops)

    def default_encoding(self) -> str:
        """Return the encoding by the file's name; ArgumentError for other images than PNG and NPY."""
        suffix = Path(self.file).suffix.lower().removeprefix(".")
        if suffix not in ("png", "npy"):
            raise ArgumentError(f"file: expected a .png or .npy file, got {shown(self.file)}")
        is_direction = modalities.get(self.mode).interpolation == "direction"
        return "png normal" if suffix == "png" and is_direction else suffix


@record
class _Masks:
    """How object masks show objects."""

    tolerance: int = checked(whole_number, least=0, most=255, default=DEFAULT_TOLERANCE)
    ids: Mapping[str, int] = checked(
        named(partial(whole_number, least=0, most=MOST_OBJECTS)), default_factory=dict
    )


def _capture(folder: Path, where: str, entry: _Entry) -> Capture:
    """Return the capture of an entry, checked."""
    with within(where):
        request = entry.request()
        encoding = entry.encoding or entry.default_encoding()
    try:
        payload = read_bytes(named_file(folder, entry.file), MOST_PICTURE_BYTES)
    except ArgumentError as cause:
        expected = f"expected an image that can be read, got {shown(entry.file)}"
        raise ArgumentError(f"{where}: {expected}: {cause}") from cause
    try:
        capture = _decoded(entry, request, payload, encoding)
        Row.of(capture).description()  # it can be read again
    except (BadReplyError, RecordingError, ArgumentError) as cause:
        error = BadReplyError if isinstance(cause, BadReplyError) else ArgumentError
        raise error(f"{where}: {shown(entry.file)}: {cause}") from cause
    return capture


def _decoded(entry: _Entry, request: Request, payload: bytes, encoding: str) -> Capture:
    """Return the capture of an entry's file; what other tools write is put into our form."""
    provenance = {"server": "imported"} if entry.provenance is None else entry.provenance
    is_depth = modalities.get(request.mode).interpolation == "surface"
    if is_depth and encoding == "npy" and provenance.get("server", "imported") == "imported":
        payload = without_zeros(payload)
    is_others_color = entry.provenance is None and request.mode == "lit"
    if is_others_color and encoding == "png":
        payload = _as_srgb(payload)
    pixels = decode(payload, encoding, request.mode, entry.view)
    if is_others_color and pixels.dtype == np.uint8:
        provenance = {**provenance, "transfer": "srgb"}
    return Capture(request, entry.view, pixels, provenance, payload, encoding)


def _check_mask(capture: Capture, objects: ObjectTable, has_colors: bool) -> None:
    """Raise ArgumentError for a mask of colours where objects are listed by id alone, and for the reverse."""
    if capture.mode not in labelled_modes() or not objects.colors:
        return
    holds_ids = capture.pixels.ndim == 2
    if objects.ids if holds_ids else has_colors:
        return
    if holds_ids:
        raise ArgumentError(f"expected colours, as {OBJECTS} lists, got ids; list the ids in {MASKS}")
    expected = f"expected ids, as {MASKS} lists, got colours"
    raise ArgumentError(f"{expected}; write grey pixels with the encoding 'png ids', or list colours only")


def _as_srgb(payload: bytes) -> bytes:
    """Return a PNG of colours as sRGB, converted where its tags say another thing of them."""
    tags = color_tags.of_png(payload)
    if tags.is_plain:
        return payload
    from omniscv.sources import tagged_colors  # compiled

    pixels, line = tagged_colors.converted(png.decode(payload), tags)
    return png.encode(np.ascontiguousarray(pixels[..., :3])) if line else payload


def _states(states: dict[str, object]) -> dict[str, WorldState]:
    return {name: WorldState.from_dict(name, states[name]) for name in states}


def _objects(folder: Path) -> ObjectTable:
    """Return the colours and ids of objects that a folder lists; an empty table if it lists none."""
    colors: dict[str, Any] = _read_optional(folder / OBJECTS, partial(named(_color), "")) or {}
    masks = _read_optional(folder / MASKS, partial(read, _Masks)) or _Masks()
    if strange := set(masks.ids) - set(colors or masks.ids):
        expected = f"expected objects of {OBJECTS}, got {shown(min(strange))}"
        raise ArgumentError(f"{folder / MASKS}: ids: {expected}")
    return ObjectTable(colors, masks.tolerance, dict(masks.ids))


def _read_optional(path: Path, reader: Callable[[Any], T]) -> T | None:
    """Return what a reader makes of the JSON object of a file; None where there is no file."""
    if not path.exists():
        return None
    with within(path):
        return reader(_read_json(path, dict))


def _read_json(path: Path, expected: type[J]) -> J:
    data = parse_json(read_bytes(path, MOST_PICTURE_BYTES), MOST_PICTURE_BYTES)
    if not isinstance(data, expected):
        raise ArgumentError(f"expected a JSON {expected.__name__}, got {type(data).__name__}")
    return data


def _write_json(path: Path, data: Any) -> None:
    path.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
