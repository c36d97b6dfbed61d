"""Ground truth as records: pure functions from images and scenes; nothing here reads or writes files."""

from omniscv.truth.room_layout import RoomLayout, layout, project_layout, room_of

__all__ = ["RoomLayout", "layout", "project_layout", "room_of"]
