"""Wavefront OBJ files and their MTL files: groups, materials, pictures."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv.arguments import shown
from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.sources.mesh.gltf import MOST_BYTES, file_beside
from omniscv.sources.mesh.materials import CLAMP, LINEAR, REPEAT, Material, Texture
from omniscv.sources.mesh.model import Contents, Ints, Part, plain_name
from omniscv.sources.mesh.pictures import Pictures
from omniscv.sources.mesh.ply import fans
from omniscv.storage.bounded import read_bytes

_PLAIN = Material("no_material")
_OPTIONS = {"-blendu": 1, "-blendv": 1, "-bm": 1, "-boost": 1, "-cc": 1, "-clamp": 1, "-imfchan": 1, "-mm": 2,
    "-o": 3, "-s": 3, "-t": 3, "-texres": 1, "-type": 1}  # fmt: skip
"""Options of pictures in MTL files, and how many words follow each at most."""


@dataclass
class _Group:
    """Faces of one object and one material: all corners' words, and how many each face has."""

    corners: list[str] = field(default_factory=list)
    lengths: list[int] = field(default_factory=list)
    counts: list[tuple[int, int]] = field(default_factory=list)
    """(vertices, texture coordinates) that were read before each face, for negative indices."""


class _Obj:
    """Lines of a file, gathered."""

    def __init__(self) -> None:
        self.vertices: list[str] = []
        self.uv: list[str] = []
        self.groups: dict[tuple[str, str], _Group] = {}
        self.libraries: list[str] = []
        self.notes: Counter[str] = Counter()
        self._name = "mesh"
        self._material = ""

    def read(self, lines: Iterator[str]) -> None:
        for line in lines:
            word, _, rest = line.partition(" ")
            if word == "v":
                self.vertices.append(rest)
            elif word == "vt":
                self.uv.append(rest)
            elif word == "f":
                self._add_face(rest.split())
            elif word in ("o", "g"):
                self._name = plain_name(rest) or "mesh"
            elif word == "usemtl":
                self._material = rest.strip()
            elif word == "mtllib":
                self.libraries.append(rest.strip())
            elif word in ("l", "p", "curv", "surf"):
                self.notes["points, lines or curved surfaces"] += 1

    def _add_face(self, corners: list[str]) -> None:
        key = (self._name, self._material)
        if key not in self.groups:
            self.groups[key] = _Group()
        group = self.groups[key]
        group.corners += corners
        group.lengths.append(len(corners))
        group.counts.append((len(self.vertices), len(self.uv)))


def read_obj(path: Path) -> Contents:
    """Return the triangles of an OBJ file; one object for each name of ``o`` or ``g``."""
    obj = _Obj()
    obj.read(_lines(read_bytes(path, MOST_BYTES).decode("utf-8", "replace")))
    materials = _Materials(path, obj.libraries)
    values = _floats(obj.vertices, "v", 3)
    vertices = values[:, :3]
    colors = None
    if values.shape[1] >= 6:
        codes = np.round(255 * np.nan_to_num(values[:, 3:6]).clip(0, 1)).astype(np.int64)
        colors = np.ones((len(codes), 4), np.float32)
        colors[:, :3] = LINEAR[codes]
    uv = _floats(obj.uv, "vt", 2)[:, :2]
    parts = []
    for (name, material), group in obj.groups.items():
        parts.append(_part(name, materials.get(material), group, vertices, uv, colors))
    return Contents(parts, notes=obj.notes + materials.notes)


def _lines(text: str) -> Iterator[str]:
    """Yield lines without comments; those that end with a backslash go on in the next one."""
    if "\\\n" in text or "\\\r\n" in text:
        text = text.replace("\\\r\n", " ").replace("\\\n", " ")
    for line in text.splitlines():
        yield line.partition("#")[0].strip().replace("\t", " ")


def _floats(lines: list[str], word: str, least: int) -> Array:
    """Return the numbers of lines of equal length, (N, at least ``least``)."""
    if not lines:
        return np.zeros((0, least))
    width = len(lines[0].split())
    try:
        values = np.array(" ".join(lines).split(), np.float64)
        if width < least or values.size != width * len(lines):
            return np.array([[float(number) for number in line.split()[:least]] for line in lines])
    except ValueError as cause:
        raise ArgumentError(f"{word}: expected {least} numbers a line, got: {str(cause)[:80]}") from cause
    return values.reshape(len(lines), width)


