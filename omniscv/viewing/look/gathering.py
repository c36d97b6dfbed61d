"""What is to be looked at, as frames: of a dataset, of a folder of images, of one image, of a picture."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from omniscv import dataset, modalities
from omniscv.arguments import within
from omniscv.cameras import create, from_dict
from omniscv.compose.files import OBJECTS
from omniscv.dataset import Frame
from omniscv.dataset.manifest import DATASET, FRAMES
from omniscv.dataset.sequences import by_camera
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.storage import Folder
from omniscv.storage.bounded import read_bytes

PICTURES = (".png", ".jpg", ".jpeg")
_LARGEST_JSON = 1 << 26


@dataclass(frozen=True)
class Gathered:
    """Frames that one page shows.

    Attributes:
        frames: those of a camera follow each other, by time or key.
        placed: whether their poses are known.
        flat: whether the directions of their pixels are not known.
        mask_colors: ``#rrggbb`` of an object in ``object_mask``, by its name.
    """

    frames: Sequence[Frame]
    placed: bool = True
    flat: bool = False
    mask_colors: Mapping[str, str] = field(default_factory=dict)


def is_dataset(folder: Folder) -> bool:
    """Return whether a folder holds a dataset, or what is left of one."""
    return folder.exists(DATASET) or folder.exists(FRAMES)


def of_dataset(folder: Folder) -> Gathered:
    """Return the frames of a dataset.

    Raises:
        ArgumentError, DatasetError: as :func:`omniscv.dataset.open`.
    """
    return Gathered([frame for group in by_camera(dataset.open(folder)).values() for frame in group])


def gather(path: Path) -> Gathered:
    """Return the frames of a folder or file.

    Args:
        path: a folder of images as ``render`` writes them, the ``STEM.json`` or any layer of one, or a
            picture.

    Raises:
        ArgumentError: nothing there, or nothing that can be shown.
    """
    if path.is_dir():
        return _folder(path)
    if not path.is_file():
        raise ArgumentError(f"{path}: expected a folder, an image or a recording, got nothing there")
    if path.suffix == ".json":
        return _images(path.parent, [path])
    described = path.with_name(f"{path.name.split('.')[0]}.json")
    if described.is_file() and _layer_of(path, described.stem):
        return _images(path.parent, [described])
    return _picture(path)


def _folder(path: Path) -> Gathered:
    described = [each for each in sorted(path.glob("*.json")) if _files(each)]
    if described:
        return _images(path, described)
    inside = sorted({each.parent.name for each in path.glob("*/*.json") if _files(each)})
    got = f"folders of images: choose one of {', '.join(inside)}" if inside else "none"
    raise ArgumentError(f"{path}: expected images of 'render' or a dataset, got {got}")


def _images(folder: Path, described: Iterable[Path]) -> Gathered:
    names, colors = _objects(folder / OBJECTS)
    return Gathered([_image(each, names) for each in described], mask_colors=colors)


def _image(path: Path, names: Mapping[str, int]) -> Frame:
    """The frame of a ``STEM.json``."""
    data = _json(path)
    files = _files(path)
    if not isinstance(data, dict) or not {"camera", "pose"} <= data.keys() or not files:
        raise ArgumentError(f"{path}: expected the STEM.json of an image with its layers, got another file")
    try:
        with within(path):
            camera, pose = from_dict(data["camera"]), Pose.from_dict(data["pose"])
        told = data.get("frame") or {}
        name, time = told.get("camera", camera.name), told.get("time")
    except (TypeError, KeyError, AttributeError) as cause:
        raise ArgumentError(f"{path}: expected a camera and a pose, got: {cause}") from cause
    return Frame(path.stem, name, camera, pose, files, names, time=time)


def _files(path: Path) -> dict[str, Path]:
    """The layers and records beside a ``STEM.json``, by kind."""
    stem = path.stem
    beside = path.parent.glob(f"{_literal(stem)}.*.*")
    found = {kind: each for each in sorted(beside) if (kind := _layer_of(each, stem))}
    records = {kind: path.with_name(f"{stem}.{kind}.json") for kind in ("truth", "layout")}
    return {**found, **{kind: each for kind, each in records.items() if found and each.is_file()}}


def _literal(name: str) -> str:
    return "".join(f"[{each}]" if each in "*?[" else each for each in name)


def _layer_of(path: Path, stem: str) -> str:
    """The layer that a file ``STEM.LAYER.SUFFIX`` holds; empty for others."""
    kind = path.name.removeprefix(f"{stem}.").removesuffix(path.suffix)
    return kind if kind in {row.name for row in modalities.layers()} else ""


def _objects(path: Path) -> tuple[dict[str, int], dict[str, str]]:
    """Object name to label, and to mask colour, of ``objects.json``; empty without the file."""
    if not path.is_file():
        return {}, {}
    try:
        listed = {each["name"]: (int(label), each["mask_color"]) for label, each in _json(path).items()}
        colors = {name: "#{:02x}{:02x}{:02x}".format(*color) for name, (_, color) in listed.items()}
        return {name: label for name, (label, _) in listed.items()}, colors
    except (TypeError, KeyError, AttributeError, ValueError, IndexError) as cause:
        raise ArgumentError(f"{path}: expected labels and their objects, got: {cause!r}") from cause


def _picture(path: Path) -> Gathered:
    """A picture without a description: a panorama where it is twice as wide as high, else flat."""
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path) as picture:
            width, height = picture.size
    except (OSError, UnidentifiedImageError, Image.DecompressionBombError) as cause:
        wanted = "expected a folder of images, a STEM.json, a picture or a recording"
        raise ArgumentError(f"{path}: {wanted}, got: {cause}") from cause
    if path.suffix.lower() not in PICTURES:
        raise ArgumentError(
            f"{path}: expected a picture {', '.join(PICTURES)}, got {path.suffix or 'no suffix'}"
        )
    camera = create("equirectangular", width=width, height=height)
    frame = Frame(path.stem, "picture", camera, Pose.from_angles((0, 0, 0)), {"lit": path}, {})
    return Gathered([frame], placed=False, flat=width != 2 * height)


def _json(path: Path) -> Any:
    try:
        return json.loads(read_bytes(path, _LARGEST_JSON))
    except (ValueError, RecursionError) as cause:
        raise ArgumentError(f"{path}: expected JSON, got: {cause}") from cause
