"""What the formats share: values from untrusted text, and the one camera of a file."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np

from omniscv import arguments
from omniscv.arguments import Reader, shown, within
from omniscv.cameras import Camera
from omniscv.cameras.rig import Rig
from omniscv.errors import ArgumentError
from omniscv.records import key_of, mapping, read
from omniscv.storage.bounded import parse_yaml

T = TypeVar("T")


def parse_mapping(text: str) -> dict[str, Any]:
    """Return a YAML (or JSON) document that is a mapping; ArgumentError for anything else."""
    return mapping("file", parse_yaml(text))


def read_known(cls: type[T], value: object, where: str = "") -> T:
    """Return a record of a mapping that may have more keys: programs write more than cameras need."""
    known = {key_of(field) for field in fields(cls)}  # type: ignore[arg-type]
    return read(cls, {key: item for key, item in mapping(where, value).items() if key in known}, where)


def known(cls: type[Any]) -> Reader:
    """Return a reader of a record inside another: see :func:`read_known`."""
    return lambda name, value: value if isinstance(value, cls) else read_known(cls, value, name)


def whole_number(name: str, value: object) -> int:
    """Return a whole number >= 1, given as such or in digits; ArgumentError for anything else."""
    if isinstance(value, str) and value.isascii() and value.isdigit() and len(value) < 10:
        value = int(value)
    return arguments.whole_number(name, value)


def image_size(name: str, value: object) -> tuple[int, int]:
    """Return (width, height), a list of two whole numbers; ArgumentError for anything else."""
    if not isinstance(value, list) or len(value) != 2:
        raise ArgumentError(f"{name}: expected [width, height], got {shown(value)}")
    width, height = (whole_number(f"{name}[{i}]", size) for i, size in enumerate(value))
    return width, height


@contextmanager
def only_camera(cameras: Mapping[str, Camera], program: str) -> Iterator[Camera]:
    """Yield the camera of a file that holds one; its name is in the messages of errors.

    Raises:
        ArgumentError: there are more.
    """
    if len(cameras) != 1:
        got = f"{len(cameras)}: {shown(list(cameras))}"
        raise ArgumentError(f"cameras: {program}'s file holds one camera, got {got}")
    ((name, camera),) = cameras.items()
    with within(name):
        yield camera


def check_first_is_origin(rig: Rig, program: str) -> None:
    """Raise ArgumentError where the first camera is not the rig's frame."""
    name, first = next(iter(rig.cameras.items()))
    offset = max(np.abs(first.pose.position).max(), np.abs(first.pose.rotation - np.eye(3)).max())
    if offset > 1e-12:
        raise ArgumentError(
            f"{program}: expected a rig in the frame of its first camera, got another frame; save "
            f"rig.seen_from({name!r})"
        )
