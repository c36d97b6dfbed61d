"""The tree of nodes of glTF files: where their meshes stand, and what objects they are."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from omniscv.arguments import numbers, shown
from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.sources.mesh.gltf import Gltf
from omniscv.sources.mesh.gltf_materials import Coverings
from omniscv.sources.mesh.model import Contents, Names, Part
from omniscv.sources.mesh.packed import unpack_draco

_TRIANGLES = 4
_STRIP = 5
_FAN = 6
_MOST_NODES = 1 << 20
_MOST_TRIANGLES = 1 << 28


def read_gltf(path: Path) -> Contents:
    """Return the triangles of a glTF file, in the file's axes; ArgumentError for a broken one."""
    return _Reader(Gltf(path)).read()


class _Reader:
    """Reader of one file: each primitive is unpacked once, and stands wherever nodes name it."""

    def __init__(self, gltf: Gltf) -> None:
        self._gltf = gltf
        self._coverings = Coverings(gltf)
        self._parts: dict[tuple[int, int], Part | None] = {}
        self._notes: Counter[str] = Counter()
        self._triangles = 0

    def read(self) -> Contents:
        parts = []
        names = Names()
        for number, node, matrix in self._nodes():
            if "mesh" not in node:
                continue
            mesh = self._gltf.item("meshes", node["mesh"])
            name = str(node.get("name") or mesh.get("name") or "")
            object_name = names.unique(name, f"node_{number}")
            self._check_rigid(node, mesh, object_name)
            for placed in self._instances(node, matrix):
                for part in self._of_mesh(node["mesh"], mesh):
                    parts.append(_placed(part, object_name, placed))
        return Contents(parts, True, self._notes, self._coverings.colorless)

    def _nodes(self) -> Iterator[tuple[int, dict[str, Any], Array]]:
        """Yield the nodes of the scene, with their place in the world, in the order of the file's tree."""
        pending = [(number, np.eye(4)) for number in reversed(self._roots())]
        seen: set[int] = set()
        while pending:
            number, parent = pending.pop()
            node = self._gltf.item("nodes", number)
            if number in seen or len(seen) > _MOST_NODES:
                raise ArgumentError(f"node {number}: expected a tree of nodes, got it twice")
            seen.add(number)
            matrix = parent @ _matrix(node, f"node {number}")
            yield number, node, matrix
            children = node.get("children", [])
            if not isinstance(children, list):
                raise ArgumentError(f"node {number}: expected a list of children, got {shown(children)}")
            for child in reversed(children):
                pending.append((child, matrix))

    def _roots(self) -> list[Any]:
        """Return the numbers of the scene's nodes; without a scene, of those that are nobody's children."""
        document = self._gltf.document
        if document.get("scenes"):
            scene = self._gltf.item("scenes", document.get("scene", 0))
            roots = scene.get("nodes", [])
            return roots if isinstance(roots, list) else []
        nodes = document.get("nodes", [])
        if not isinstance(nodes, list):
            return []
        children: set[int] = set()
        for number in range(len(nodes)):
            node = self._gltf.item("nodes", number)
            children.update(child for child in node.get("children", []) if isinstance(child, int))
        return [number for number in range(len(nodes)) if number not in children]

    def _check_rigid(self, node: dict[str, Any], mesh: dict[str, Any], name: str) -> None:
        """Raise ArgumentError for a mesh whose vertices its node does not place alone."""
        if "skin" in node:
            raise ArgumentError(f"{name}: expected a rigid mesh, got a skin; apply its pose before export")
        weights = node.get("weights", mesh.get("weights", []))
        if isinstance(weights, list) and any(weight != 0 for weight in weights):
            raise ArgumentError(f"{name}: expected a rigid mesh, got morph targets; apply them before export")

    def _instances(self, node: dict[str, Any], matrix: Array) -> list[Array]:
        """Return where a node's mesh stands: once, or as EXT_mesh_gpu_instancing says."""
        instancing = self._gltf.extension(node, "EXT_mesh_gpu_instancing")
        if instancing is None:
            return [matrix]
        attributes = self._gltf.record(instancing, "attributes")
        arrays = {}
        for key in ("TRANSLATION", "ROTATION", "SCALE"):
            if key in attributes:
                arrays[key] = self._gltf.array(attributes[key], key).astype(np.float64)
        if len({len(values) for values in arrays.values()}) != 1:
            raise ArgumentError("EXT_mesh_gpu_instancing: expected as many of each attribute, got others")
        count = len(next(iter(arrays.values())))
        placed = []
        for i in range(count):
            one = {key.lower(): values[i].tolist() for key, values in arrays.items()}
            placed.append(matrix @ _matrix(one, f"instance {i}"))
        return placed

    def _of_mesh(self, number: int, mesh: dict[str, Any]) -> list[Part]:
        """Return the parts of a mesh that have triangles."""
        primitives = mesh.get("primitives", [])
        if not isinstance(primitives, list):
            raise ArgumentError(f"mesh {number}: expected a list of primitives, got {shown(primitives)}")
        parts = []
        for index, primitive in enumerate(primitives):
            if (number, index) not in self._parts:
                where = f"mesh {number}, primitive {index}"
                if not isinstance(primitive, dict):
                    raise ArgumentError(f"{where}: expected a JSON object, got {shown(primitive)}")
                self._parts[number, index] = self._primitive(primitive, where)
            part = self._parts[number, index]
            if part is not None:
                self._triangles += len(part.faces)
                if self._triangles > _MOST_TRIANGLES:
                    raise ArgumentError(f"expected at most {_MOST_TRIANGLES} triangles, got more")
                parts.append(part)
        return parts

    def _primitive(self, primitive: dict[str, Any], where: str) -> Part | None:
        """Return the triangles of a primitive; None for points and lines, which are counted."""
        mode = primitive.get("mode", _TRIANGLES)
        if mode not in (_TRIANGLES, _STRIP, _FAN):
            self._notes["primitives of points or lines"] += 1
            return None
        attributes = self._gltf.record(primitive, "attributes")
        if "POSITION" not in attributes:
            self._notes["primitives without positions"] += 1
            return None
        indices, arrays = self._unpacked(primitive, attributes, where)
        vertices = self._attribute("POSITION", attributes, arrays, where)
        if vertices.shape[1] != 3:
            raise ArgumentError(f"{where}: expected positions of 3 numbers, got {vertices.shape[1]}")
        covering = self._coverings.get(primitive.get("material"))
        uv = None
        key = f"TEXCOORD_{covering.uv_set}"
        if covering.material.texture is not None and key in attributes:
            uv = self._attribute(key, attributes, arrays, where).astype(np.float64)
            self._check_length(uv, 2, vertices, where)
            if covering.uv_transform is not None:
                uv = uv @ covering.uv_transform[:, :2].T + covering.uv_transform[:, 2]
        colors = None
        if "COLOR_0" in attributes:
            colors = self._colors(self._attribute("COLOR_0", attributes, arrays, where), vertices, where)
        if indices is None:
            indices = np.arange(len(vertices))
        with np.errstate(invalid="ignore"):  # signalling NaN, which is left out later
            vertices = vertices.astype(np.float64)
        return Part(
            "",
            vertices,
            _triangles(indices, mode, where),
            covering.material,
            None if uv is None else np.nan_to_num(uv).astype(np.float32),
            colors,
        )

    def _unpacked(
        self, primitive: dict[str, Any], attributes: dict[str, Any], where: str
    ) -> tuple[NDArray[Any] | None, dict[str, Any]]:
        """Return the indices of a primitive, and what Draco has packed of its attributes."""
        draco = self._gltf.extension(primitive, "KHR_draco_mesh_compression")
        if draco is not None:
            packed = self._gltf.record(draco, "attributes")
            faces, arrays = unpack_draco(self._gltf.view_bytes(draco.get("bufferView")), packed, where)
            return faces.ravel(), arrays
        if "indices" not in primitive:
            return None, {}
        return self._gltf.array(primitive["indices"], where)[:, 0], {}

    def _attribute(
        self, name: str, attributes: dict[str, Any], arrays: dict[str, Any], where: str
    ) -> NDArray[Any]:
        """Return the values of an attribute, unpacked already or of its accessor."""
        if name not in arrays:
            return self._gltf.array(attributes[name], f"{where}, {name}")
        accessor = self._gltf.item("accessors", attributes[name])
        values = arrays[name]
        if accessor.get("normalized") and values.dtype.kind != "f":
            return np.asarray(values / np.iinfo(values.dtype).max)
        return np.asarray(values)

    def _colors(self, values: NDArray[Any], vertices: Array, where: str) -> NDArray[np.float32]:
        """Return linear RGBA of vertices that have RGB or RGBA."""
        self._check_length(values, min(values.shape[1], 4), vertices, where)
        colors = np.ones((len(vertices), 4), np.float32)
        colors[:, : values.shape[1]] = np.nan_to_num(values)
        return colors

    def _check_length(self, values: NDArray[Any], width: int, vertices: Array, where: str) -> None:
        """Raise ArgumentError where an attribute has not one row for each vertex."""
        if values.shape != (len(vertices), width):
            expected = f"expected {len(vertices)} x {width} numbers, one row for each vertex"
            raise ArgumentError(f"{where}: {expected}, got {values.shape[0]} x {values.shape[1]}")