def _part(
    name: str,
    material: Material,
    group: _Group,
    vertices: Array,
    uv: Array,
    colors: NDArray[np.float32] | None,
) -> Part:
    """Return the triangles of a group, with a vertex for each pair of a position and a place in a picture."""
    before = np.repeat(np.array(group.counts, np.int64), group.lengths, axis=0)
    corners = _indices(group.corners)
    for column, count in ((0, len(vertices)), (1, len(uv))):
        negative = corners[:, column] < 0
        corners[negative, column] += before[negative, column] + 1
        present = corners[:, column] != 0 if column else np.ones(len(corners), np.bool_)
        wrong = present & ((corners[:, column] < 1) | (corners[:, column] > count))
        if wrong.any():
            got = int(corners[np.argmax(wrong), column])
            what = "texture coordinates" if column else "vertices"
            raise ArgumentError(f"{name}: expected indices of {count} {what}, got {got}")
    pairs, inverse = np.unique(corners, axis=0, return_inverse=True)
    faces, _ = fans(np.array(group.lengths), inverse.ravel())
    place = None
    if material.texture is not None and len(uv):
        place = np.concatenate([[[0.0, 1.0]], uv])[pairs[:, 1]]
        place = np.column_stack([place[:, 0], 1 - place[:, 1]]).astype(np.float32)
    own = None if colors is None else colors[pairs[:, 0] - 1]
    return Part(name, vertices[pairs[:, 0] - 1], faces, material, place, own)


def _indices(words: list[str]) -> Ints:
    """Return (N, 2) the position and the texture coordinate of corners such as ``7/3/1``; 0 for none."""
    try:
        if not any("/" in word for word in words):
            alone = np.array(words, np.int64)
            return np.stack([alone, np.zeros_like(alone)], axis=1)
        rows = []
        for word in words:
            position, _, rest = word.partition("/")
            place = rest.partition("/")[0]
            rows.append((int(position), int(place) if place else 0))
        return np.array(rows, np.int64).reshape(-1, 2)
    except (ValueError, OverflowError) as cause:
        raise ArgumentError(f"f: expected numbers of vertices, got: {str(cause)[:80]}") from cause


class _Materials:
    """The materials of the MTL files that an OBJ file names. Missing files are counted."""

    def __init__(self, path: Path, libraries: list[str]) -> None:
        self.notes: Counter[str] = Counter()
        self._path = path
        self._pictures = Pictures()
        self._textures: dict[tuple[str, int], Texture] = {}
        self._materials: dict[str, Material] = {}
        for name in libraries:
            try:
                library = file_beside(path, name)
            except ArgumentError as cause:
                if "nothing is fetched" in cause.message or "in its folder" in cause.message:
                    raise
                self.notes["MTL files that are missing"] += 1
                continue
            self._read(_lines(read_bytes(library, MOST_BYTES).decode("utf-8", "replace")))

    def get(self, name: str) -> Material:
        """Return a material; a white one where no file has it."""
        if not name:
            return _PLAIN
        if name not in self._materials:
            self.notes["materials that no MTL file has"] += 1
            self._materials[name] = Material(name)
        return self._materials[name]

    def _read(self, lines: Iterator[str]) -> None:
        current = Material()
        for line in lines:
            word, _, rest = line.partition(" ")
            if word == "newmtl":
                current = Material(rest.strip())
            elif word == "Kd":
                red, green, blue = _color(rest)
                current = replace(current, color=(red, green, blue, current.color[3]))
            elif word == "d":
                alpha = _number(rest.split()[-1:] or [""])
                current = replace(current, color=(*current.color[:3], alpha), blended=alpha < 1)
            elif word == "Tr":
                alpha = 1 - _number(rest.split()[:1] or [""])
                current = replace(current, color=(*current.color[:3], alpha), blended=alpha < 1)
            elif word == "map_Kd":
                current = replace(current, texture=self._texture(rest), color=(1, 1, 1, current.color[3]))
            if current.name:
                self._materials[current.name] = current

    def _texture(self, words: str) -> Texture:
        """Return the picture of a ``map_Kd``, whose options stand before its name."""
        name = words.strip()
        wrap = REPEAT
        while name.startswith("-"):
            parts = name.split()
            option = parts[0]
            if option not in _OPTIONS:
                raise ArgumentError(
                    f"map_Kd: expected options among {', '.join(_OPTIONS)}, got {shown(option)}"
                )
            if option in ("-o", "-s", "-t"):
                raise ArgumentError(f"map_Kd: expected a picture as it is, got option {option}")
            if option == "-clamp" and parts[1:2] == ["on"]:
                wrap = CLAMP
            name = " ".join(parts[1 + _OPTIONS[option] :])
        key = (name, wrap)
        if key not in self._textures:
            data = read_bytes(file_beside(self._path, name), MOST_BYTES)
            self._textures[key] = Texture(self._pictures.read(data, name), (wrap, wrap))
        return self._textures[key]


def _color(words: str) -> tuple[float, float, float]:
    """Return linear RGB of three codes of sRGB as fractions, which MTL files have."""
    parts: list[Any] = words.split()
    if len(parts) == 1:
        parts *= 3
    values = np.array([_number([part]) for part in parts[:3]])
    if len(values) != 3:
        raise ArgumentError(f"Kd: expected three numbers, got {shown(words)}")
    light = np.interp(values.clip(0, 1) * 255, np.arange(256), LINEAR)
    return float(light[0]), float(light[1]), float(light[2])


def _number(words: list[str]) -> float:
    """Return the number of a word."""
    try:
        return float(words[0])
    except ValueError as cause:
        raise ArgumentError(f"expected a number in an MTL file, got {shown(words[0])}") from cause
