"""Objects of meshes whose labels stand in other files: Replica, HM3D, ScanNet++, Matterport3D."""

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import shown
from omniscv.errors import ArgumentError
from omniscv.sources.mesh.gltf_nodes import read_gltf
from omniscv.sources.mesh.materials import CODES_BELOW
from omniscv.sources.mesh.model import Contents, Ints, Part, plain_name, split_part
from omniscv.sources.mesh.ply import Ply, ply_part, read_ply_arrays
from omniscv.storage.bounded import MOST_JSON_BYTES, decode_text, parse_json, read_bytes

_MOST_BYTES = 16 * MOST_JSON_BYTES  # ScanNet++ has a number for each vertex
REPLICA_NAMES = "info_semantic.json"
_UNNAMED = "unlabelled"
_HM3D = "HM3D Semantic Annotations"
_OBJECT_IDS = ("object_id", "objectId")
_CATEGORIES = ("category_id", "categoryId")


def read_labelled(path: Path, labels: Path) -> Contents:
    """Return the triangles of a mesh whose objects another file names.

    Args:
        path: of the mesh.
        labels: ``info_semantic.json`` (Replica), ``segments_anno.json`` beside ``segments.json`` (ScanNet++),
            ``.house`` (Matterport3D), or ``.semantic.txt`` (HM3D).

    Raises:
        ArgumentError: a file of another form, or one that does not fit the mesh.
    """
    if labels.suffix == ".txt":
        return _by_colors(read_gltf(path), _hm3d_names(labels))
    if path.suffix.lower() != ".ply":
        raise ArgumentError(f"labels: expected a PLY file for {labels.name}, got {path.suffix}")
    ply = read_ply_arrays(path)
    if labels.suffix == ".house":
        numbers, names = _of_house(ply, labels)
    else:
        document = _json(labels)
        if "segGroups" in document:
            numbers, names = _of_segments(ply, document, labels)
        else:
            numbers = _face_values(ply, _OBJECT_IDS)
            names = _replica_names(document, labels)
    return Contents(split_part(ply_part(ply), numbers, names, _UNNAMED), notes=ply.notes)


def _json(path: Path) -> dict[str, Any]:
    """Return the JSON object of a file."""
    document = parse_json(read_bytes(path, _MOST_BYTES), _MOST_BYTES)
    if not isinstance(document, dict):
        raise ArgumentError(f"labels: expected a JSON object in {path.name}, got {shown(document)}")
    return document


def _face_values(ply: Ply, names: tuple[str, ...]) -> Ints:
    """Return the first of some properties of faces, (M,)."""
    for name in names:
        if name in ply.face_values:
            return ply.face_values[name].astype(np.int64)
    known = ", ".join(sorted(ply.face_values)) or "none"
    raise ArgumentError(f"labels: expected faces with {' or '.join(names)}, got {known}")


def _replica_names(document: Mapping[str, Any], path: Path) -> dict[int, str]:
    """Return the names of objects of Replica: its class and its number."""
    try:
        classes = {int(row["id"]): str(row["name"]) for row in document["classes"]}
        names = {}
        for row in document["objects"]:
            number = int(row["id"])
            names[number] = plain_name(f"{classes.get(int(row['class_id']), 'object')}_{number}")
    except (KeyError, TypeError, ValueError) as cause:
        expected = "expected objects and classes with ids, or segGroups"
        raise ArgumentError(f"labels: {expected} in {path.name}, got others: {shown(str(cause))}") from cause
    return names


def _of_segments(ply: Ply, document: Mapping[str, Any], path: Path) -> tuple[Ints, dict[int, str]]:
    """Return the objects of triangles of ScanNet++: of most of their vertices, whose segments groups have."""
    segments = _json(path.with_name("segments.json"))
    try:
        of_vertex = np.array(segments["segIndices"], np.int64)
        names = {}
        owner: dict[int, int] = {}
        for group in document["segGroups"]:
            number = int(group["id"])
            names[number] = plain_name(f"{group['label']}_{number}")
            owner.update(dict.fromkeys(map(int, group["segments"]), number))
    except (KeyError, TypeError, ValueError, OverflowError) as cause:
        expected = "expected segIndices and segGroups with id, label and segments"
        raise ArgumentError(f"labels: {expected}, got others: {shown(str(cause))}") from cause
    if len(of_vertex) != len(ply.vertices):
        expected = f"expected segIndices of {len(ply.vertices)} vertices"
        raise ArgumentError(f"labels: {expected} in segments.json, got {len(of_vertex)}")
    unique, places = np.unique(of_vertex, return_inverse=True)
    number_of = np.array([owner.get(segment, -1) for segment in unique.tolist()])
    return _majority(number_of[places.reshape(-1)][ply.faces]), names


