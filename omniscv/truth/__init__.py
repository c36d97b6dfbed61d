"""Ground truth as records: pure functions from images and scenes; nothing here reads or writes files."""

from omniscv.truth.layout_record import project_layout, room_of
from omniscv.truth.room_layout import RoomLayout, layout

__all__ = ["RoomLayout", "layout", "project_layout", "room_of"]
