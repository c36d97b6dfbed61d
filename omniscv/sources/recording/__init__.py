"""Recordings: captures in one SQLite file, replayed or added to, joined and divided."""

from omniscv.sources.recording.merging import merge
from omniscv.sources.recording.parts import part_file, part_files
from omniscv.sources.recording.recorder import Recording, record
from omniscv.sources.recording.replay import RecordedSource, open_recording
from omniscv.sources.recording.splitting import split

__all__ = [
    "RecordedSource",
    "Recording",
    "merge",
    "open_recording",
    "part_file",
    "part_files",
    "record",
    "split",
]