def _majority(corners: Ints) -> Ints:
    """Return (M,) what two of three corners (M, 3) have, else the first's."""
    return np.where(corners[:, 1] == corners[:, 2], corners[:, 1], corners[:, 0])


def _of_house(ply: Ply, path: Path) -> tuple[Ints, dict[int, str]]:
    """Return the objects of Matterport3D, or the categories of a file whose faces have no objects."""
    by_category: dict[int, str] = {}
    by_mapping: dict[int, str] = {}
    objects: dict[int, int] = {}
    for line in decode_text(read_bytes(path, MOST_JSON_BYTES)).splitlines():
        words = line.split()
        try:
            if words[:1] == ["C"]:
                by_category[int(words[1])] = words[5]
                by_mapping[int(words[2])] = words[5]
            elif words[:1] == ["O"]:
                objects[int(words[1])] = int(words[3])
        except (IndexError, ValueError) as cause:
            raise ArgumentError(f"labels: expected lines of a .house file, got {shown(line[:60])}") from cause
    names = {}
    if any(name in ply.face_values for name in _OBJECT_IDS):
        for number, category in objects.items():
            names[number] = plain_name(f"{by_category.get(category, 'object')}_{number}")
        return _face_values(ply, _OBJECT_IDS), names
    for number, name in by_mapping.items():
        names[number] = plain_name(f"{name}_{number}")
    return _face_values(ply, _CATEGORIES), names


def _hm3d_names(path: Path) -> dict[int, str]:
    """Return the names of objects of HM3D by the colour, 0xRRGGBB, that its semantic file shows them in."""
    lines = decode_text(read_bytes(path, MOST_JSON_BYTES)).splitlines()
    if not lines or _HM3D not in lines[0]:
        raise ArgumentError(f"labels: expected {_HM3D!r} in the first line of {path.name}, got none")
    names = {}
    for row in csv.reader(lines[1:]):
        try:
            number, color, category = row[:3]
            names[int(color, 16)] = plain_name(f"{category}_{int(number)}")
        except ValueError as cause:
            expected = "expected an id, RRGGBB and a category"
            raise ArgumentError(f"labels: {expected} in {path.name}, got {shown(row[:3])}") from cause
    return names


def _by_colors(contents: Contents, names: Mapping[int, str]) -> Contents:
    """Return contents whose objects are the colours of the middles of faces."""
    parts = []
    for part in contents.parts:
        codes = _colors_of_faces(part).astype(np.int64)
        numbers = codes[:, 0] << 16 | codes[:, 1] << 8 | codes[:, 2]
        parts += split_part(part, numbers, names, _UNNAMED)
    return Contents(parts, contents.y_up, contents.notes, contents.colorless)


def _colors_of_faces(part: Part) -> NDArray[np.uint8]:
    """Return (M, 3) the colours that the middles of faces show: of the nearest pixel, or of most corners."""
    texture = part.material.texture
    if texture is not None and part.uv is not None:
        height, width = texture.pixels.shape[:2]
        middle = part.uv[part.faces].mean(axis=1) % 1
        x = np.minimum((middle[:, 0] * width).astype(np.int64), width - 1)
        y = np.minimum((middle[:, 1] * height).astype(np.int64), height - 1)
        return np.asarray(texture.pixels[y, x, :3])
    if part.colors is None:
        raise ArgumentError("labels: expected a mesh with pictures or colours of vertices, got neither")
    codes = np.searchsorted(CODES_BELOW, part.colors[:, :3]).astype(np.int64)
    packed = codes[:, 0] << 16 | codes[:, 1] << 8 | codes[:, 2]
    chosen = _majority(packed[part.faces])
    return np.stack([chosen >> 16, chosen >> 8 & 255, chosen & 255], axis=1).astype(np.uint8)
