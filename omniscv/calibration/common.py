"""What the formats share: values out of untrusted text."""

from collections.abc import Mapping
from typing import Any

from omniscv import arguments
from omniscv.arguments import shown
from omniscv.cameras import Camera
from omniscv.errors import ArgumentError
from omniscv.storage import bounded


def mapping(text: str) -> dict[str, Any]:
    """Return the mapping that a YAML (or JSON) document is; raise ArgumentError for all else."""
    data = bounded.parse_yaml(text)
    if not isinstance(data, dict):
        raise ArgumentError(f"expected a YAML mapping, got {shown(data)}")
    return data


def field(data: object, key: str) -> Any:
    """Return ``data[key]``; raise ArgumentError where ``data`` is no mapping, or has no such key."""
    if not isinstance(data, dict):
        raise ArgumentError(f"expected a mapping with {key!r} in it, got {shown(data)}")
    if key not in data:
        raise ArgumentError(f"expected the key {key!r}, got {shown(list(data))}")
    return data[key]


def whole_number(key: str, value: object) -> int:
    """Return a whole number >= 1, given as such or in digits; raise ArgumentError for all else."""
    if isinstance(value, str) and value.isascii() and value.isdigit() and len(value) < 10:
        value = int(value)
    return arguments.whole_number(key, value)


def only_camera(cameras: Mapping[str, Camera], program: str) -> tuple[str, Camera]:
    """Return the name and the camera of a file that holds one; raise ArgumentError if there are more."""
    if len(cameras) != 1:
        raise ArgumentError(
            f"cameras: {program}'s file holds one camera, got {len(cameras)}: {shown(list(cameras))}"
        )
    return next(iter(cameras.items()))
