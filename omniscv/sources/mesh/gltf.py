"""glTF 2.0 files, ``.glb`` and ``.gltf``: their JSON, and the arrays and pictures that it names.

Everything that the JSON claims is compared with the bytes that there are before memory is taken.
"""

import base64
import binascii
import struct
from pathlib import Path
from typing import Any
from urllib.parse import unquote_to_bytes

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import shown
from omniscv.errors import ArgumentError
from omniscv.sources.mesh import packed
from omniscv.storage.bounded import parse_json, read_bytes

MOST_BYTES = 1 << 32
"""Of a file, and of each file that it names."""
_MOST_NUMBERS = 1 << 30  # of an array that has no bytes in the file
_MAGIC = b"glTF"
_JSON = 0x4E4F534A
_BINARY = 0x004E4942
_DTYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}

KNOWN_EXTENSIONS = frozenset({
    "KHR_draco_mesh_compression", "KHR_mesh_quantization", "KHR_texture_transform", "KHR_materials_unlit",
    "KHR_texture_basisu", "EXT_texture_webp", "EXT_mesh_gpu_instancing", "EXT_meshopt_compression",
    "KHR_lights_punctual",
    *(f"KHR_materials_{name}" for name in (
        "clearcoat", "emissive_strength", "ior", "iridescence", "anisotropy", "sheen", "specular",
        "transmission", "volume", "variants", "dispersion", "pbrSpecularGlossiness",
    )),
})  # fmt: skip
"""Extensions whose files are read: they change nothing here, or what they change is read."""


class Gltf:
    """A glTF file.

    Attributes:
        path: of the file.
        document: its JSON.

    Raises:
        ArgumentError: no glTF 2.0, or one that requires an extension that is not read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._buffers: dict[int, bytes] = {}
        data = read_bytes(path, MOST_BYTES)
        self._binary: bytes | None = None
        if data[:4] == _MAGIC:
            text, self._binary = _chunks(data)
        else:
            text = data
        document = parse_json(text, len(text))
        if not isinstance(document, dict):
            raise ArgumentError("expected a JSON object of glTF, got another value")
        self.document: dict[str, Any] = document
        version = self.record(document, "asset").get("version")
        if not str(version).startswith("2."):
            raise ArgumentError(f"expected glTF 2.0, got version {shown(version)}")
        required = document.get("extensionsRequired", [])
        unknown = sorted(set(map(str, required)) - KNOWN_EXTENSIONS) if isinstance(required, list) else []
        if unknown:
            raise ArgumentError(f"expected a file without {unknown[0]}, which it requires")

    def item(self, kind: str, number: Any) -> dict[str, Any]:
        """Return one of the file's ``nodes``, ``meshes`` and so on; ArgumentError where it is not there."""
        items = self.document.get(kind, [])
        is_index = isinstance(number, int) and not isinstance(number, bool)
        if not is_index or not isinstance(items, list) or not 0 <= number < len(items):
            count = len(items) if isinstance(items, list) else 0
            raise ArgumentError(f"expected one of {count} {kind}, got {shown(number)}")
        if not isinstance(items[number], dict):
            raise ArgumentError(f"{kind} {number}: expected a JSON object, got {shown(items[number])}")
        return dict(items[number])

    def record(self, owner: dict[str, Any], key: str) -> dict[str, Any]:
        """Return an object in another one's JSON; an empty one where it is missing."""
        value = owner.get(key, {})
        if not isinstance(value, dict):
            raise ArgumentError(f"{key}: expected a JSON object, got {shown(value)}")
        return value

    def extension(self, owner: dict[str, Any], name: str) -> dict[str, Any] | None:
        """Return an extension of a JSON object; None where it has none of that name."""
        extensions = self.record(owner, "extensions")
        return self.record(extensions, name) if name in extensions else None

    def uri_bytes(self, uri: object) -> bytes:
        """Return the bytes of a URI: of a file in the same folder or below, or written in the URI itself."""
        if not isinstance(uri, str):
            raise ArgumentError(f"uri: expected a text, got {shown(uri)}")
        if uri.startswith("data:"):
            header, _, body = uri.partition(",")
            if not header.endswith(";base64"):
                return unquote_to_bytes(body)
            try:
                return base64.b64decode(body, validate=True)
            except binascii.Error as cause:
                raise ArgumentError(f"uri: expected base64, got {shown(body[:40])}") from cause
        return read_bytes(file_beside(self.path, unquote_to_bytes(uri).decode(errors="replace")), MOST_BYTES)

    def _buffer(self, number: Any) -> bytes:
        """Return the bytes of a buffer, which must be as many as it says."""
        if number in self._buffers:
            return self._buffers[number]
        buffer = self.item("buffers", number)
        data = self._binary if number == 0 and "uri" not in buffer else None
        if data is None:
            data = self.uri_bytes(buffer.get("uri"))
        size = buffer.get("byteLength")
        if not isinstance(size, int) or len(data) < size:
            raise ArgumentError(f"buffer {number}: expected {shown(size)} bytes, got {len(data)}")
        self._buffers[number] = data
        return data

    def view_bytes(self, number: Any) -> memoryview:
        """Return the bytes of a buffer view, unpacked where they are packed."""
        view = self.item("bufferViews", number)
        pack = self.extension(view, "EXT_meshopt_compression")
        if pack is not None:
            data = self._slice(pack, f"bufferView {number}")
            return memoryview(packed.unpack_meshopt(data, pack, f"bufferView {number}"))
        return self._slice(view, f"bufferView {number}")

    def _slice(self, owner: dict[str, Any], where: str) -> memoryview:
        """Return the bytes that a JSON object names by buffer, offset and length."""
        data = self._buffer(owner.get("buffer"))
        offset = owner.get("byteOffset", 0)
        size = owner.get("byteLength")
        if not (
            isinstance(offset, int) and isinstance(size, int) and 0 <= offset <= offset + size <= len(data)
        ):
            span = f"{shown(size)} from {shown(offset)}"
            raise ArgumentError(f"{where}: expected bytes within {len(data)}, got {span}")
        return memoryview(data)[offset : offset + size]

    def array(self, number: Any, where: str) -> NDArray[Any]:
        """Return the numbers of an accessor, (N, width) as they are stored, or as floats where they are
        normalized."""
        accessor = self.item("accessors", number)
        count = accessor.get("count")
        dtype = _DTYPES.get(accessor.get("componentType", 0))
        width = _WIDTHS.get(str(accessor.get("type")))
        if not isinstance(count, int) or count < 0 or dtype is None or width is None:
            raise ArgumentError(f"{where}: expected an accessor of numbers, got {shown(accessor)}")
        if "bufferView" in accessor:
            values = self._strided(accessor, count, np.dtype(dtype), width, where)
        else:
            if count * width > _MOST_NUMBERS:
                raise ArgumentError(f"{where}: expected at most {_MOST_NUMBERS} numbers, got {count * width}")
            values = np.zeros((count, width), dtype)
        if "sparse" in accessor:
            values = self._with_sparse(values, self.record(accessor, "sparse"), where)
        return _normalized(values) if accessor.get("normalized") else values

    def _strided(
        self, accessor: dict[str, Any], count: int, dtype: np.dtype[Any], width: int, where: str
    ) -> NDArray[Any]:
        """Return the numbers of an accessor in its buffer view."""
        view = self.item("bufferViews", accessor["bufferView"])
        data = self.view_bytes(accessor["bufferView"])
        size = dtype.itemsize * width
        pack = self.extension(view, "EXT_meshopt_compression")
        stride = (pack or view).get("byteStride", size) or size
        offset = accessor.get("byteOffset", 0)
        if not (isinstance(offset, int) and isinstance(stride, int) and offset >= 0 and stride >= size):
            got = f"{shown(stride)} from {shown(offset)}"
            raise ArgumentError(f"{where}: expected a stride of at least {size} bytes, got {got}")
        if count and offset + (count - 1) * stride + size > len(data):
            needed = offset + (count - 1) * stride + size
            raise ArgumentError(f"{where}: expected {needed} bytes of {count} values, got {len(data)}")
        if count == 0:
            return np.zeros((0, width), dtype)
        return np.ndarray((count, width), dtype, data, offset, (stride, dtype.itemsize))

    def _with_sparse(self, values: NDArray[Any], sparse: dict[str, Any], where: str) -> NDArray[Any]:
        """Return values of which some are replaced."""
        count = sparse.get("count")
        places = self.record(sparse, "indices")
        others = self.record(sparse, "values")
        index_type = _DTYPES.get(places.get("componentType", 0))
        if not isinstance(count, int) or count < 0 or index_type is None:
            raise ArgumentError(f"{where}: expected a sparse accessor, got {shown(sparse)}")
        one_index = {**places, "byteOffset": places.get("byteOffset", 0)}
        index = self._strided(one_index, count, np.dtype(index_type), 1, where)[:, 0]
        replaced = self._strided(others, count, values.dtype, values.shape[1], where)
        if count and int(index.max()) >= len(values):
            raise ArgumentError(f"{where}: expected indices below {len(values)}, got {int(index.max())}")
        result = values.copy()
        result[index] = replaced
        return result


