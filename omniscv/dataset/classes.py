"""The file ``classes.yaml``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from omniscv.arguments import shown, within
from omniscv.dataset import manifest
from omniscv.errors import ArgumentError
from omniscv.sources.registry import open_source, scheme_of
from omniscv.storage import SCHEMES, bounded, folder
from omniscv.truth.classes import ClassRules


def class_rules(classes: str | Path | Mapping[str, Any] | ClassRules) -> ClassRules:
    """Return the rules of a ``classes.yaml``, given by its path or its content.

    Raises:
        ArgumentError: the file cannot be read, or as :meth:`ClassRules.from_dict`.
    """
    if isinstance(classes, ClassRules):
        return classes
    if isinstance(classes, Mapping):
        with within("classes"):
            return ClassRules.from_dict(classes)
    if not isinstance(classes, str | Path):
        raise ArgumentError(f"classes: expected a file, or a mapping with 'rules', got {shown(classes)}")
    with within(classes):
        return ClassRules.from_dict(bounded.parse_yaml(bounded.read_text(Path(classes))))


def object_names(scene: str | Path) -> tuple[str, ...]:
    """Return the names of the objects of a scene, of a source by its address, or of a dataset, sorted.

    Raises:
        ArgumentError: another address.
        SourceError, RecordingError: the source cannot be opened.
    """
    address = str(scene)
    if scheme_of(address) in (None, *SCHEMES) and folder(scene).exists(manifest.DATASET):
        return tuple(sorted(manifest.read(scene).names))
    if scheme_of(address) is None and not _recorded(Path(address)):
        address = f"scene://{address}"  # a scene's name, or its file
    with open_source(address) as source:
        return tuple(source.objects().names())


def _recorded(path: Path) -> bool:
    """Return whether a path exists and is not the file of a scene: a recording."""
    return path.exists() and path.suffix not in (".yaml", ".yml", ".json")
