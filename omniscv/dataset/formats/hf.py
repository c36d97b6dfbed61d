"""Hugging Face ImageFolder: ``SPLIT/metadata.jsonl`` beside the frames' files, and the card ``README.md``.

Every row has the colour picture as ``image``, further pictures as columns named after their layers, the key,
the camera, the pose, time and place; with the truth ``boxes``, ``objects`` too. What Pillow does not read
(EXR) lies beside them, in columns ``LAYER_path`` that are texts. Frames without a split are in ``train``,
those of ``val`` in ``validation``. Option: ``license``, for the card.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from omniscv.arguments import fields, text
from omniscv.cameras import Camera
from omniscv.dataset.manifest import IMAGE
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.storage.local import whole_file
from omniscv.truth.classes import BACKGROUND

name = "hf"
needs = ("lit",)

_PICTURES = (".png", ".jpg")
_SPLITS = {"": "train", "val": "validation"}
"""Splits that Hugging Face has other words for."""


def refuses(camera: Camera) -> None:
    """Return None: the folder holds pictures of any camera."""


def check_options(options: Mapping[str, Any], cameras: Mapping[str, Camera]) -> None:
    """Raise ArgumentError for a wrong option."""
    fields(name, options, {"license": text})


def write(frames: Sequence[Frame], out: Path, options: Mapping[str, Any]) -> list[Path]:
    """Write the folders, their metadata and the card.

    Raises:
        ArgumentError: a wrong option, or a frame without colour, or with colour that Pillow does not read.
    """
    check_options(options, {})
    rows: dict[str, list[dict[str, Any]]] = {}
    written = []
    for frame in sorted(frames, key=lambda frame: frame.key):
        folder = out / _SPLITS.get(frame.split, frame.split)
        folder.mkdir(parents=True, exist_ok=True)
        rows.setdefault(folder.name, []).append(_row(frame))
        for path in frame.files.values():
            written.append(Path(shutil.copyfile(path, folder / path.name)))
    # What every frame has: null in all rows of a split would be another type than in the others. The reader
    # gives ``file_name`` to the first column of pictures.
    every = [{key for key in row if row[key] is not None} for mine in rows.values() for row in mine]
    columns = sorted(set[str]().union(*every).intersection(*every), key=lambda key: (key != "file_name", key))
    for split, mine in rows.items():
        lines = [json.dumps({key: row[key] for key in columns}, allow_nan=False) for row in mine]
        written.append(_text(out / split / "metadata.jsonl", "\n".join(lines) + "\n"))
    return [*written, _text(out / "README.md", _card(frames, rows, options))]


def _row(frame: Frame) -> dict[str, Any]:
    """A line of ``metadata.jsonl``."""
    colour = frame.files["lit"]
    if colour.suffix not in _PICTURES:
        wanted = f"expected colour as one of {', '.join(_PICTURES)}, which Pillow reads"
        raise ArgumentError(f"{frame.key}: {wanted}; got {colour.name}; make it with image_format: png")
    row: dict[str, Any] = {"file_name": colour.name}
    for kind, path in frame.files.items():
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
    """``objects`` as ImageFolder has them: boxes x, y, width, height in pixels, and class ids."""
    boxes = frame.truth.get("boxes")
    if boxes is None:
        return {}
    classes = {} if frame.classes is None else frame.classes.classes
    ids = [classes[each["class"]].id if each.get("class") in classes else BACKGROUND for each in boxes]
    return {
        "objects": {
            "bbox": [each["bbox"] for each in boxes],
            "categories": ids,
            "instances": [each["instance_id"] for each in boxes],
        }
    }


def _card(frames: Sequence[Frame], rows: Mapping[str, Sequence[Any]], options: Mapping[str, Any]) -> str:
    """The dataset card: what Hugging Face reads at its top, and what the columns mean."""
    data_files = "".join(f'      - {{split: {split}, path: "{split}/**"}}\n' for split in rows)
    head = f"configs:\n  - config_name: default\n    data_files:\n{data_files}"
    if "license" in options:
        head = f"license: {options['license']}\n{head}"
    cameras = {frame.camera_name: frame.camera for frame in frames}
    table = frames[0].classes if frames else None
    classes = "".join(f"- {each.id}: {each.name}\n" for each in table.classes.values()) if table else ""
    described = "".join(f"- {name}: `{camera!r}`\n" for name, camera in sorted(cameras.items()))
    return f"---\n{head}---\n{_TEXT}\n## Cameras\n\n{described}" + (classes and f"\n## Classes\n\n{classes}")


def _text(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as part:
        part.write_text(text, encoding="utf-8")
    return path


_TEXT = """
Omnidirectional images with exact ground truth, made by omniscv.

`image` is the colour picture. `labels` holds instance ids, `classes` class ids, both 16 bits, 0 for none.
`position` (metres) and `rotation` (row by row) turn camera to world: world X forward, Y left, Z up; camera x
right, y down, z forward. Columns that end in `_path` name files beside the picture: `depth_path` is OpenEXR,
32-bit floats, metres along the pixel's ray, inf where there is no surface, 0 outside the field of view.
"""
