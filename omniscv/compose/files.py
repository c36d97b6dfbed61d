"""The files of an image.

STEM.lit.png (or .jpg)         colour
STEM.object_mask.png           mask colours
STEM.labels.png                16-bit labels
STEM.depth.exr (.tiff, .npy)   float32 metres along the ray
STEM.normals.exr               float32, camera frame
STEM.depth_error.exr           float16 metres that depth may be off; float32 in other forms
STEM.label_edge.png            255 where a label may be the neighbour's
STEM.relit.png                 255 where closing seams changed a colour
STEM.light.png                 8-bit, what light makes doubtful: see :mod:`omniscv.compose.light_checks`
STEM.unsure.png                255 where no capture verified a pixel
STEM.occluded.png              255 where the optical centre is not visible from the camera position
STEM.json                      camera, pose, options, source, versions, the blank layers, the files
objects.json                   label to object name and mask colour, of all images in the folder

A modality that was registered is written as its row of :mod:`omniscv.modalities` has it. A mark that no pixel
has (``blank``) has no file. In the store ``fast`` every layer is an array of Blosc2, STEM.LAYER.b2nd; marks
are 0 and 255 there, too.
"""

import json
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypedDict, Unpack

import numpy as np
from numpy.typing import NDArray

from omniscv import modalities, plugins
from omniscv.arguments import one_of, shown, within
from omniscv.arguments import stem as start_of_name
from omniscv.compose import saved
from omniscv.compose.layers import as_halves
from omniscv.compose.saved import OBJECTS as OBJECTS
from omniscv.errors import ArgumentError, BadReplyError
from omniscv.modalities import Modality
from omniscv.parallel import side_by_side
from omniscv.pictures import forms
from omniscv.pictures.forms import ARRAY, FORMS, Form, Opened, Writer, form_of, open_picture
from omniscv.sources.base import ObjectTable
from omniscv.storage.bounded import MOST_JSON_BYTES, parse_json, read_bytes
from omniscv.storage.local import locked, whole_file

DEPTH_FORMATS = ("exr", "tiff", "npy")
"""Suffixes of depth, its bounds and normals: as float32, in EXR bounds as half floats."""
STORES = ("files", "fast")
"""How layers are stored: pictures that other programs read, or arrays for omniscv, torch and Blosc2."""


class Forms(TypedDict, total=False):
    """How layers are written.

    Attributes:
        image_format: of colour, such as ``png``.
        store: one of :data:`STORES`.
        depth_format: one of :data:`DEPTH_FORMATS`.
    """

    image_format: str
    store: str
    depth_format: str


def register(suffix: str, writer: Writer) -> None:
    """Register a ``writer`` of files of a ``suffix``, which then is an ``image_format`` of images."""
    FORMS[suffix] = FORMS.get(suffix, Form())._replace(write=writer)


def formats() -> tuple[str, ...]:
    """Return the values of ``image_format``."""
    plugins.load()
    names = []
    for suffix, form in FORMS.items():
        if form.write and suffix != ARRAY:
            names.append(suffix)
    return tuple(names)


def check_format(image_format: str = "png", store: str = "files", depth_format: str = "exr") -> None:
    """Refuse forms of files that are not known.

    Args:
        image_format: of colours: a suffix that has a writer.
        store: one of :data:`STORES`.
        depth_format: one of :data:`DEPTH_FORMATS`.

    Raises:
        ArgumentError: one of them is unknown.
        OmniscvError: the package of the store is missing.
    """
    one_of("depth_format", depth_format, DEPTH_FORMATS)
    if one_of("store", store, STORES) == "fast":
        forms.blosc2_package()
    if image_format not in formats():
        advice = "; png is lossless, too" if image_format == "jxl" else ""
        expected = f"image_format: expected one of {', '.join(formats())}"
        raise ArgumentError(f"{expected}; got {image_format!r}{advice}")