def _triangles(indices: NDArray[Any], mode: int, where: str) -> NDArray[np.int64]:
    """Return (M, 3) triangles of a list, a strip or a fan of vertices (glTF 2.0, 3.7.2.1)."""
    order = indices.astype(np.int64)
    if mode == _TRIANGLES:
        if len(order) % 3:
            raise ArgumentError(f"{where}: expected three vertices of each triangle, got {len(order)} in all")
        return order.reshape(-1, 3)
    count = max(0, len(order) - 2)
    places = np.arange(count)
    if mode == _FAN:
        return np.stack([order[places + 1], order[places + 2], np.full(count, order[0])], axis=1)
    odd = places % 2
    return np.stack([order[places], order[places + 1 + odd], order[places + 2 - odd]], axis=1)


def _matrix(node: dict[str, Any], where: str) -> Array:
    """Return (4, 4) of a node in its parent: its matrix, or its translation, rotation and scale."""
    if "matrix" in node:
        return numbers(f"{where}: matrix", node["matrix"], (16,)).reshape(4, 4).T
    result = np.eye(4)
    quaternion = numbers(f"{where}: rotation", node.get("rotation", [0, 0, 0, 1]), (4,))
    length = float(np.linalg.norm(quaternion))
    if not length > 0:
        raise ArgumentError(f"{where}: expected a rotation of length 1, got {shown(quaternion.tolist())}")
    scale = numbers(f"{where}: scale", node.get("scale", [1, 1, 1]), (3,))
    result[:3, :3] = Rotation.from_quat(quaternion / length).as_matrix() * scale
    result[:3, 3] = numbers(f"{where}: translation", node.get("translation", [0, 0, 0]), (3,))
    return result


def _placed(part: Part, name: str, matrix: Array) -> Part:
    """Return a part where a node puts it; one that is mirrored keeps its front."""
    faces = part.faces
    if np.linalg.det(matrix[:3, :3]) < 0:
        faces = faces[:, ::-1]
    vertices = part.vertices @ matrix[:3, :3].T + matrix[:3, 3]
    return Part(name, vertices, faces, part.material, part.uv, part.colors)
