"""Triangles of a world, in arrays: what readers of files return, put together in metres and world axes."""

import hashlib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.sources.mesh.materials import Material
from omniscv.sources.mesh.settings import METRES, Settings

Ints = NDArray[np.int64]
Floats32 = NDArray[np.float32]

MOST_OBJECTS = 0xFFFF
_FAR = 1e12
"""Coordinates that are larger are no numbers of a mesh."""
_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""World axes from those of a file whose y points up."""


@dataclass(frozen=True)
class Part:
    """Triangles of one object and one material, as a reader returns them, in the file's axes and unit.

    Attributes:
        name: of the object; parts of one name are one object.
        vertices: (N, 3) float64.
        faces: (M, 3) indices of vertices, counter-clockwise seen from the front.
        material: what the faces show.
        uv: (N, 2) float32, or None: across and down the picture from its upper left corner, in widths and
            heights.
        colors: (N, 4) float32 linear RGBA that the material's is multiplied by, or None.
    """

    name: str
    vertices: Array
    faces: Ints
    material: Material
    uv: Floats32 | None = None
    colors: Floats32 | None = None


@dataclass
class Contents:
    """What a file holds.

    Attributes:
        parts: its triangles.
        y_up: whether its y axis points up by the rules of its format.
        notes: what was left out, by what it is, and how many of it.
        colorless: why colours cannot be shown; empty where they can.
    """

    parts: list[Part]
    y_up: bool = False
    notes: Counter[str] = field(default_factory=Counter)
    colorless: str = ""


@dataclass(frozen=True, eq=False)
class Model:
    """A world of triangles.

    Attributes:
        vertices: (N, 3) float64 metres, world frame.
        faces: (M, 3) int32.
        label: (M,) uint16 of each face's object: 1 + its place among the sorted names.
        names: of the objects, sorted.
        material: (M,) int32 of each face.
        uv: (N, 2) float32.
        colors: (N, 4) float32 linear RGBA.
        materials: by number.
        notes: what was left out, and how many of it.
        colorless: why colours cannot be shown; empty where they can.
    """

    vertices: Array
    faces: NDArray[np.int32]
    label: NDArray[np.uint16]
    names: tuple[str, ...]
    material: NDArray[np.int32]
    uv: Floats32
    colors: Floats32
    materials: tuple[Material, ...]
    notes: Counter[str]
    colorless: str

    @classmethod
    def of(cls, contents: Contents, settings: Settings) -> "Model":
        """Return the world of a file's contents; ArgumentError where they have no triangle."""
        notes = Counter(contents.notes)
        parts = []
        for part in contents.parts:
            faces = _sound_faces(part, notes)
            if len(faces):
                parts.append((part, faces))
        if not parts:
            left_out = ", ".join(f"{count} {what}" for what, count in sorted(notes.items()))
            raise ArgumentError(f"expected triangles, got none{f' ({left_out})' if left_out else ''}")
        names = [_object_name(part, settings) for part, _ in parts]
        ranks = {name: 1 + rank for rank, name in enumerate(sorted(set(names)))}
        if len(ranks) > MOST_OBJECTS:
            advice = "" if settings.labels == "material" else "; write labels=material"
            raise ArgumentError(f"expected at most {MOST_OBJECTS} objects, got {len(ranks)}{advice}")
        materials = list({id(part.material): part.material for part, _ in parts}.values())
        numbers = {id(material): number for number, material in enumerate(materials)}
        counts = [len(faces) for _, faces in parts]
        return cls(
            vertices=_joined(part.vertices for part, _ in parts) @ _world_axes(contents, settings).T,
            faces=_joined_faces(parts),
            label=np.repeat(np.array([ranks[name] for name in names], np.uint16), counts),
            names=tuple(ranks),
            material=np.repeat(np.array([numbers[id(part.material)] for part, _ in parts], np.int32), counts),
            uv=_joined(_or_constant(part.uv, part, [0, 0]) for part, _ in parts),
            colors=_joined(_or_constant(part.colors, part, [1, 1, 1, 1]) for part, _ in parts),
            materials=tuple(materials),
            notes=notes,
            colorless=contents.colorless,
        )


def split_part(part: Part, numbers: Ints, names: Mapping[int, str], otherwise: str) -> list[Part]:
    """Return one part for each object.

    Args:
        part: triangles of several objects.
        numbers: (M,) the number of each triangle's object.
        names: of the objects, by number.
        otherwise: the name of triangles of other numbers.
    """
    _check_indices(part)
    if not len(part.faces):
        return []
    order = np.argsort(numbers, kind="stable")
    unique, starts = np.unique(numbers[order], return_index=True)
    parts = []
    for number, rows in zip(unique.tolist(), np.split(order, starts[1:]), strict=True):
        used, faces = np.unique(part.faces[rows], return_inverse=True)
        parts.append(
            replace(
                part,
                name=names.get(number, otherwise),
                vertices=part.vertices[used],
                faces=faces.reshape(-1, 3),
                uv=None if part.uv is None else part.uv[used],
                colors=None if part.colors is None else part.colors[used],
            )
        )
    return parts


