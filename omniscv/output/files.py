"""The files of an image.

STEM.lit.png (or .jxl, .jpg)   colour
STEM.object_mask.png           mask colours
STEM.labels.png                16-bit labels
STEM.depth.exr                 float32 metres along the ray
STEM.normals.exr               float32, camera frame
STEM.unsure.png                255 where a strategy with few optical centres could not verify a pixel
STEM.json                      camera, pose, source, versions
objects.json                   label to object name and mask colour
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omniscv.errors import ArgumentError, OmniscvError
from omniscv.parallel import side_by_side

if TYPE_CHECKING:
    from omniscv.output.image import OmniImage

IMAGE_FORMATS = ("png", "jxl", "jpg")
_NO_CLOCK = "1970:01:01 00:00:00"  # the same pixels make the same bytes, whenever they are written
_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 2]


def write(image: OmniImage, out: Path, stem: str, image_format: str = "png") -> list[Path]:
    """Writes an image's layers and what is known of it.

    Raises:
        ArgumentError: an unknown format, or a stem that is no file name.
        OmniscvError: a file cannot be written.
    """
    if image_format not in IMAGE_FORMATS:
        raise ArgumentError(f"image_format: expected one of {', '.join(IMAGE_FORMATS)}; got {image_format!r}")
    if not stem or stem != Path(stem).name:
        raise ArgumentError(f"stem: expected the start of a file name, got {stem!r}")
    out.mkdir(parents=True, exist_ok=True)
    lit_kind = "exr" if image.lit is not None and image.lit.dtype.kind == "f" else image_format
    layers = (
        (f"lit.{lit_kind}", image.lit),
        ("object_mask.png", image.object_mask),
        ("labels.png", image.labels),
        ("depth.exr", image.depth),
        ("normals.exr", image.normals),
        ("unsure.png", None if image.unsure is None else image.unsure.astype(np.uint8) * 255),
    )
    pictures = [(out / f"{stem}.{name}", layer) for name, layer in layers if layer is not None]
    written = side_by_side(lambda picture: _picture(*picture), pictures)
    written.append(_text(out / f"{stem}.json", json.dumps(_describe(image), indent=2)))
    if image.layers.objects is not None:
        written.append(_text(out / "objects.json", json.dumps(_objects(image), indent=2)))
    return written


def _describe(image: OmniImage) -> dict[str, Any]:
    from importlib.metadata import version

    return {
        "camera": image.camera.to_dict(),
        "pose": image.pose.to_dict(),
        "source": image.layers.provenance,
        "unsure_pixels": None if image.unsure is None else int(np.count_nonzero(image.unsure)),
        "unknown_mask_colors": [[*color, count] for color, count in image.layers.unknown_colors.items()],
        "versions": {name: version(name) for name in ("omniscv", "numpy", "opencv-python")},
    }


def _objects(image: OmniImage) -> dict[str, Any]:
    table = image.layers.objects
    assert table is not None
    return {
        str(label): {"name": name, "mask_color": list(table.colors[name])}
        for label, name in enumerate(table.names(), start=1)
    }


def _picture(path: Path, pixels: NDArray[Any]) -> Path:
    """Writes beside the place and moves there, so that no half file is ever seen."""
    part = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        if path.suffix == ".png":
            swapped = pixels[..., ::-1] if pixels.ndim == 3 else pixels
            part.write_bytes(cv2.imencode(".png", np.ascontiguousarray(swapped), _PNG)[1].tobytes())
        else:
            _openimageio(part, pixels)
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
    return path


def _openimageio(path: Path, pixels: NDArray[Any]) -> None:
    import OpenImageIO

    planes = pixels if pixels.ndim == 3 else pixels[..., None]
    height, width, channels = planes.shape
    spec = OpenImageIO.ImageSpec(width, height, channels, str(planes.dtype))
    if channels == 1:
        spec.channelnames = ("Z",)
    spec.attribute("compression", {".exr": "zip", ".jxl": "lossless", ".jpg": "jpeg:95"}[path.suffix])
    spec.attribute("DateTime", _NO_CLOCK)
    if path.suffix == ".jxl":
        spec.attribute("jpegxl:effort", 1)
        spec.attribute("jpegxl:distance", 0.0)
    output = OpenImageIO.ImageOutput.create(str(path))
    if output is None or not output.open(str(path), spec):
        raise OmniscvError(f"{path.name}: expected to write it, got: {OpenImageIO.geterror()}")
    if not (output.write_image(np.ascontiguousarray(planes)) and output.close()):
        raise OmniscvError(f"{path.name}: expected to write it, got: {output.geterror()}")


def _text(path: Path, text: str) -> Path:
    part = path.with_name(f".{path.name}.part")
    try:
        part.write_text(text + "\n", encoding="utf-8")
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
    return path
