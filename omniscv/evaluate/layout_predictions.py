"""Layouts that other programs predicted, from files named like the panoramas, in any folder below one.

``NAME_EM.png`` and ``NAME_CM.png``  maps of edges and of corners as CFL writes them, of any size; or .jpg
``NAME.json``                        HorizonNet's: ``uv``, pairs of a ceiling's and a floor's corner, 0 to 1
``NAME.txt``                         lines ``x y`` of the same pairs, px of the panorama, as in ``label_cor``

Every panorama has the same forms; maps can come together with corners. Other files are left alone.
Sources: cfernandezlab/CFL test_CFL.py, sunset1995/HorizonNet inference.py and eval_general.py.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from omniscv.arguments import numbers, shown, within
from omniscv.errors import ArgumentError
from omniscv.geometry.pose import Array
from omniscv.storage.bounded import read_bytes
from omniscv.truth.cor_id import room_seen

_FORMS = {
    "edges": ("_EM.png", "_EM.jpg"),
    "corner_map": ("_CM.png", "_CM.jpg"),
    "corners": (".json", ".txt"),
}
_MOST_BYTES = 32 << 20
_MOST_PIXELS = 1 << 24


class Prediction(NamedTuple):
    """Of one panorama.

    Attributes:
        corners: (2N, 2) px; see :mod:`omniscv.truth.cor_id`.
        maps: (H, W) float64, 0 to 1, of edges and of corners.
    """

    corners: Array | None = None
    maps: tuple[Array, Array] | None = None


def read(folder: Path, names: Sequence[str], width: int) -> dict[str, Prediction]:
    """Return the predictions for panoramas of a width, px, by name.

    Raises:
        ArgumentError: a panorama without a file that others have, two files for one, or a file
            that is none of the forms.
    """
    found = {}
    for name, files in _files(folder, names).items():
        parts = {}
        for form, path in files.items():
            with within(f"predictions: {path.relative_to(folder)}"):
                parts[form] = _corners(path, width) if form == "corners" else _map(path)
        maps = (parts["edges"], parts["corner_map"]) if "edges" in parts else None
        found[name] = Prediction(parts.get("corners"), maps)
    return found


def _files(folder: Path, names: Sequence[str]) -> Mapping[str, Mapping[str, Path]]:
    """By panorama and form, the file."""
    owner = {
        name + suffix: (name, form) for name in names for form, ends in _FORMS.items() for suffix in ends
    }
    found: dict[str, dict[str, Path]] = {name: {} for name in names}
    strange = None
    for path in sorted(folder.rglob("*")):
        if path.name in owner:
            name, form = owner[path.name]
            if other := found[name].get(form):
                got = f"{other.relative_to(folder)} and {path.relative_to(folder)}"
                raise ArgumentError(f"predictions: expected one file of the {form} of {name}, got {got}")
            found[name][form] = path
        elif path.suffix in (".png", ".jpg", ".json", ".txt"):
            strange = path.name
    forms = {form for parts in found.values() for form in parts} or {"corners"}
    if forms & {"edges", "corner_map"}:
        forms |= {"edges", "corner_map"}
    for form in forms:
        missing = [name for name in names if form not in found[name]]
        if missing:
            wanted = " or ".join(missing[0] + suffix for suffix in _FORMS[form])
            lack = f"missing for {len(missing)} of the {len(names)} panoramas in layout/img"
            raise ArgumentError(f"predictions: expected {wanted}, {lack}; got {strange or 'no other file'}")
    return found


def _corners(path: Path, width: int) -> Array:
    """(2N, 2) px of a file of corners, checked to be those of a room."""
    content = read_bytes(path, _MOST_BYTES)
    try:
        if path.suffix == ".json":
            corners = numbers("uv", json.loads(content)["uv"], (None, 2)) * [width, width // 2]
        else:
            rows = [line.split() for line in content.decode("ascii").splitlines() if line.strip()]
            corners = numbers("lines", rows, (None, 2))
    except (ValueError, KeyError, TypeError, RecursionError) as cause:
        if isinstance(cause, ArgumentError):
            raise
        wanted = "a mapping with uv" if path.suffix == ".json" else "lines of two numbers"
        raise ArgumentError(f"expected {wanted}, got {shown(content[:40])}") from cause
    if (corners < -1).any() or (corners > [width + 1, width // 2 + 1]).any():
        got = shown(corners[np.abs(corners / [width, width / 2] - 0.5).max(axis=1).argmax()])
        raise ArgumentError(f"expected corners within {width} x {width // 2} px, got {got}")
    room_seen(corners, width, width // 2)
    return corners


def _map(path: Path) -> Array:
    """(H, W) 0 to 1 of a picture twice as wide as high."""
    from PIL import Image

    content = read_bytes(path, _MOST_BYTES)
    try:
        with Image.open(io.BytesIO(content)) as picture:
            width, height = picture.size
            if width != 2 * height or width * height > _MOST_PIXELS:
                wanted = f"a map twice as wide as high, of at most {_MOST_PIXELS} pixels"
                raise ArgumentError(f"expected {wanted}, got {width} x {height}")
            deep = picture.mode.startswith("I")
            pixels = np.asarray(picture if deep else picture.convert("L"), np.float64)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as cause:
        if isinstance(cause, ArgumentError):
            raise
        raise ArgumentError(f"expected a PNG or JPEG picture, got {shown(content[:20])}") from cause
    return pixels / (65535 if deep else 255)