def write(
    layers: Mapping[str, NDArray[Any]],
    description: Mapping[str, Any],
    objects: ObjectTable | None,
    out: Path,
    stem: str,
    **written_as: Unpack[Forms],
) -> list[Path]:
    """Write an image's layers and its description.

    Args:
        layers: by the names of :mod:`omniscv.modalities`.
        description: plain values, for ``STEM.json``.
        objects: for ``objects.json``; None: not written.
        out: the folder; made if it is not there.
        stem: start of the file names.
        written_as: see :class:`Forms`.

    Returns:
        The files.

    Raises:
        ArgumentError: an unknown format or store, a stem that is no file name, files of others that have
            names of the image's, or a folder whose ``objects.json`` gives a label another object or mask
            colour.
        OmniscvError: a file cannot be written.
    """
    start_of_name("stem", stem, dots=True)
    check_format(**written_as)
    if f"{stem}.json" == OBJECTS:
        raise ArgumentError(f"stem: expected another than that of {OBJECTS}, got {stem!r}")
    if objects is not None:
        _objects_with(out / OBJECTS, objects)  # refused before anything is written
    transfer = description.get("transfer", "unknown")
    names = [f"{stem}.{name}" for name in _endings(layers, **written_as).values()]
    out.mkdir(parents=True, exist_ok=True)
    with saved.replacing(out, stem, [*names, f"{stem}.json"]):
        written = list(write_layers(layers, out, stem, transfer, **written_as).values())
        facts = {**description, "blank": blank(layers), "versions": versions(), "files": names}
        written.append(write_json(out / f"{stem}.json", facts))
        if objects is not None:
            with locked(out):  # others may save images into this folder at the same time
                existing, merged = _objects_with(out / OBJECTS, objects)
                same = existing == merged  # as for most images of a folder
                written.append(out / OBJECTS if same else write_json(out / OBJECTS, merged))
    return written


def write_layers(
    layers: Mapping[str, NDArray[Any]],
    out: Path,
    stem: str,
    transfer: str = "unknown",
    **written_as: Unpack[Forms],
) -> dict[str, Path]:
    """Write layers as ``STEM.LAYER.SUFFIX`` into a folder, which is made if it is not there.

    Blank marks have no file. Files of 8-bit colours say that they are sRGB where the transfer is ``srgb`` or
    ``film``.

    Args:
        layers: by the names of :mod:`omniscv.modalities`.
        out: the folder.
        stem: start of the file names.
        transfer: of the colours; see :data:`omniscv.modalities.TRANSFERS`.
        written_as: see :class:`Forms`.

    Returns:
        The files by layer, each written whole or not at all.

    Raises:
        OmniscvError: a file cannot be written.
    """
    out.mkdir(parents=True, exist_ok=True)
    is_srgb = transfer in ("srgb", "film") and "lit" in layers and layers["lit"].dtype == np.uint8
    pictures = []
    for name, ending in _endings(layers, **written_as).items():
        row = modalities.get(name)
        if name == "lit" and is_srgb:
            row = replace(row, attributes=modalities.SRGB)
        pictures.append((out / f"{stem}.{ending}", layers[name], row))
    written = side_by_side(lambda picture: write_picture(*picture), pictures)
    paths = {}
    for (_, _, row), path in zip(pictures, written, strict=True):
        paths[row.name] = path
    return paths


def _endings(layers: Mapping[str, NDArray[Any]], **written_as: Unpack[Forms]) -> dict[str, str]:
    """Return, by the layers that have a file, how its name goes on after the stem and a dot."""
    omitted = blank(layers)
    endings = {}
    for row in modalities.layers():
        if row.name in layers and row.name not in omitted:
            endings[row.name] = f"{row.name}.{_suffix(row, layers[row.name], **written_as)}"
    return endings


def blank(layers: Mapping[str, NDArray[Any]]) -> list[str]:
    """Return the names of the marks that no pixel has, which therefore have no file."""
    names = []
    for name, pixels in layers.items():
        if modalities.get(name).mark and not pixels.any():
            names.append(name)
    return names


@cache
def versions() -> dict[str, str]:
    """Return the versions of the packages that the pixels of a file depend on."""
    return {name: version(name) for name in ("omniscv", "numpy", "opencv-python")}