def plain_name(name: str) -> str:
    """Return a name as commands of UnrealCV can say it: without spaces and controls."""
    return "_".join("".join(c if c.isprintable() else " " for c in name).split())


class Names:
    """Names of objects that are each used once: the second Lamp is Lamp#2."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()

    def unique(self, name: str, otherwise: str) -> str:
        """Return a plain name that was not returned before; of an empty one, ``otherwise``."""
        plain = plain_name(name) or otherwise
        self._counts[plain] += 1
        count = self._counts[plain]
        if count == 1:
            return plain
        return self.unique(f"{plain}#{count}", otherwise)


def digest(model: Model) -> str:
    """Return a digest of all that a world shows."""
    sha = hashlib.sha256(repr(model.names).encode())
    for array in (model.vertices, model.faces, model.label, model.material, model.uv, model.colors):
        sha.update(np.ascontiguousarray(array).data)
    for material in model.materials:
        texture = material.texture
        sha.update(repr(replace(material, texture=None)).encode())
        if texture is not None:
            sha.update(repr((texture.pixels.shape, texture.wrap, texture.nearest)).encode())
            sha.update(np.ascontiguousarray(texture.pixels).data)
    return sha.hexdigest()


def open_edges(model: Model) -> int:
    """Return how many edges bound one face alone, so that there is a hole beside it; places count, not names.

    Vertices are compared by 64 bits of a digest of their coordinates.
    """
    bits = np.ascontiguousarray(model.vertices + 0.0).view(np.uint64)  # + 0.0: no negative zero
    codes = _mixed(bits[:, 0])
    for axis in (1, 2):
        codes = _mixed(codes + bits[:, axis])
    corners = codes[model.faces]
    edges = [corners[:, k] + corners[:, (k + 1) % 3] for k in range(3)]
    _, counts = np.unique(np.concatenate(edges), return_counts=True)
    return int((counts == 1).sum())


def _mixed(values: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return 64 bits that depend on all bits of each value (the finalizer of MurmurHash3, Appleby)."""
    for odd in (0xFF51AFD7ED558CCD, 0xC4CEB9FE1A85EC53):
        values = (values ^ values >> np.uint64(33)) * np.uint64(odd)
    return values ^ values >> np.uint64(33)


def _object_name(part: Part, settings: Settings) -> str:
    """Return the name of the object that a part belongs to."""
    if settings.labels == "material":
        return plain_name(part.material.name) or "no_material"
    return part.name


def _world_axes(contents: Contents, settings: Settings) -> Array:
    """Return (3, 3) from the file's axes and unit to the world's."""
    y_up = contents.y_up if settings.up == "auto" else settings.up == "y"
    return METRES[settings.unit] * (_Y_UP if y_up else np.eye(3))


def _check_indices(part: Part) -> None:
    """Raise ArgumentError where a face has a vertex that is not there."""
    if len(part.faces) and not (part.faces.min() >= 0 and part.faces.max() < len(part.vertices)):
        worst = int(max(part.faces.max(), -part.faces.min()))
        count = len(part.vertices)
        raise ArgumentError(f"{part.name}: expected indices of {count} vertices, got {worst}")


def _sound_faces(part: Part, notes: Counter[str]) -> Ints:
    """Return the faces whose vertices exist, are finite and span an area; count the others."""
    _check_indices(part)
    finite = np.count_nonzero(np.abs(part.vertices) < _FAR, axis=1) == 3
    faces = part.faces
    if not finite.all():
        kept = finite[faces].all(axis=1)
        notes["triangles with vertices that are no numbers"] += int((~kept).sum())
        faces = faces[kept]
    a, b, c = part.vertices[faces].swapaxes(0, 1)
    flat = np.count_nonzero(np.cross(b - a, c - a), axis=1) == 0
    if flat.any():
        notes["triangles without area"] += int(flat.sum())
        faces = faces[~flat]
    return faces


def _joined(arrays: Iterable[NDArray[Any]]) -> NDArray[Any]:
    return np.concatenate(list(arrays))


def _joined_faces(parts: Sequence[tuple[Part, Ints]]) -> NDArray[np.int32]:
    """Return the faces of all parts, counted through."""
    first = 0
    faces = []
    for part, own in parts:
        faces.append((own + first).astype(np.int32))
        first += len(part.vertices)
    return np.concatenate(faces)


def _or_constant(values: Floats32 | None, part: Part, constant: Sequence[float]) -> Floats32:
    """Return the values of a part's vertices, a constant where it has none."""
    if values is not None:
        return values
    return np.broadcast_to(np.asarray(constant, np.float32), (len(part.vertices), len(constant)))
