"""Values that take the place of those in a job's description, such as the command line's."""

from collections.abc import Mapping
from typing import Any

from omniscv.arguments import shown
from omniscv.errors import ArgumentError

EVERY = "*"


def overridden(description: object, overrides: Mapping[str, Any]) -> Any:
    """Return a description with other values in their places; what was given is not changed.

    Args:
        description: a job's, before it is read.
        overrides: by key, with dots between levels: ``face_size``, ``source_options.timeout_s``. A star is
            every entry of a mapping or a list: ``cameras.*.width``. None removes a key.

    Raises:
        ArgumentError: a key below something that is no mapping, or below cameras of which a rig has some.
    """
    for key, value in overrides.items():
        if key.startswith("cameras.*.") and isinstance(description, Mapping) and "rig" in description:
            wanted = "expected a job without a rig, to change all its cameras"
            raise ArgumentError(f"{key}: {wanted}; write it into the rig")
        description = _changed(description, key.split("."), value, "")
    return description


def _changed(there: object, path: list[str], value: object, where: str) -> Any:
    """A copy of what is at a place, with a value below it."""
    if not path:
        return value
    key, *rest = path
    here = f"{where}.{key}".removeprefix(".")
    if key == EVERY and isinstance(there, list):
        return [_changed(each, rest, value, here) for each in there]
    if key == EVERY and isinstance(there, Mapping):
        return {name: _changed(each, rest, value, here) for name, each in there.items()}
    if key == EVERY or not isinstance(there, Mapping | None):
        wanted = f"expected something in which {'.'.join(path)} can be set"
        raise ArgumentError(f"{where or 'job'}: {wanted}, got {shown(there)}")
    known = dict(there or {})
    if value is None and not rest:
        known.pop(key, None)
        return known
    return {**known, key: _changed(known.get(key), rest, value, here)}
