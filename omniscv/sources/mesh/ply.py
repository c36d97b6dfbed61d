"""PLY files (Turk 1994): text or binary, little or big endian; faces of any number of corners."""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import shown
from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.sources.mesh.gltf import MOST_BYTES
from omniscv.sources.mesh.materials import LINEAR, Material
from omniscv.sources.mesh.model import Contents, Ints, Part, split_part
from omniscv.storage.bounded import read_bytes

_DTYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
_HEADER_BYTES = 1 << 20
_CORNERS = ("vertex_indices", "vertex_index")
_COLORS = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"))
_MATERIAL = Material("mesh")


@dataclass
class _Property:
    """A column of an element; of a list, ``count`` is the dtype of its length."""

    name: str
    dtype: str
    count: str = ""


@dataclass
class _Element:
    """A table of a file."""

    name: str
    rows: int
    properties: list[_Property] = field(default_factory=list)


@dataclass
class Ply:
    """What a file has of vertices and triangles.

    Attributes:
        vertices: (N, 3) float64.
        faces: (M, 3) triangles.
        colors: (N, 4) float32 linear RGBA, or None.
        face_values: by property of faces, (M,) of each triangle.
        vertex_values: by property of vertices, (N,).
        notes: what was left out, and how many of it.
    """

    vertices: Array
    faces: Ints
    colors: NDArray[np.float32] | None
    face_values: dict[str, NDArray[Any]]
    vertex_values: dict[str, NDArray[Any]]
    notes: Counter[str]


def read_ply(path: Path) -> Contents:
    """Return the triangles of a PLY file; one object for each ``object_id`` of its faces, else one."""
    ply = read_ply_arrays(path)
    ids = ply.face_values.get("object_id")
    part = ply_part(ply)
    if ids is None:
        return Contents([part], notes=ply.notes)
    names = {int(number): f"object_{int(number)}" for number in np.unique(ids)}
    return Contents(split_part(part, ids.astype(np.int64), names, "mesh"), notes=ply.notes)


def ply_part(ply: Ply) -> Part:
    """Return all triangles of a PLY file as one object."""
    return Part("mesh", ply.vertices, ply.faces, _MATERIAL, None, ply.colors)


def read_ply_arrays(path: Path) -> Ply:
    """Return the vertices and triangles of a PLY file; ArgumentError for a broken one."""
    data = read_bytes(path, MOST_BYTES)
    order, elements, offset = _header(data)
    tables: dict[str, dict[str, Any]] = {}
    words = data[offset:].split() if order == "" else []
    for element in elements:
        if order == "":
            tables[element.name], words = _text_rows(element, words)
        else:
            tables[element.name], offset = _binary_rows(element, data, offset, order)
    return _assembled(tables)


def _header(data: bytes) -> tuple[str, list[_Element], int]:
    """Return the order of bytes, the elements, and where their rows begin."""
    end = data.find(b"end_header", 0, _HEADER_BYTES)
    if not data.startswith(b"ply") or end < 0:
        raise ArgumentError("expected a PLY file with a header, got other bytes")
    offset = data.find(b"\n", end) + 1
    if offset == 0:
        raise ArgumentError("expected rows behind the header, got the end of the file")
    order = ""
    elements: list[_Element] = []
    for line in data[:end].decode("ascii", "replace").splitlines():
        words = line.split()
        match words:
            case ["format", name, *_]:
                if name not in _ORDERS:
                    raise ArgumentError(f"expected format {', '.join(_ORDERS)}, got {shown(name)}")
                order = _ORDERS[name]
            case ["element", name, rows]:
                if not rows.isdigit():
                    raise ArgumentError(f"element {name}: expected a number of rows, got {shown(rows)}")
                elements.append(_Element(name, int(rows)))
            case ["property", "list", count, dtype, name] if elements:
                elements[-1].properties.append(_Property(name, _dtype(dtype), _dtype(count)))
            case ["property", dtype, name] if elements:
                elements[-1].properties.append(_Property(name, _dtype(dtype)))
    return order, elements, offset


