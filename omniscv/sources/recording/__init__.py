"""Recordings: captures in one SQLite file, replayed or added to."""

from omniscv.sources.recording.recorder import Recording, record
from omniscv.sources.recording.replay import RecordedSource, open_recording

__all__ = ["RecordedSource", "Recording", "open_recording", "record"]
