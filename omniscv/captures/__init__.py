"""Captures: single pictures and where they come from. Knows no camera model."""

from omniscv.captures.opening import open_source
from omniscv.captures.recording import record
from omniscv.captures.source import Capabilities, ObjectTable, Source
from omniscv.captures.view import MODES, Capture, Request, View

__all__ = [
    "MODES",
    "Capabilities",
    "Capture",
    "ObjectTable",
    "Request",
    "Source",
    "View",
    "open_source",
    "record",
]
