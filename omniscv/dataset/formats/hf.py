"""Hugging Face ImageFolder: ``SPLIT/metadata.jsonl`` beside the frames' files, and the card ``README.md``.

Every row has the colour picture as ``image``, further pictures as columns named after their layers, the key,
the camera, the pose, time and place; with the truth ``boxes``, ``objects`` too. Files that Pillow does not
read (EXR) lie beside them, in columns ``LAYER_path`` that are texts. Frames without a split are in ``train``,
those of ``val`` in ``validation``.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from omniscv.arguments import label
from omniscv.dataset.exporting import Format, register
from omniscv.dataset.pictures import copy_files
from omniscv.errors import ArgumentError
from omniscv.frame import IMAGE, Frame
from omniscv.frame.classes import BACKGROUND
from omniscv.records import checked, record
from omniscv.storage.local import write_text

_PICTURES = (".png", ".jpg")
_SPLITS = {"": "train", "val": "validation"}
"""Splits that have other names at Hugging Face."""

_SPLIT = re.compile(r"\w+")


@record
class HfOptions:
    """Options of the format."""

    license: str = checked(label, default="", help="for the card")


@register
class Hf(Format):
    """See the module."""

    name = "hf"
    needs = ("lit",)
    options = HfOptions

    def write(self, frames: Sequence[Frame], out: Path, options: HfOptions) -> list[Path]:
        """Write the folders and the card; ArgumentError for colour that Pillow does not read."""
        rows: dict[str, list[dict[str, Any]]] = {}
        written: list[Path] = []
        for frame in sorted(frames, key=lambda frame: frame.key):
            if not _SPLIT.fullmatch(split := _SPLITS.get(frame.split, frame.split)):
                wanted = "expected a split of letters, digits and underscores, as Hugging Face reads it"
                raise ArgumentError(f"{frame.key}: {wanted}, got {split!r}")
            folder = out / split
            folder.mkdir(parents=True, exist_ok=True)
            files = copy_files(frame, folder)
            rows.setdefault(folder.name, []).append(_row(frame, files))
            written += files.values()
        columns = _columns([row for of_split in rows.values() for row in of_split])
        for split, of_split in rows.items():
            lines = [json.dumps({key: row[key] for key in columns}, allow_nan=False) for row in of_split]
            written.append(write_text(out / split / "metadata.jsonl", "\n".join(lines) + "\n"))
        return [*written, write_text(out / "README.md", _card(frames, rows, options.license))]


def _columns(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """The columns that every row has: null in all rows of a split would change their type.

    ``file_name`` is first, because readers take the first column of pictures for it.
    """
    keys = [{key for key in row if row[key] is not None} for row in rows]
    return sorted(set[str]().union(*keys).intersection(*keys), key=lambda key: (key != "file_name", key))


def _row(frame: Frame, files: Mapping[str, Path]) -> dict[str, Any]:
    """A line of ``metadata.jsonl``."""
    colour = files["lit"]
    if colour.suffix not in _PICTURES:
        raise ArgumentError(
            f"{frame.key}: expected colour as one of {', '.join(_PICTURES)}, which Pillow reads; got "
            f"{colour.name}; make it with image_format: png"
        )
    row: dict[str, Any] = {"file_name": colour.name}
    for kind, path in files.items():
        if kind not in ("lit", IMAGE):
            row[f"{kind}_file_name" if path.suffix in _PICTURES else f"{kind}_path"] = path.name
    return row | {
        "key": frame.key,
        "camera": frame.camera_name,
        "position": frame.pose.position.tolist(),
        "rotation": frame.pose.rotation.tolist(),
        "time": frame.time,
        "place": frame.place,
        **_objects(frame),
    }


def _objects(frame: Frame) -> dict[str, Any]:
    """``objects`` of ImageFolder: boxes x, y, width, height in pixels, and class ids."""
    boxes = frame.truth.get("boxes")
    if boxes is None:
        return {}
    classes = {} if frame.classes is None else frame.classes.classes
    ids = [classes[box["class"]].id if box.get("class") in classes else BACKGROUND for box in boxes]
    return {
        "objects": {
            "bbox": [box["bbox"] for box in boxes],
            "categories": ids,
            "instances": [box["instance_id"] for box in boxes],
        }
    }


def _card(frames: Sequence[Frame], rows: Mapping[str, Sequence[Any]], license: str) -> str:
    """The dataset card: its YAML head, and the meaning of the columns."""
    data_files = "".join(f'      - {{split: {_word(split)}, path: "{split}/**"}}\n' for split in rows)
    head = f"configs:\n  - config_name: default\n    data_files:\n{data_files}"
    if license:
        head = f"license: {_word(license)}\n{head}"
    cameras = {frame.camera_name: frame.camera for frame in frames}
    table = frames[0].classes if frames else None
    classes = "".join(f"- {row.id}: {row.name}\n" for row in table.classes.values()) if table else ""
    listed = "".join(f"- {name}: `{camera!r}`\n" for name, camera in sorted(cameras.items()))
    return f"---\n{head}---\n{_TEXT}\n## Cameras\n\n{listed}" + (classes and f"\n## Classes\n\n{classes}")


def _word(text: str) -> str:
    """Return a text as YAML reads it back: as it is where it can be, else in quotes."""
    # Words alone: PyYAML fails in several ways on texts that look like numbers or times.
    plain = re.fullmatch(r"[A-Za-z][\w.-]*", text, re.ASCII) and yaml.safe_load(text) == text
    return text if plain else yaml.safe_dump(text, default_style='"', width=sys.maxsize).strip()


_TEXT = """
Omnidirectional images with exact ground truth, made by omniscv.

`image` is the colour picture. `labels` holds instance ids, `classes` class ids, both 16 bits, 0 for none.
`position` (metres) and `rotation` (row by row) turn camera to world: world X forward, Y left, Z up; camera x
right, y down, z forward. Columns that end in `_path` name files beside the picture: `depth_path` is OpenEXR,
32-bit floats, metres along the pixel's ray, inf where there is no surface, 0 outside the field of view.
"""
