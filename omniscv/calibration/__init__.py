"""Calibration files of other programs: docs/lens-files.md lists them.

A format is a :class:`omniscv.calibration.forms.Form`: where the numbers of a camera stand, and by which of
our models. Most are declared in ``table.py``; others have a module of their own, which says how their pixel
centres relate to ours, which are at .5. Readers raise ``ArgumentError`` for text that does not follow the
format, writers for cameras, names and poses that the format cannot carry. Nothing is approximated silently.
"""

from omniscv.calibration.files import dumps, formats, load, load_rig, loads, nearest, save, save_rig
from omniscv.calibration.fitting import Fit, fit
from omniscv.calibration.opencv import (
    from_opencv,
    from_opencv_fisheye,
    from_opencv_omnidir,
    to_opencv,
    to_opencv_fisheye,
    to_opencv_omnidir,
)

__all__ = [
    "Fit", "dumps", "fit", "formats", "from_opencv", "from_opencv_fisheye", "from_opencv_omnidir", "load",
    "load_rig", "loads", "nearest", "save", "save_rig", "to_opencv", "to_opencv_fisheye",
    "to_opencv_omnidir"
]  # fmt: skip
