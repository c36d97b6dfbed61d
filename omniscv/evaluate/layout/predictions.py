"""Layouts that other programs predicted, from files named like the panoramas, in any folder below one.

``NAME_EM.png`` and ``NAME_CM.png``  maps of edges and of corners as CFL writes them, of any size; or .jpg
``NAME.json``                        HorizonNet's: ``uv``, pairs of a ceiling's and a floor's corner, 0 to 1
``NAME.txt``                         lines ``x y`` of the same pairs, px of the panorama, as in ``label_cor``

Every panorama has the same forms; maps can come together with corners. Other files are ignored.
Sources: cfernandezlab/CFL test_CFL.py, sunset1995/HorizonNet inference.py and eval_general.py.
"""

import io
import json
from collections import defaultdict
from collections.abc import Iterable, Sequence
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from omniscv.arguments import numbers, shown, within
from omniscv.cameras import create
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.pose import Array
from omniscv.storage.bounded import decode_text, read_bytes
from omniscv.truth.layout_labels import Map, exact_maps, room_seen
from omniscv.truth.layout_record import project_layout

_SUFFIXES = {
    "edges": ("_EM.png", "_EM.jpg"), "corner_map": ("_CM.png", "_CM.jpg"), "corners": (".json", ".txt"),
}  # fmt: skip
_MOST_BYTES = 32 << 20
_MOST_PIXELS = 1 << 24


class Prediction(NamedTuple):
    """The predicted layout of one panorama.

    Attributes:
        corners: (2N, 2) px; see :mod:`omniscv.truth.layout_labels`.
        maps: (H, W) float64, 0 to 1, of edges and of corners.
    """

    corners: Array | None = None
    maps: tuple[Array, Array] | None = None


def read(folder: Path, names: Sequence[str], width: int) -> dict[str, Prediction]:
    """Return the predictions by the ``names`` of panoramas, from files in a ``folder`` and below.

    ``width`` is that of the panoramas, px.

    Raises:
        ArgumentError: a panorama lacks a file that others have, or has two of one form; a file is malformed.
    """
    files = {name: dict[str, Any]() for name in names}
    for form, paths in _find_files(folder, names).items():
        for name, path in paths.items():
            with within(f"predictions: {path.relative_to(folder)}"):
                files[name][form] = _read_corners(path, width) if form == "corners" else _read_map(path)
    predictions = dict[str, Prediction]()
    for name, forms in files.items():
        maps = (forms["edges"], forms["corner_map"]) if "edges" in forms else None
        predictions[name] = Prediction(forms.get("corners"), maps)
    return predictions


def draw_maps(corners: Array, width: int) -> tuple[Map, Map]:
    """Return the maps of edges and of corners of a room, drawn as the exact truth is, by its corners (2N, 2),
    px, in an upright panorama of a width, px; ArgumentError for corners of no room."""
    return exact_maps(_record(corners, width), create("equirectangular", width, width // 2))


def visible_curves(corners: Array, width: int) -> list[Array]:
    """Return the pieces of a room's edges that no wall hides, (P, 2) px.

    ``corners`` and ``width`` are as of :func:`draw_maps`.
    """
    curves = []
    for edge in _record(corners, width)["edges"]:
        for piece in edge["pieces"]:
            if piece["visible_room"]:
                curves.append(np.array(piece["pixels"]))
    return curves


def _record(corners: Array, width: int) -> dict[str, Any]:
    camera = create("equirectangular", width, width // 2)
    return project_layout(room_seen(corners, width, width // 2), camera, Pose.from_angles((0.0, 0.0, 0.0)))


def _find_files(folder: Path, names: Sequence[str]) -> dict[str, dict[str, Path]]:
    """Return the file of each panorama, by form and name."""
    by_name: dict[str, list[Path]] = defaultdict(list)
    for path in sorted(folder.rglob("*")):
        by_name[path.name].append(path)
    files: dict[str, dict[str, Path]] = defaultdict(dict)
    for form, name in product(_SUFFIXES, names):
        paths: list[Path] = []
        for suffix in _SUFFIXES[form]:
            paths += by_name.get(name + suffix, ())
        if len(paths) > 1:
            both = f"{paths[0].relative_to(folder)} and {paths[1].relative_to(folder)}"
            raise ArgumentError(f"predictions: expected one file of the {form} of {name}, got {both}")
        if paths:
            files[form][name] = paths[0]
    forms = set(files)
    if not forms:
        forms = {"corners"}
    elif forms != {"corners"}:
        forms |= {"edges", "corner_map"}
    for form in sorted(forms):
        missing = [name for name in names if name not in files[form]]
        if missing:
            expected = " or ".join(missing[0] + suffix for suffix in _SUFFIXES[form])
            lack = f"missing for {len(missing)} of the {len(names)} panoramas in layout/img"
            other = _other_file(by_name, names)
            raise ArgumentError(f"predictions: expected {expected}, {lack}; got {other}")
    return files


def _other_file(files: Iterable[str], names: Sequence[str]) -> str:
    """Return the first of some names of files that may be meant for a panorama but is named otherwise."""
    expected: set[str] = set()
    for suffixes in _SUFFIXES.values():
        for suffix in suffixes:
            expected.update(name + suffix for name in names)
    for file in files:
        if Path(file).suffix in (".png", ".jpg", ".json", ".txt") and file not in expected:
            return file
    return "no other file"


def _read_corners(path: Path, width: int) -> Array:
    """Return the corners (2N, 2), px, of a file; ArgumentError if no room has them."""
    content = read_bytes(path, _MOST_BYTES)
    try:
        if path.suffix == ".json":
            corners = numbers("uv", json.loads(decode_text(content))["uv"], (None, 2)) * [width, width // 2]
        else:
            lines = filter(str.strip, decode_text(content).splitlines())
            rows = list(map(str.split, lines))
            corners = numbers("lines", rows, (None, 2))
    except ArgumentError:
        raise
    except (ValueError, KeyError, TypeError, RecursionError) as cause:
        wanted = "a mapping with uv" if path.suffix == ".json" else "lines of two numbers"
        raise ArgumentError(f"expected {wanted}, got {shown(content[:40])}") from cause
    if (corners < -1).any() or (corners > [width + 1, width // 2 + 1]).any():
        farthest = corners[np.abs(corners / [width, width / 2] - 0.5).max(axis=1).argmax()]
        raise ArgumentError(f"expected corners within {width} x {width // 2} px, got {shown(farthest)}")
    room_seen(corners, width, width // 2)
    return corners


def _read_map(path: Path) -> Array:
    """Return a picture that is twice as wide as high, (H, W), 0 to 1."""
    from PIL import Image

    content = read_bytes(path, _MOST_BYTES)
    try:
        with Image.open(io.BytesIO(content)) as picture:
            width, height = picture.size
            if width != 2 * height or width * height > _MOST_PIXELS:
                raise ArgumentError(f"expected 2:1, of at most {_MOST_PIXELS} pixels, got {width} x {height}")
            deep = picture.mode.startswith("I")
            pixels = np.asarray(picture if deep else picture.convert("L"), np.float64)
    except ArgumentError:
        raise
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as cause:
        raise ArgumentError(f"expected a PNG or JPEG picture, got {shown(content[:20])}") from cause
    return pixels / (65535 if deep else 255)
