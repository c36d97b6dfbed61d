"""The records that the truths of this package write: what each holds, declared once.

Truths write them, and files of records are checked when they are read: readers index records without asking
whether a key is there. Records of truths that other packages register have any form.
"""

from collections.abc import Mapping
from functools import partial
from typing import Any, get_args

from omniscv.arguments import Reader, flag, number, numbers, one_of, shown, text, whole_number, wrong
from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.geometry.pose import position_reader, rotation_reader
from omniscv.geometry.scene_geometry import BoxSource
from omniscv.records import listed, mapping, named, nested, optional


def checked(kind: str, content: Any, camera: Camera, instances: Mapping[str, int]) -> Any:
    """Return the content of a file of records, plain values.

    Args:
        kind: ``truth``, with records by the names of their truths, or that of a file that is one record.
        content: plain values.
        camera: of the image, whose pixels records name.
        instances: the ids of the dataset's objects by name.

    Raises:
        ArgumentError: the content has another form.
    """
    if kind == "layout":
        _LAYOUT("layout", content)
        _check_pixels(content, camera)
    if kind == "truth":
        records = mapping("truth", content)
        for name in _TRUTHS.keys() & records.keys():
            _TRUTHS[name](name, records[name])
        for name in _OF_OBJECTS & records.keys():
            for i, record in enumerate(records[name]):
                _check_object(f"{name}[{i}]", record, camera, instances)
    return content


def _check_object(
    where: str, record: Mapping[str, Any], camera: Camera, instances: Mapping[str, int]
) -> None:
    """Raise ArgumentError for an object that the dataset does not have, or a mask of another image's size."""
    if instances.get(record["name"]) != record["instance_id"]:
        named_so = f"{shown(record['name'])} as {record['instance_id']}"
        raise ArgumentError(
            f"{where}: expected an object of the dataset with its instance id, got {named_so}"
        )
    width, height = camera.width, camera.height
    for key, most in (("bbox", width), ("bbox_wrap", 2 * width)):
        x, y, across, down = record.get(key, (0, 0, 1, 1))
        if not (0 <= x < width and y >= 0 and 0 < across <= min(width, most - x) and 0 < down <= height - y):
            raise ArgumentError(f"{where}.{key}: expected a box in the image, got {shown(record[key])}")
    mask = record.get("segmentation")
    if mask is not None and mask["size"] != [height, width]:
        raise wrong(f"{where}.segmentation", f"a mask of {height} x {width} px", mask["size"])


def _check_pixels(layout: Mapping[str, Any], camera: Camera) -> None:
    """Raise ArgumentError for a pixel of a layout that is not in the image."""
    pixels: list[Any] = []
    for edge in layout["edges"]:
        for piece in edge["pieces"]:
            pixels += piece["pixels"]
    for corner in layout["corners"]:
        if corner["in_image"]:
            pixels.append(corner["pixel"])
    if not pixels:
        return
    all_pixels = numbers("layout: pixels", pixels, (None, 2))
    outside = ((all_pixels < 0) | (all_pixels > [camera.width, camera.height])).any(axis=1)
    if outside.any():
        raise ArgumentError(f"layout: expected pixels in the image, got {shown(all_pixels[outside][0])}")


def _form(**keys: Reader) -> Reader:
    """Return a reader of mappings by the readers of their keys; further keys may have any value.

    A key may be missing if its reader is ``_Maybe``; one of Python's words ends with ``_``.
    """

    def read(name: str, value: object) -> dict[str, Any]:
        """Return the mapping ``value``; ``name`` is what messages call it."""
        record = mapping(name, value)
        for word, reader in keys.items():
            key = word.removesuffix("_")
            if key in record:
                reader(f"{name}.{key}", record[key])
            elif not isinstance(reader, _Maybe):
                raise ArgumentError(f"{name}: missing key {key!r}")
        return record

    return read


class _Maybe(partial[Any]):
    """A reader of a key that may be missing."""


def _objects(**keys: Reader) -> Reader:
    """Return a reader of lists of records of objects, each with its instance id and name."""
    return listed(_form(instance_id=whole_number, name=text, **keys))


def _spherical_box(name: str, value: object) -> dict[str, Any]:
    mapping(name, value, (*_ANGLES, "kind"))
    angles = dict.fromkeys(_ANGLES, partial(number, least=-360, most=360))
    record: dict[str, Any] = _form(**angles, kind=_words("perspective", "lonlat"))(name, value)
    return record


def _words(*words: str) -> Reader:
    return partial(one_of, words=words)


_LIST = listed(lambda _, item: item)  # whose items are checked elsewhere
_PIXEL = partial(numbers, shape=(2,))
_BOX = partial(numbers, shape=(4,))
_COUNT = partial(whole_number, least=0)
_SHARE = partial(number, least=0, most=1)
_ANGLES = ("lon", "lat", "fov_h", "fov_v", "rot")  # degrees
_CLASS = _Maybe(optional(text))  # None: no class
_TRUTHS: dict[str, Reader] = {
    "poses": named(nested(Pose)),
    # px; ``bbox_wrap`` may cross the right border. ``distance``: metres to the nearest pixel, None: infinite.
    "boxes": _objects(class_=_CLASS, area=_Maybe(_COUNT), bbox=_BOX, bbox_wrap=_Maybe(_BOX),
                      crosses_seam=_Maybe(flag), distance=_Maybe(optional(number)), truncated=_Maybe(_SHARE)),
    "bfov": _objects(bfov=_spherical_box, rbfov=_spherical_box),
    # metres; ``size`` along the box's axes. ``truncated``: the share of its surface outside the image.
    "boxes3d": _objects(class_=_CLASS, center_camera=position_reader, R_camera_box=rotation_reader,
                        size=position_reader, truncated=_SHARE, source=_words(*get_args(BoxSource)),
                        partial=_Maybe(flag)),
    # Of the object without what occludes it; ``visib_fract`` of its pixels are seen.
    "amodal": _objects(px_all=_COUNT, visib_fract=_SHARE, bbox=_BOX,
                       segmentation=_Maybe(_form(size=_LIST, counts=text))),
}  # fmt: skip
_OF_OBJECTS = _TRUTHS.keys() - {"poses"}
_VISIBLE: dict[str, Reader] = {"visible_room": flag, "visible": optional(flag)}
_CORNER = _form(kind=_words("floor", "ceiling"), world=position_reader, in_image=flag, pixel=optional(_PIXEL),
                **_VISIBLE)  # fmt: skip
_EDGE = _form(kind=_words("floor", "ceiling", "vertical"), planes=listed(text),
              pieces=listed(_form(pixels=_LIST, **_VISIBLE)))  # fmt: skip
_LAYOUT = _form(version=whole_number, corners=listed(_CORNER), edges=listed(_EDGE))
