"""Predictions and truth in folders, matched by their names."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from omniscv import dataset, storage
from omniscv.arguments import shown, within
from omniscv.cameras import Camera
from omniscv.cameras.registry import from_dict
from omniscv.compose import files
from omniscv.compose.layers import doubt_of
from omniscv.dataset.manifest import is_dataset
from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.geometry.arrays import Mask
from omniscv.pictures import foreign
from omniscv.storage.bounded import MOST_JSON_BYTES, MOST_PICTURE_BYTES, open_regular, parse_json, read_bytes

SUFFIXES = (".npy", ".npz", ".exr", ".tif", ".tiff", ".png", ".pfm")
"""Of predictions, the first one that is there counts."""
_LAYERS = ("label_edge", "unsure", "depth", "depth_error")


class Truth(NamedTuple):
    """The truth of one image.

    Attributes:
        name: of the image, which its prediction has, too.
        camera: of the image.
        depth: (H, W) metres along rays.
        doubt: (H, W) bool, pixels in doubt.
        error: (H, W) metres that depth may be off, infinite where nothing bounds it; None: not known.
    """

    name: str
    camera: Camera
    depth: Array
    doubt: Mask
    error: Array | None = None


def truths(folder: str | Path) -> Iterator[Truth]:
    """Yield the truth of each image of a dataset, or of a folder that ``render`` wrote.

    Args:
        folder: of the dataset or the images.

    Raises:
        ArgumentError: no such folder, or images without depth.
    """
    if is_dataset(storage.folder(folder)):
        for frame in dataset.open(folder):
            yield _truth(frame.key, frame.camera, frame.layers(*_LAYERS))
        return
    descriptions = sorted(Path(folder).glob("*.json"))
    images = 0
    for path in descriptions:
        with within(path):
            content = parse_json(read_bytes(path, MOST_JSON_BYTES))
        if isinstance(content, Mapping) and isinstance(content.get("camera"), Mapping):
            images += 1
            yield _truth_of_image(path, content)
    if not images:
        raise ArgumentError(f"{folder}: expected a dataset, or images that omniscv render wrote, got neither")


def _truth_of_image(path: Path, content: Mapping[str, Any]) -> Truth:
    """Return the truth of a rendered image by its ``STEM.json``."""
    camera = from_dict(dict(content["camera"]))
    layers = {}
    blank = content.get("blank", [])
    for layer in _LAYERS:
        if layer in blank:
            layers[layer] = np.zeros((camera.height, camera.width), np.bool_)
    for name in content.get("files", []):
        layer = str(name).removeprefix(f"{path.stem}.").partition(".")[0]
        if layer in _LAYERS:
            layers[layer] = files.read(path.parent / Path(name).name, layer)
    return _truth(path.stem, camera, layers)


def _truth(name: str, camera: Camera, layers: Mapping[str, NDArray[Any]]) -> Truth:
    """Return the truth of an image by its layers."""
    if "depth" not in layers:
        raise ArgumentError(f"{name}: expected an image with depth, got {', '.join(layers) or 'none'}")
    shape = (camera.height, camera.width)
    error = None
    if "depth_error" in layers:
        error = np.where(layers.get("unsure", np.False_), np.inf, layers["depth_error"]).astype(np.float64)
    return Truth(name, camera, layers["depth"].astype(np.float64), doubt_of(layers, shape), error)


def prediction(folder: Path, truth: Truth) -> tuple[Array, str]:
    """Return the prediction of an image, (H, W) as it is stored, and what was done to its size, in words.

    Args:
        folder: has ``NAME.SUFFIX`` or ``NAME.depth.SUFFIX``.
        truth: of the image.

    Raises:
        ArgumentError: no file of that name, or one that cannot be read.
    """
    path = _file_of(folder, truth.name)
    with within(path):
        values = _read(path)
    shape = (truth.camera.height, truth.camera.width)
    if values.shape == shape:
        return values, ""
    done = f"{values.shape[1]}x{values.shape[0]} px: the nearest pixels are taken"
    rows = ((np.arange(shape[0]) + 0.5) * values.shape[0] / shape[0]).astype(np.int64)
    columns = ((np.arange(shape[1]) + 0.5) * values.shape[1] / shape[1]).astype(np.int64)
    return values[rows][:, columns], done


def _file_of(folder: Path, name: str) -> Path:
    """Return the file of a prediction."""
    for stem in (name, f"{name}.depth"):
        for suffix in SUFFIXES:
            path = folder / f"{stem}{suffix}"
            if path.is_file():
                return path
    expected = f"{folder}: expected a prediction of {name!r}: {name}.npy, or another of {', '.join(SUFFIXES)}"
    raise ArgumentError(f"{expected}; got none")


def _read(path: Path) -> Array:
    """Return the values of a file, (H, W) float64."""
    suffix = path.suffix.lower()
    if suffix == ".npz":
        values = _of_npz(path)
    elif suffix == ".pfm":
        values = _of_pfm(path)
    else:
        values = foreign.read(path, "depth").pixels
    values = np.asarray(values, np.float64)
    values = values[..., 0] if values.ndim == 3 and values.shape[2] == 1 else values
    if values.ndim != 2:
        raise ArgumentError(f"expected one value a pixel, got an array of shape {shown(values.shape)}")
    return values


def _of_npz(path: Path) -> NDArray[Any]:
    """Return the only array of an NPZ."""
    with open_regular(path, most=MOST_PICTURE_BYTES) as file:
        try:
            with np.load(file, allow_pickle=False) as arrays:
                if len(arrays.files) != 1:
                    raise ArgumentError(f"expected one array, got {json.dumps(arrays.files)}")
                return np.asarray(arrays[arrays.files[0]])
        except (ValueError, OSError, EOFError, KeyError) as cause:
            raise ArgumentError(f"expected an NPZ of numbers, got: {cause}") from cause


def _of_pfm(path: Path) -> NDArray[Any]:
    """Return the pixels of a PFM of one channel, whose rows are stored from the bottom up."""
    header, _, body = read_bytes(path, MOST_PICTURE_BYTES).partition(b"\n")
    size, _, body = body.partition(b"\n")
    scale, _, body = body.partition(b"\n")
    try:
        width, height = map(int, size.split())
        order = "<f4" if float(scale) < 0 else ">f4"
        pixels = np.frombuffer(body, order, width * height).reshape(height, width)
    except ValueError as cause:
        raise ArgumentError(f"expected a PFM, got: {cause}") from cause
    if header.strip() != b"Pf":
        raise ArgumentError("expected a PFM of one channel, which begins with Pf")
    return pixels[::-1]
