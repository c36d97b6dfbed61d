"""Scenes by name, and from files."""

import itertools
from pathlib import Path

from mock_server import yaml_text
from mock_server.scene import Scene

SCENES = Path(__file__).parent / "scenes"


def load_scene(name_or_path: str | Path) -> Scene:
    """Return a scene by its name, or from a YAML file.

    Raises:
        ValueError: no scene has that name, the file cannot be read, or a word or value in it is wrong.
    """
    path = _path(name_or_path)
    text = _text(path)
    try:
        description = yaml_text.parse(text)
    except ValueError as cause:
        raise ValueError(f"scene: {path}: {cause}") from cause
    return Scene(path.stem, description)


def scene_names() -> list[str]:
    """Return the names of the scenes in this package."""
    return sorted(path.stem for path in SCENES.glob("*.yaml"))


def summary(name_or_path: str | Path) -> str:
    """Return the comment that a scene's file begins with, in one line; empty without one.

    Raises:
        ValueError: as :func:`load_scene`.
    """
    lines = itertools.takewhile(lambda line: line.startswith("#"), _text(_path(name_or_path)).splitlines())
    return " ".join(line.strip("# ") for line in lines)


def _path(name_or_path: str | Path) -> Path:
    path = Path(name_or_path)
    if path.suffix in (".yaml", ".yml"):
        return path
    if str(name_or_path) not in scene_names():
        known = ", ".join(scene_names())
        raise ValueError(f"scene: expected one of {known}, or a YAML file; got {str(name_or_path)!r}")
    return SCENES / f"{name_or_path}.yaml"


def _text(path: Path) -> str:
    try:
        return yaml_text.read_text(path)
    except ValueError as cause:
        raise ValueError(f"scene: {path}: {cause}") from cause
