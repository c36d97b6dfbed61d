"""Files of meshes: the reader of each form, by the end of its name."""

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np

from omniscv.errors import ArgumentError, SourceError
from omniscv.sources.mesh.gltf import MOST_BYTES, file_beside
from omniscv.sources.mesh.gltf_nodes import read_gltf
from omniscv.sources.mesh.materials import Material
from omniscv.sources.mesh.model import Contents, Part
from omniscv.sources.mesh.ply import read_ply
from omniscv.sources.mesh.semantics import REPLICA_NAMES, read_labelled
from omniscv.sources.mesh.settings import WORDS
from omniscv.sources.mesh.wavefront import read_obj
from omniscv.storage.bounded import read_bytes


def read_mesh(path: Path, labels: str) -> Contents:
    """Return the triangles of a file.

    Args:
        path: of the file.
        labels: ``object``, ``material``, or the name of a file in the same folder that names the objects.

    Raises:
        ArgumentError: no file, one of another form, or a broken one.
        SourceError: the package that reads its form is not installed.
    """
    if not path.is_file():
        raise ArgumentError("expected a file, got none of that name")
    suffix = path.suffix.lower()
    if labels not in WORDS:
        return read_labelled(path, file_beside(path, labels))
    replica = path.with_name(REPLICA_NAMES)
    if labels == "object" and path.name == _REPLICA_MESH and replica.is_file():
        return read_labelled(path, replica)
    return _READERS.get(suffix, _read_by_trimesh)(path)


def _read_by_trimesh(path: Path) -> Contents:
    """Return the triangles of a form that trimesh reads, such as STL and OFF: one white object."""
    try:
        import trimesh
    except ImportError as cause:
        raise SourceError("expected trimesh to read this form; install omniscv[mesh]") from cause
    suffix = path.suffix.lower()
    if suffix[1:] not in trimesh.available_formats() or suffix in _ARCHIVES:
        known = f"{', '.join(_READERS)}, .stl, .off or another form that trimesh reads"
        raise ArgumentError(f"expected a file of {known}, got {suffix or 'no ending'}")
    data = read_bytes(path, MOST_BYTES)
    try:
        mesh = trimesh.load_mesh(io.BytesIO(data), file_type=suffix[1:], process=False)
        vertices = np.array(mesh.vertices, np.float64).reshape(-1, 3)
        faces = np.array(mesh.faces, np.int64).reshape(-1, 3)
    except Exception as cause:  # its readers raise what they meet
        raise ArgumentError(f"expected {path.suffix} of triangles, got: {str(cause)[:100]}") from cause
    return Contents([Part("mesh", vertices, faces, Material("mesh"))])


_READERS: dict[str, Callable[[Path], Contents]] = {
    ".glb": read_gltf,
    ".gltf": read_gltf,
    ".ply": read_ply,
    ".obj": read_obj,
}
_REPLICA_MESH = "mesh_semantic.ply"
_ARCHIVES = (".zip", ".tar.gz", ".tar.bz2", ".bz2", ".gz")
