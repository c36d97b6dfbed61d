"""Picture files: a row of :mod:`omniscv.pictures.forms` for each form, and the tools of some."""

MAX_PIXELS = 1 << 27
"""The most pixels that are decoded, 16384 x 8192: a byte of PNG can stand for a thousand."""
