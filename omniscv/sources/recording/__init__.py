"""Recordings: captures in one SQLite file, replayed or added to."""

from omniscv.sources.recording.replay import RecordedSource, Recording, open_recording, record

__all__ = ["RecordedSource", "Recording", "open_recording", "record"]
