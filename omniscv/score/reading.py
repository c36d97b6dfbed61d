"""Predictions and truth in folders and files, matched by their names."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniscv import dataset, storage
from omniscv.arguments import one_of, shown, within
from omniscv.cameras import Camera
from omniscv.cameras.registry import from_dict
from omniscv.compose import files
from omniscv.compose.layers import doubt_of
from omniscv.dataset.manifest import is_dataset
from omniscv.errors import ArgumentError
from omniscv.frame import Frame
from omniscv.geometry import Array
from omniscv.geometry.arrays import Mask
from omniscv.pictures import foreign
from omniscv.score.projection import resized
from omniscv.storage.bounded import MOST_JSON_BYTES, MOST_PICTURE_BYTES, open_regular, parse_json, read_bytes

INSTANCES = 1000
"""Ids of a picture of instances are 1000 times the class and a number below that, as Cityscapes has them."""
SUFFIXES = (".npy", ".npz", ".exr", ".tif", ".tiff", ".png", ".pfm")
"""Of predictions, the first one that is there counts."""
WHAT = ("depth", "labels", "normals", "panoptic")
"""What is scored."""
_MARKS = ("label_edge", "unsure")
_LAYERS = {
    "depth": (*_MARKS, "depth", "depth_error"),
    "labels": (*_MARKS, "labels"),
    "panoptic": (*_MARKS, "labels"),
    "normals": (*_MARKS, "normals", "depth", "depth_error"),
}
"""Layers that are read for what is scored."""
Lens = Callable[[int, int], Camera]
"""Returns a camera for a width and a height, px."""


@dataclass(frozen=True, eq=False)
class Truth:
    """The truth of one image.

    Attributes:
        name: of the image, which its prediction has, too.
        camera: of the image.
        values: (H, W) metres along rays, (H, W) labels or instances, or (H, W, 3) normals.
        doubt: (H, W) bool, pixels in doubt.
        error: (H, W) metres that depth may be off, infinite where nothing bounds it; None: not known.
        scene: what the image shows, for differences by scene; its name where that is not known.
        picture: returns its colours, (H, W, 3); None where it has none.
        class_of: returns the class of an instance.
    """

    name: str
    camera: Camera
    values: NDArray[Any]
    doubt: Mask
    error: Array | None = None
    scene: str = ""
    picture: Callable[[], NDArray[Any] | None] = lambda: None
    class_of: Callable[[int], int] = lambda instance: instance // INSTANCES


def truths(
    folder: str | Path,
    what: str = "depth",
    lens: Lens | None = None,
    unit_m: float = 1.0,
    cameras: Sequence[str] = (),
) -> Iterator[Truth]:
    """Yield the truth of each image of a dataset, of a folder that ``render`` wrote, or of files.

    Args:
        folder: of the dataset or the images; with a ``lens`` also one file.
        what: one of :data:`WHAT`.
        lens: the camera of files, which are all in the folder that can be a prediction; None: the dataset or
            the images say it.
        unit_m: of files, metres.
        cameras: names of those of a dataset whose frames count; empty: all.

    Raises:
        ArgumentError: no such folder, images without that truth, or no camera of such a name.
    """
    if lens is not None:
        yield from _of_files(Path(folder), what, lens, unit_m)
        return
    if is_dataset(storage.folder(folder)):
        frames = list(dataset.open(folder))
        for name in cameras:
            one_of("cameras", name, dict.fromkeys(frame.camera_name for frame in frames))
        for frame in frames:
            if not cameras or frame.camera_name in cameras:
                yield _of_frame(frame, what)
        return
    if cameras:
        raise ArgumentError(
            f"cameras: expected a dataset, got {folder}, whose images have no names of cameras"
        )
    descriptions = sorted(Path(folder).glob("*.json"))
    images = 0
    for path in descriptions:
        with within(path):
            content = parse_json(read_bytes(path, MOST_JSON_BYTES))
        if isinstance(content, Mapping) and isinstance(content.get("camera"), Mapping):
            images += 1
            yield _of_image(path, content, what)
    if not images:
        expected = f"{folder}: expected a dataset, or images that omniscv render wrote, got neither"
        raise ArgumentError(f"{expected}; for other files, give --camera")


def _of_files(path: Path, what: str, lens: Lens, unit_m: float) -> Iterator[Truth]:
    """Yield the truth of files, whose names end in ``.LAYER`` or in nothing."""
    paths = [path]
    if path.is_dir():
        paths = [file for file in sorted(path.iterdir()) if file.suffix.lower() in SUFFIXES]
    if not paths:
        raise ArgumentError(f"{path}: expected files of {', '.join(SUFFIXES)}, got none")
    for file in paths:
        with within(file):
            values = read(file, what)
        camera = lens(values.shape[1], values.shape[0])
        if (camera.height, camera.width) != values.shape[:2]:
            size = f"{camera.width}x{camera.height}"
            got = f"{values.shape[1]}x{values.shape[0]}"
            raise ArgumentError(f"{file}: expected {size} px, as its camera has, got {got}")
        if what == "depth":
            values = values * unit_m
        stem = file.stem.removesuffix(f".{what}")
        yield Truth(stem, camera, values, np.zeros(values.shape[:2], np.bool_), scene=stem)


def _of_frame(frame: Frame, what: str) -> Truth:
    """Return the truth of a frame; of a dataset with classes, labels are classes."""
    layers = frame.layers(*_LAYERS[what])
    if what == "labels" and frame.classes is not None and "labels" in layers:
        layers["labels"] = frame.classes.ids(frame.instances)[layers["labels"]]
    picture = partial(_layer_of_frame, frame)
    truth = _truth(frame.key, frame.camera, layers, what, frame.scene or frame.key, picture)
    if what != "panoptic":
        return truth
    if frame.classes is None:
        raise ArgumentError(f"{frame.key}: expected a dataset with classes, which instances are of, got none")
    class_ids = frame.classes.ids(frame.instances)
    return replace(truth, class_of=lambda instance: int(class_ids[instance]))


def _layer_of_frame(frame: Frame) -> NDArray[Any] | None:
    """Return the colours of a frame; None without them."""
    return frame.layers("lit").get("lit")


def _of_image(path: Path, content: Mapping[str, Any], what: str) -> Truth:
    """Return the truth of a rendered image by its ``STEM.json``."""
    camera = from_dict(dict(content["camera"]))
    paths = {}
    for name in content.get("files", []):
        layer = str(name).removeprefix(f"{path.stem}.").partition(".")[0]
        paths[layer] = path.parent / Path(name).name
    layers = {}
    for layer in _LAYERS[what]:
        if layer in content.get("blank", []):
            layers[layer] = np.zeros((camera.height, camera.width), np.bool_)
        elif layer in paths:
            layers[layer] = files.read(paths[layer], layer)
    picture = partial(files.read, paths["lit"], "lit") if "lit" in paths else lambda: None
    return _truth(path.stem, camera, layers, what, path.stem, picture)


def _truth(
    name: str,
    camera: Camera,
    layers: Mapping[str, NDArray[Any]],
    what: str,
    scene: str,
    picture: Callable[[], NDArray[Any] | None],
) -> Truth:
    """Return the truth of an image by its layers."""
    layer = "labels" if what == "panoptic" else what
    if layer not in layers:
        raise ArgumentError(f"{name}: expected an image with {layer}, got {', '.join(layers) or 'none'}")
    doubt = doubt_of(layers, (camera.height, camera.width))
    error = None
    if "depth_error" in layers:
        error = np.where(layers.get("unsure", np.False_), np.inf, layers["depth_error"]).astype(np.float64)
    values = layers[layer]
    if layer != "labels":
        values = values.astype(np.float64)
    return Truth(name, camera, values, doubt, error, scene, picture)


def prediction(folder: Path, truth: Truth, what: str = "depth") -> tuple[NDArray[Any], str]:
    """Return the prediction of an image, as it is stored but for its size, and what was done to that, in
    words.

    Args:
        folder: has ``NAME.SUFFIX`` or ``NAME.WHAT.SUFFIX``; or one file.
        truth: of the image.
        what: one of :data:`WHAT`.

    Raises:
        ArgumentError: no file of that name, or one that cannot be read.
    """
    path = file_of(folder, truth.name, what)
    with within(path):
        values = read(path, what)
    shape = (truth.camera.height, truth.camera.width)
    if values.shape[:2] == shape:
        return values, ""
    size = f"{values.shape[1]}x{values.shape[0]} px"
    if what != "depth":
        rows = ((np.arange(shape[0]) + 0.5) * values.shape[0] / shape[0]).astype(np.int64)
        columns = ((np.arange(shape[1]) + 0.5) * values.shape[1] / shape[1]).astype(np.int64)
        return values[rows][:, columns], f"{size}: the nearest pixels are taken"
    done = f"{size}: read linearly between pixels"
    if truth.camera.wraps:
        done += ", also across the seam"
    return resized(values, shape, truth.camera.wraps), done


def file_of(folder: Path, name: str, what: str) -> Path:
    """Return the file of a prediction; ArgumentError for none. A ``folder`` may be the file itself."""
    if folder.is_file():
        return folder
    for stem in (name, f"{name}.{what}"):
        for suffix in SUFFIXES:
            path = folder / f"{stem}{suffix}"
            if path.is_file():
                return path
    expected = f"{folder}: expected a prediction of {name!r}: {name}.npy, or another of {', '.join(SUFFIXES)}"
    raise ArgumentError(f"{expected}; got none")


def read(path: Path, what: str = "depth") -> NDArray[Any]:
    """Return the values of a file: (H, W) float64 depth, (H, W) whole numbers, or (H, W, 3) float64 normals.

    Args:
        path: of a suffix of :data:`SUFFIXES`.
        what: one of :data:`WHAT`.

    Raises:
        ArgumentError: a file of another form.
    """
    suffix = path.suffix.lower()
    if suffix == ".npz":
        values = _of_npz(path)
    elif suffix == ".pfm":
        values = _of_pfm(path)
    elif suffix == ".npy" and what == "normals":
        values = _of_npy(path)
    else:
        kinds = {"depth": "depth", "labels": "object_mask", "panoptic": "object_mask", "normals": "lit"}
        values = foreign.read(path, kinds[what]).pixels
    values = values[..., 0] if values.ndim == 3 and values.shape[2] == 1 else values
    expected = "three values a pixel" if what == "normals" else "one value a pixel"
    if values.ndim != (3 if what == "normals" else 2):
        raise ArgumentError(f"expected {expected}, got an array of shape {shown(values.shape)}")
    return values if what in ("labels", "panoptic") else np.asarray(values, np.float64)


def _of_npy(path: Path) -> NDArray[Any]:
    """Return the array of an NPY."""
    with open_regular(path, most=MOST_PICTURE_BYTES) as file:
        try:
            return np.asarray(np.load(file, allow_pickle=False))
        except (ValueError, OSError, EOFError) as cause:
            raise ArgumentError(f"expected an NPY of numbers, got: {cause}") from cause


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
