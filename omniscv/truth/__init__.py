"""Ground truth as records: pure functions from images and scenes; nothing here reads or writes files.

Public names are imported when they are first used.
"""

from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from omniscv.truth.room_layout import RoomLayout, layout, project_layout, room_of

_HOMES = {
    "RoomLayout": "omniscv.truth.room_layout:RoomLayout",
    "layout": "omniscv.truth.room_layout:layout",
    "project_layout": "omniscv.truth.room_layout:project_layout",
    "room_of": "omniscv.truth.room_layout:room_of",
}

__all__ = [
    "RoomLayout",
    "layout",
    "project_layout",
    "room_of",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'omniscv.truth' has no attribute {name!r}")
    globals()[name] = resolve_name(_HOMES[name])
    return globals()[name]


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