def _dtype(word: str) -> str:
    """Return NumPy's name of a type."""
    if word not in _DTYPES:
        raise ArgumentError(f"expected a property of {', '.join(_DTYPES)}, got {shown(word)}")
    return _DTYPES[word]


def _binary_rows(element: _Element, data: bytes, offset: int, order: str) -> tuple[dict[str, Any], int]:
    """Return the columns of a binary element, and where the next one begins.

    A list's column is its lengths and its values, joined. Rows of equal lists are read at once.
    """
    if element.rows > len(data):
        raise ArgumentError(f"element {element.name}: expected {element.rows} rows, got {len(data)} bytes")
    if element.rows == 0:
        return {}, offset
    if not any(column.count for column in element.properties):
        dtype = np.dtype([(str(i), order + column.dtype) for i, column in enumerate(element.properties)])
        rows = _rows(element, data, offset, dtype)
        columns = {column.name: rows[str(i)] for i, column in enumerate(element.properties)}
        return columns, offset + rows.nbytes
    return _rows_with_lists(element, data, offset, order)


def _rows(element: _Element, data: bytes, offset: int, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return the rows of an element that are all as long."""
    needed = element.rows * dtype.itemsize
    if offset + needed > len(data):
        expected = f"expected {element.rows} rows of {dtype.itemsize} bytes"
        raise ArgumentError(f"element {element.name}: {expected}, got {len(data) - offset} bytes")
    return np.frombuffer(data, dtype, element.rows, offset)


def _rows_with_lists(element: _Element, data: bytes, offset: int, order: str) -> tuple[dict[str, Any], int]:
    """Return the columns of an element with lists: rows of one shape at once, as long as they follow."""
    pieces: dict[str, list[Any]] = {column.name: [] for column in element.properties}
    lengths: dict[str, list[Any]] = {column.name: [] for column in element.properties if column.count}
    done = 0
    while done < element.rows:
        dtype, sizes = _row_type(element, data, offset, order)
        remaining = min(element.rows - done, (len(data) - offset) // max(1, dtype.itemsize))
        rows = np.frombuffer(data, dtype, min(remaining, _at_once(done)), offset)
        alike = np.ones(len(rows), np.bool_)
        for i, size in sizes.items():
            alike &= rows[f"n{i}"] == size
        count = len(rows) if alike.all() else int(np.argmin(alike))
        if count == 0:
            raise ArgumentError(f"element {element.name}: expected {element.rows} rows, got {done}")
        for i, column in enumerate(element.properties):
            pieces[column.name].append(rows[str(i)][:count].ravel())
            if column.count:
                lengths[column.name].append(np.full(count, sizes[i]))
        offset += count * dtype.itemsize
        done += count
    columns: dict[str, Any] = {}
    for column in element.properties:
        values = np.concatenate(pieces[column.name])
        if column.count:
            columns[column.name] = (np.concatenate(lengths[column.name]), values)
        else:
            columns[column.name] = values
    return columns, offset


def _at_once(done: int) -> int:
    """Return how many rows to try: few first, as rows of another shape may follow at once."""
    return max(64, done)


def _row_type(
    element: _Element, data: bytes, offset: int, order: str
) -> tuple[np.dtype[Any], dict[int, int]]:
    """Return the dtype of the row at an offset, and the lengths of its lists, by column."""
    fields: list[Any] = []
    sizes: dict[int, int] = {}
    end = offset
    for i, column in enumerate(element.properties):
        dtype = np.dtype(order + column.dtype)
        if not column.count:
            fields.append((str(i), dtype))
            end += dtype.itemsize
            continue
        count = np.dtype(order + column.count)
        if end + count.itemsize > len(data):
            raise ArgumentError(
                f"element {element.name}: expected {element.rows} rows, got the end of the file"
            )
        size = int(np.frombuffer(data, count, 1, end)[0])
        if not 0 <= size * dtype.itemsize <= len(data) - end:
            raise ArgumentError(f"element {element.name}: expected a list within the file, got {size} values")
        sizes[i] = size
        fields += [(f"n{i}", count), (str(i), dtype, (size,))]
        end += count.itemsize + size * dtype.itemsize
    return np.dtype(fields), sizes


def _text_rows(element: _Element, words: list[bytes]) -> tuple[dict[str, Any], list[bytes]]:
    """Return the columns of an element of text, and the words behind it."""
    if element.rows > len(words) + 1 and element.properties:
        raise ArgumentError(f"element {element.name}: expected {element.rows} rows, got {len(words)} words")
    values: dict[str, list[bytes]] = {column.name: [] for column in element.properties}
    lengths: dict[str, list[int]] = {column.name: [] for column in element.properties if column.count}
    place = 0
    try:
        for _ in range(element.rows if element.properties else 0):
            for column in element.properties:
                size = 1
                if column.count:
                    size = int(words[place])
                    lengths[column.name].append(size)
                    place += 1
                if size < 0 or place + size > len(words):
                    raise IndexError
                values[column.name] += words[place : place + size]
                place += size
        columns: dict[str, Any] = {}
        for column in element.properties:
            numbers = np.array(values[column.name], np.float64).astype(column.dtype)
            columns[column.name] = (np.array(lengths[column.name]), numbers) if column.count else numbers
    except (IndexError, ValueError, OverflowError) as cause:
        raise ArgumentError(
            f"element {element.name}: expected {element.rows} rows of numbers, got fewer"
        ) from cause
    return columns, words[place:]


def _assembled(tables: dict[str, dict[str, Any]]) -> Ply:
    """Return vertices and triangles of the tables of a file."""
    vertex = tables.get("vertex", {})
    face = tables.get("face", {})
    if not {"x", "y", "z"} <= vertex.keys():
        raise ArgumentError("expected vertices with x, y and z, got none")
    corners = next((face[name] for name in _CORNERS if name in face), None)
    if not isinstance(corners, tuple):
        raise ArgumentError("expected faces with lists of vertex_indices, got none")
    with np.errstate(invalid="ignore"):  # signalling NaN, which is left out later
        vertices = np.stack([vertex[axis].astype(np.float64) for axis in "xyz"], axis=1)
    lengths, indices = corners
    faces, owners = fans(lengths, indices.astype(np.int64))
    notes: Counter[str] = Counter()
    if few := int((lengths < 3).sum()):
        notes["faces of fewer than three corners"] = few
    face_values = {}
    for name, values in face.items():
        if not isinstance(values, tuple):
            face_values[name] = values[owners]
    plain = {name: values for name, values in vertex.items() if not isinstance(values, tuple)}
    return Ply(vertices, faces, _vertex_colors(vertex), face_values, plain, notes)


def fans(lengths: NDArray[Any], indices: Ints) -> tuple[Ints, Ints]:
    """Return (M, 3) triangles of polygons, as fans around their first corners, and (M,) each one's polygon.

    Args:
        lengths: (P,) how many corners each polygon has.
        indices: of all corners, joined.
    """
    counts = np.maximum(lengths.astype(np.int64) - 2, 0)
    owners = np.repeat(np.arange(len(lengths)), counts)
    first = np.cumsum(lengths) - lengths
    step = np.arange(len(owners)) - np.repeat(np.cumsum(counts) - counts, counts)
    start = first[owners].astype(np.int64)
    faces = np.stack([indices[start], indices[start + 1 + step], indices[start + 2 + step]], axis=1)
    return faces.reshape(-1, 3), owners


def _vertex_colors(vertex: dict[str, Any]) -> NDArray[np.float32] | None:
    """Return (N, 4) linear RGBA of vertices with colours in 8 bits of sRGB, or as fractions."""
    for names in _COLORS:
        if not set(names) <= vertex.keys():
            continue
        codes = np.stack([vertex[name] for name in names], axis=1)
        if codes.dtype.kind == "f":
            codes = np.round(255 * np.nan_to_num(codes).clip(0, 1))
        colors = np.ones((len(codes), 4), np.float32)
        colors[:, :3] = LINEAR[codes.astype(np.int64).clip(0, 255)]
        return colors
    return None
