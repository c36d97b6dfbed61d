"""Geometry that is packed in glTF files: Draco and meshopt."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import one_of, whole_number
from omniscv.errors import ArgumentError, SourceError

_MOST_BYTES = 1 << 32
_FILTERS = ("NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL", "COLOR")
_MODES = ("ATTRIBUTES", "TRIANGLES", "INDICES")


def unpack_meshopt(data: memoryview, pack: dict[str, Any], where: str) -> bytes:
    """Return the plain bytes of a buffer view that EXT_meshopt_compression packed.

    Args:
        data: the packed bytes.
        pack: the extension's JSON: count, stride, mode and filter.
        where: the view, for messages.

    Raises:
        ArgumentError: bytes that are not packed so.
        SourceError: meshopt is not installed.
    """
    try:
        import meshopt
    except ImportError as cause:
        raise SourceError(f"{where}: expected meshopt to read its geometry; install omniscv[mesh]") from cause
    count = whole_number(f"{where}: count", pack.get("count"), least=0)
    stride = whole_number(f"{where}: byteStride", pack.get("byteStride"), most=256)
    if count * stride > _MOST_BYTES:
        raise ArgumentError(f"{where}: expected at most {_MOST_BYTES} bytes, got {count * stride}")
    mode = one_of(f"{where}: mode", pack.get("mode"), _MODES)
    filtered = one_of(f"{where}: filter", pack.get("filter", "NONE"), _FILTERS)
    try:
        values = meshopt.decode_gltf_buffer(bytes(data), count, stride, mode, filtered)
    except Exception as cause:  # of a module of C++, which has errors of its own
        raise ArgumentError(f"{where}: expected geometry of meshopt, got: {str(cause)[:100]}") from cause
    return np.ascontiguousarray(values).tobytes()


def unpack_draco(
    data: memoryview, attributes: dict[str, int], where: str
) -> tuple[NDArray[Any], dict[str, Any]]:
    """Return the faces (M, 3) and the vertices' arrays of a mesh that Draco packed.

    Args:
        data: the packed bytes.
        attributes: Draco's number of each attribute by glTF's name.
        where: the mesh, for messages.

    Raises:
        ArgumentError: bytes that are no mesh of Draco.
        SourceError: DracoPy is not installed.
    """
    try:
        import DracoPy
    except ImportError as cause:
        raise SourceError(f"{where}: expected DracoPy to read Draco; install omniscv[mesh]") from cause
    try:
        mesh = DracoPy.decode(bytes(data))
        faces = np.asarray(mesh.faces).reshape(-1, 3)
        arrays = {}
        for name, number in attributes.items():
            attribute = mesh.get_attribute_by_unique_id(number)
            if attribute is not None:
                arrays[name] = np.asarray(attribute["data"])
    except (ValueError, TypeError, AttributeError, DracoPy.FileTypeException) as cause:
        raise ArgumentError(f"{where}: expected a mesh of Draco, got: {str(cause)[:100]}") from cause
    return faces, arrays
