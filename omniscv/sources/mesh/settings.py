"""What an address or a job says of a mesh."""

from typing import Any, Literal, get_args

from omniscv.arguments import flag, numbers, one_of, shown, text
from omniscv.errors import ArgumentError
from omniscv.geometry import Array
from omniscv.records import checked, optional, record

Unit = Literal["m", "cm", "mm", "km", "in", "ft"]
Up = Literal["auto", "y", "z"]
WORDS = ("object", "material")
"""What objects are, where no file names them."""
Alpha = Literal["opaque", "cut"]

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0, "in": 0.0254, "ft": 0.3048}


def _flag(name: str, value: object) -> bool:
    """Return a truth value; the digits of an address, too."""
    return flag(name, {"1": True, "0": False}.get(str(value), value))


def _position(name: str, value: object) -> Array:
    """Return a position (3,) from numbers, or from their text with commas."""
    if isinstance(value, str):
        value = [_number(part) for part in value.split(",")]
    return numbers(name, value, (3,))


def _labels(name: str, value: object) -> str:
    """Return a word, or the name of a file."""
    words = text(name, value)
    if words in WORDS or words.endswith((".json", ".txt", ".house")):
        return words
    expected = f"expected {', '.join(WORDS)}, or a file: info_semantic.json, segments_anno.json"
    raise ArgumentError(f"{name}: {expected}, X.house or X.semantic.txt, got {shown(value)}")


def _number(part: str) -> Any:
    """Return the number of a text; the text itself, where it has none, for the message."""
    try:
        return float(part)
    except ValueError:
        return part


@record(eq=False)
class Settings:
    """What is shown of a mesh, and how.

    Attributes:
        unit: of the file's coordinates.
        up: the file's axis that points up. ``y``: world x, y and z are the file's x, -z and y, as Blender
            and Unreal read glTF; ``z``: they are the file's own; ``auto``: ``y`` of glTF, else ``z``.
        labels: what objects are: nodes, groups or numbers of the file's ``object``; its ``material``; or the
            name of a file beside it that says so (:mod:`omniscv.sources.mesh.semantics`).
        alpha: whether blended surfaces count as ``opaque``, or are ``cut`` where they are less than half so.
        lamp: (3,) metres, world frame: a point light; without one, surfaces show their colour as it is.
        traces: whether images may take labels, depth and colours by rays, without captures.
    """

    unit: Unit = checked(one_of, words=get_args(Unit), default="m")
    up: Up = checked(one_of, words=get_args(Up), default="auto")
    labels: str = checked(_labels, default="object")
    alpha: Alpha = checked(one_of, words=get_args(Alpha), default="opaque")
    lamp: Array | None = checked(optional(_position), default=None)
    traces: bool = checked(_flag, default=True)