def file_beside(path: Path, name: str) -> Path:
    """Return a file that another one names; ArgumentError unless it is in the same folder or below."""
    folder = path.parent.resolve()
    if "://" in name or name.startswith("//"):
        raise ArgumentError(f"expected files in its folder, got {shown(name)}; nothing is fetched")
    try:
        other = (folder / name.replace("\\", "/")).resolve()
    except (OSError, ValueError, RuntimeError) as cause:
        raise ArgumentError(f"expected the name of a file, got {shown(name)}") from cause
    if not other.is_relative_to(folder):
        raise ArgumentError(f"expected files in its folder, got {shown(name)}")
    if not other.is_file():
        raise ArgumentError(f"expected the file {shown(name)} beside it, got none")
    return other


def _chunks(data: bytes) -> tuple[bytes, bytes | None]:
    """Return the JSON and the binary chunk of a GLB file."""
    size = len(data)
    if size < 20:
        raise ArgumentError(f"expected a whole GLB file, got {size} bytes")
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise ArgumentError(f"expected GLB of version 2, got {version}")
    if length > size:
        raise ArgumentError(f"expected {length} bytes, got {size}: the file is cut off")
    texts: list[bytes] = []
    binary = None
    offset = 12
    while offset + 8 <= length:
        chunk_size, kind = struct.unpack_from("<II", data, offset)
        chunk = data[offset + 8 : offset + 8 + chunk_size]
        if len(chunk) < chunk_size:
            raise ArgumentError(f"expected a chunk of {chunk_size} bytes, got {len(chunk)}")
        if kind == _JSON:
            texts.append(chunk)
        elif kind == _BINARY and binary is None:
            binary = chunk
        offset += 8 + chunk_size
    if len(texts) != 1:
        raise ArgumentError(f"expected one chunk of JSON in GLB, got {len(texts)}")
    return texts[0], binary


def _normalized(values: NDArray[Any]) -> NDArray[Any]:
    """Return whole numbers as fractions of their range, as glTF 2.0, 3.6.2.2 has it."""
    if values.dtype.kind == "f":
        return values
    most = np.iinfo(values.dtype).max
    return np.maximum(values.astype(np.float64) / most, -1.0)
