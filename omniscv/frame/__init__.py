"""A frame: one image of a job or a dataset, from the plan to the loader, and the border of its files."""

from omniscv.frame.files import IMAGE, FileEntry, FrameFiles, ImageFiles, file_endings
from omniscv.frame.frame import Frame

__all__ = ["IMAGE", "FileEntry", "Frame", "FrameFiles", "ImageFiles", "file_endings"]
