"""Recordings: captures in one SQLite file, replayed or added to, merged and split."""

from omniscv.sources.recording.operations import merge, part_file, split
from omniscv.sources.recording.recorder import Recording, record
from omniscv.sources.recording.replay import RecordedSource

__all__ = ["RecordedSource", "Recording", "merge", "part_file", "record", "split"]