def _objects_with(path: Path, objects: ObjectTable) -> tuple[dict[str, Any] | None, dict[str, Any]]:
    """Return the content of ``objects.json``, None if there is no file, and the same with more objects;
    ArgumentError where a label would get another object or mask colour, or an object another label."""
    listed: dict[str, dict[str, Any]] = {}
    for number, name in enumerate(objects.names(), start=1):
        listed[str(number)] = {"name": name, "mask_color": list(objects.colors[name])}
    if not path.exists():
        return None, listed
    try:
        existing = parse_json(read_bytes(path, MOST_JSON_BYTES))
        label_of = {entry["name"]: label for label, entry in existing.items()}
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError) as cause:
        fault = f"{type(cause).__name__}, {shown(str(cause))}"
        raise ArgumentError(f"{path}: expected labels and their objects, got: {fault}") from cause
    for label, entry in listed.items():
        name = entry["name"]
        previous = label_of.get(name, label)
        if previous != label or existing.get(label, entry) != entry:
            conflict = f"label {shown(previous)}" if previous != label else shown(existing[label])
            expected = f"expected the objects of the images in this folder, {conflict}"
            raise ArgumentError(f"{path}: {expected}; got {label}: {shown(entry)}; save into another folder")
    merged = sorted({**existing, **listed}.items(), key=lambda item: (len(item[0]), item[0]))
    return existing, dict(merged)


def _suffix(
    row: Modality,
    pixels: NDArray[Any],
    image_format: str = "png",
    store: str = "files",
    depth_format: str = "exr",
) -> str:
    if store == "fast":
        return ARRAY
    if row.file == "picture":
        return "exr" if pixels.dtype.kind == "f" else image_format
    return depth_format if row.file in ("exr", "bound") else row.file


def write_picture(path: Path, pixels: NDArray[Any], row: modalities.Modality) -> Path:
    """Write one layer in the form of the path's suffix, and return the path.

    Args:
        path: the file.
        pixels: (H, W) or (H, W, C).
        row: the layer's modality.
    """
    halves = row.file == "bound" and form_of(path).halves
    with whole_file(path) as part:
        forms.write_picture(part, as_halves(pixels) if halves else pixels, row)
    return path


def write_json(path: Path, data: object, indent: int | None = 2) -> Path:
    """Write plain values as a file, whole or not at all, and return its path.

    Args:
        path: the file.
        data: what JSON has: texts, numbers, lists, mappings.
        indent: spaces of a level; None: all on one line.

    Raises:
        ArgumentError: values that JSON does not have, such as NaN or arrays.
    """
    try:
        text = json.dumps(data, indent=indent, allow_nan=False)
    except (TypeError, ValueError) as cause:
        raise ArgumentError(f"{path.name}: expected finite, plain values for JSON, got: {cause}") from cause
    with whole_file(path) as part:
        part.write_text(text + "\n", encoding="utf-8")
    return path


def finite(value: Any) -> Any:
    """Return plain values as JSON has them: null for numbers that are not finite."""
    if isinstance(value, Mapping):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def read(path: Path, name: str) -> NDArray[Any]:
    """Return a layer from a file that :func:`omniscv.compose.files.write` wrote, as it was in memory.

    Args:
        path: the file.
        name: the layer's row of :mod:`omniscv.modalities`.

    Raises:
        ArgumentError: the file cannot be read, or is no such layer.
    """
    row = modalities.get(name)
    with within(path), _opened(path, row) as picture:
        pixels = picture.pixels().reshape(picture.height, picture.width, -1)
    pixels = pixels if row.channels else pixels[..., 0]
    if row.mark:
        return pixels > 0
    return pixels.astype(np.float32) if row.file == "bound" else pixels


def check_header(path: Path, name: str, size: tuple[int, int]) -> None:
    """Refuse a file that is no picture of a layer in a size; only its header is read.

    Args:
        path: the file.
        name: of the layer.
        size: width and height, px.

    Raises:
        ArgumentError: the file is no such picture.
    """
    with _opened(path, modalities.get(name)) as picture:
        if size != (picture.width, picture.height):
            wanted = f"expected {size[0]}x{size[1]} px, as its camera has"
            raise ArgumentError(f"{wanted}, got {picture.width}x{picture.height}")


@contextmanager
def _opened(path: Path, row: Modality) -> Iterator[Opened]:
    """Yield the open picture of a layer, whose channels and type fit it."""
    try:
        picture = open_picture(path)
        dtypes = ("uint8",) if row.mark else row.dtypes
        dtypes = ("float16", "float32") if row.file == "bound" else dtypes
        if picture.channels != (row.channels or 1) or picture.dtype not in dtypes:
            shape = (picture.height, picture.width, picture.channels)
            expected = f"expected {' or '.join(row.dtypes)} pixels of {row.name}"
            raise ArgumentError(f"{expected}, got {picture.dtype} of shape {shape}")
        yield picture
    except (OSError, BadReplyError) as fault:
        raise ArgumentError(f"expected a picture of {row.name}, got: {fault}") from fault
